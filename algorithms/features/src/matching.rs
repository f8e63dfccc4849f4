//! Nearest descriptors.

use crate::simd::InstructionSet;
use crate::{Descriptor, Keypoint};

mod hamming;
mod mutual;
#[cfg(test)]
mod tests;

/// A descriptor of one set and the one of the other set that it fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    pub query_idx: u32,
    pub train_idx: u32,
    pub distance: u32,
}

/// When two descriptors are taken for the same thing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchSettings {
    /// Bits that may differ, 0 to 256. Higher finds more and more wrong ones.
    pub distance_max: u32,
    /// The nearest must be nearer than this times the second nearest, 0 to 1 (1: no such test).
    /// Lower refuses more of repeated texture.
    pub ratio_max: f32,
}

impl Default for MatchSettings {
    fn default() -> Self {
        Self {
            distance_max: 64,
            ratio_max: 0.85,
        }
    }
}

/// The nearest and the second nearest of a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Nearest {
    pub train_idx: u32,
    pub distance: u32,
    /// Distance of the runner-up; `u32::MAX` if there is none.
    pub second_distance: u32,
}

impl Nearest {
    /// Whether it passes the distance gate and the ratio test.
    pub fn passes(&self, settings: &MatchSettings) -> bool {
        let limit = settings.ratio_max * self.second_distance as f32;
        self.distance <= settings.distance_max
            && (self.second_distance == u32::MAX
                || settings.ratio_max >= 1.0
                || (self.distance as f32) < limit)
    }
}

/// Pairs that are each other's nearest and pass the gate and the ratio test from both sides.
///
/// Sorted by query index; the lower index wins a tie. Cost: `query` × `train` distances.
pub fn match_mutual(
    query: &[Descriptor],
    train: &[Descriptor],
    settings: &MatchSettings,
) -> Vec<Match> {
    mutual::search(InstructionSet::detect(), query, train)
        .filter(|(forward, backward)| forward.passes(settings) && backward.passes(settings))
        .map(|(forward, backward)| Match {
            query_idx: backward.train_idx,
            train_idx: forward.train_idx,
            distance: forward.distance,
        })
        .collect()
}

/// Descriptors laid out so that their distances to another one come many at a time.
#[derive(Clone, Debug, Default)]
pub struct DescriptorColumns {
    words: hamming::WordColumns,
    count: usize,
}

impl DescriptorColumns {
    pub fn new(descriptors: &[Descriptor]) -> Self {
        Self {
            words: hamming::WordColumns::new(descriptors),
            count: descriptors.len(),
        }
    }

    /// The distance from `query` to each, in order, into `distances`.
    pub fn distances(&self, query: &Descriptor, distances: &mut Vec<u16>) {
        distances.resize(self.count, 0);
        self.words
            .distances(InstructionSet::detect(), query, distances);
    }
}

/// The nearest of all; `None` if there are none.
pub fn nearest(query: &Descriptor, train: &[Descriptor]) -> Option<Nearest> {
    nearest_of(query, train, 0..train.len() as u32)
}

/// The nearest among the candidates; indices outside `train` are passed over.
pub fn nearest_of(
    query: &Descriptor,
    train: &[Descriptor],
    candidates: impl IntoIterator<Item = u32>,
) -> Option<Nearest> {
    let mut best: Option<Nearest> = None;
    for train_idx in candidates {
        let Some(one) = train.get(train_idx as usize) else {
            continue;
        };
        let distance = query.distance(one);
        let second_distance = match &mut best {
            Some(best) if distance >= best.distance => {
                best.second_distance = best.second_distance.min(distance);
                continue;
            }
            Some(best) => best.distance,
            None => u32::MAX,
        };
        best = Some(Nearest {
            train_idx,
            distance,
            second_distance,
        });
    }
    best
}

/// Bins of the histogram of turns.
const TURN_BIN_COUNT: usize = 30;
/// Bins that are kept around the strongest one's neighbourhood.
const TURN_BINS_KEPT: usize = 3;

/// Drops the matches whose keypoints do not turn as most others do.
///
/// For images between which the camera turned about its axis by one angle for all points; keeps
/// the three strongest of 30 bins, each of which must hold a tenth of the strongest.
pub fn keep_consistent_turns(matches: &mut Vec<Match>, query: &[Keypoint], train: &[Keypoint]) {
    let bin = |one: &Match| {
        let from = query.get(one.query_idx as usize)?.angle_rad;
        let to = train.get(one.train_idx as usize)?.angle_rad;
        let turns = f64::from(to - from).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
        Some(((turns * TURN_BIN_COUNT as f64).round() as usize) % TURN_BIN_COUNT)
    };
    let mut counts = [0_u32; TURN_BIN_COUNT];
    for one in matches.iter() {
        if let Some(idx) = bin(one) {
            counts[idx] += 1;
        }
    }
    let mut order: [usize; TURN_BIN_COUNT] = std::array::from_fn(|idx| idx);
    order.sort_by_key(|&idx| std::cmp::Reverse(counts[idx]));
    let weakest = counts[order[0]].div_ceil(10);
    let mut kept = [false; TURN_BIN_COUNT];
    for &idx in &order[..TURN_BINS_KEPT] {
        kept[idx] = counts[idx] >= weakest;
    }
    matches.retain(|one| bin(one).is_some_and(|idx| kept[idx]));
}

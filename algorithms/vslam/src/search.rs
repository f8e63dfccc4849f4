//! Which keypoint near a predicted position shows a point.

use std::ops::RangeInclusive;

use features::Descriptor;
use nalgebra::Vector2;

use crate::Observation;
use crate::plane_grid::PlaneGrid;

/// Where to look for what.
#[derive(Clone, Debug)]
pub(crate) struct Wanted<'a> {
    pub(crate) position: Vector2<f64>,
    pub(crate) radius: f64,
    pub(crate) levels: RangeInclusive<u8>,
    pub(crate) descriptor: &'a Descriptor,
}

/// When a descriptor is accepted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gate {
    pub(crate) distance_max: u32,
    /// The best must be below this times the second best of the same level; 1 is no test.
    pub(crate) ratio_max: f32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Found {
    pub(crate) observation_idx: usize,
    pub(crate) distance: u32,
}

/// The observation that fits best, of those for which `usable` holds.
pub(crate) fn find(
    wanted: &Wanted,
    (grid, observations): (&PlaneGrid, &[Observation]),
    gate: Gate,
    usable: impl Fn(&Observation) -> bool,
) -> Option<Found> {
    let mut best = (u32::MAX, u8::MAX, 0_u32);
    let mut second = (u32::MAX, u8::MAX);
    grid.visit_near(
        &wanted.position,
        wanted.radius,
        wanted.levels.clone(),
        |entry| {
            let observation = &observations[entry.observation_idx as usize];
            let distance = wanted.descriptor.distance(&observation.descriptor);
            if distance >= second.0 || !usable(observation) {
                return;
            }
            if distance < best.0 {
                second = (best.0, best.1);
                best = (distance, entry.level, entry.observation_idx);
            } else {
                second = (distance, entry.level);
            }
        },
    );
    let ambiguous = second.1 == best.1 && best.0 as f32 > gate.ratio_max * second.0 as f32;
    (best.0 <= gate.distance_max && !ambiguous).then_some(Found {
        observation_idx: best.2 as usize,
        distance: best.0,
    })
}

/// Bins of the histogram of turns.
const TURN_BIN_COUNT: usize = 30;

/// Which pairs of keypoint directions turn as most others do.
///
/// A camera that turns about its axis turns all keypoints by one angle; what falls outside the
/// three strongest of 30 bins is a wrong match.
pub(crate) fn consistent_turns(turns_rad: &[f32]) -> Vec<bool> {
    let bin = |turn_rad: f32| {
        let share = turn_rad.rem_euclid(std::f32::consts::TAU) / std::f32::consts::TAU;
        (share * TURN_BIN_COUNT as f32).round() as usize % TURN_BIN_COUNT
    };
    let mut counts = [0_usize; TURN_BIN_COUNT];
    for &turn in turns_rad {
        counts[bin(turn)] += 1;
    }
    let mut order: [usize; TURN_BIN_COUNT] = std::array::from_fn(|idx| idx);
    order.sort_by_key(|&idx| std::cmp::Reverse(counts[idx]));
    let weakest = counts[order[0]].div_ceil(10);
    let mut kept = [false; TURN_BIN_COUNT];
    for &idx in &order[..3] {
        kept[idx] = counts[idx] >= weakest;
    }
    turns_rad.iter().map(|&turn| kept[bin(turn)]).collect()
}

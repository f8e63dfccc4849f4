//! The similarities that many correspondences agree on.

mod fit;
mod lengths;
mod support;

use geometry::Similarity;
use nalgebra::Vector3;
use rand::Rng;
use rand::seq::SliceRandom;
use rand::seq::index::sample_array;

use crate::alignment::{Source, Target};
use crate::gravity::Gravity;
use fit::Fit;
use lengths::Lengths;
use support::{Placed, Support};

/// A point of each cloud that may be the same.
#[derive(Clone, Copy, Debug)]
pub struct Correspondence {
    pub in_target: Vector3<f64>,
    pub in_source: Vector3<f64>,
}

#[derive(Clone, Debug)]
pub struct ConsensusSettings {
    /// Whether the scale is estimated; otherwise it is one.
    pub with_scale: bool,
    /// Which way is up in both clouds, if that is known.
    pub gravity: Option<Gravity>,
    /// Correspondences that an alignment brings within this distance agree with it: three to four
    /// times the noise's standard deviation. The estimate itself narrows to the noise it finds.
    pub inlier_distance: f64,
    /// A smaller share of right correspondences is not looked for, 0 to 1. The cost of finding
    /// nothing goes with its inverse square.
    pub inlier_share_min: f64,
    pub inlier_count_min: usize,
    /// Scales beyond this factor are not believed.
    pub scale_factor_max: f64,
    /// How many different alignments are wanted.
    pub hypothesis_count: usize,
    /// After the first, only alignments with this share of its correspondences are looked for.
    pub rival_share_min: f64,
}

impl Default for ConsensusSettings {
    fn default() -> Self {
        Self {
            with_scale: true,
            gravity: None,
            inlier_distance: 0.05,
            inlier_share_min: 0.015,
            inlier_count_min: 6,
            scale_factor_max: 10.0,
            hypothesis_count: 2,
            rival_share_min: 0.3,
        }
    }
}

/// An alignment and how many correspondences agree with it.
#[derive(Clone, Copy, Debug)]
pub struct Hypothesis {
    pub target_from_source: Similarity<Target, Source>,
    pub inlier_count: usize,
}

/// Correspondences that are sampled from, at most: their mutual distances are kept.
const SAMPLED_COUNT_MAX: usize = 2000;
/// The chance to miss an alignment with as many correspondences as the best one so far.
const MISS_CHANCE: f64 = 1e-3;
/// Of pairs of right correspondences, those that lie far enough apart to find the rest by.
const USEFUL_SHARE: f64 = 0.5;
/// What an alignment brings within this many inlier distances is no evidence for another one.
const EXPLAINED_DISTANCES: f64 = 3.0;
/// Followers that are tried as the third correspondence of a pose.
const THIRD_COUNT_MAX: usize = 6;
/// A sample is worth a pose if it has this share of the followers that are wanted.
const FOLLOWER_SHARE_MIN: f64 = 0.5;
/// And more than chance gives, by this many standard deviations.
const FOLLOWER_SIGMAS: f64 = 3.0;
/// Samples that chance is measured by.
const CHANCE_SAMPLE_COUNT: usize = 32;
/// Fewer correspondences than these and the two ends are no reason to look closer.
const AGREEING_COUNT_MIN: usize = 4;

/// The alignments with most support, best first, each with inliers of its own.
///
/// Two correspondences fix the scale, and others follow them if their distances to both have that
/// scale: pairwise consistency, which costs no rotation. Only a sample with many followers gets a
/// pose, by the third that most followers agree with. Where gravity is known, two correspondences
/// give the pose, and their heights refuse most wrong ones at once. The fit then narrows to the
/// noise of its inliers. Deterministic for a given `rng`; the loop allocates nothing.
pub fn find_consensus(
    pairs: &[Correspondence],
    settings: &ConsensusSettings,
    rng: &mut impl Rng,
) -> Vec<Hypothesis> {
    if pairs.len() < settings.inlier_count_min.max(3) {
        return Vec::new();
    }
    let mut search = Search::new(pairs, settings, rng);
    let mut hypotheses: Vec<Hypothesis> = Vec::new();
    while hypotheses.len() < settings.hypothesis_count {
        let rival_count = hypotheses.first().map_or(0.0, |best| {
            settings.rival_share_min * best.inlier_count as f64
        });
        let count_min = settings.inlier_count_min.max(rival_count.ceil() as usize);
        let Some(best) = search.best(count_min, rng) else {
            break;
        };
        search.drop_explained(&best.target_from_source);
        hypotheses.push(best);
    }
    hypotheses.sort_by_key(|hypothesis| std::cmp::Reverse(hypothesis.inlier_count));
    hypotheses
}

struct Search<'a> {
    settings: &'a ConsensusSettings,
    fit: Fit,
    /// Of what no alignment explains yet.
    support: Support,
    /// Those of the correspondences that are sampled from.
    sampled: Vec<Correspondence>,
    lengths: Lengths,
    /// Which of the sampled no alignment explains yet.
    live: Vec<u32>,
    followers: Vec<u32>,
}

/// What a sample must show to be looked at closer.
struct Wanted {
    followers: usize,
    agreeing: usize,
}

impl<'a> Search<'a> {
    fn new(pairs: &[Correspondence], settings: &'a ConsensusSettings, rng: &mut impl Rng) -> Self {
        let mut sampled = pairs.to_vec();
        if sampled.len() > SAMPLED_COUNT_MAX {
            sampled = sampled.partial_shuffle(rng, SAMPLED_COUNT_MAX).0.to_vec();
        }
        Self {
            settings,
            fit: Fit::new(settings),
            support: Support::new(pairs, settings.inlier_distance),
            lengths: Lengths::new(sampled.len()),
            live: (0..sampled.len() as u32).collect(),
            followers: Vec::with_capacity(sampled.len()),
            sampled,
        }
    }

    /// The alignment with most inliers, at least `count_min`, among what is unexplained.
    fn best(&mut self, count_min: usize, rng: &mut impl Rng) -> Option<Hypothesis> {
        let pair_count = self.support.pair_count();
        if pair_count < count_min || self.live.len() < 3 {
            return None;
        }
        let sampled_share = self.live.len() as f64 / pair_count as f64;
        let sample_count = |inlier_count: usize| {
            let share = inlier_count as f64 / pair_count as f64;
            let hit = USEFUL_SHARE * share.max(self.settings.inlier_share_min).powi(2);
            (MISS_CHANCE.ln() / (1.0 - hit).ln()).ceil() as usize
        };
        let by_chance = self.followers_by_chance(rng)?;
        let mut sample_count_needed = sample_count(count_min);
        let mut best: Option<Hypothesis> = None;
        let mut sample_idx = 0;
        while sample_idx < sample_count_needed {
            sample_idx += 1;
            let inliers_wanted = best.map_or(count_min, |best| best.inlier_count + 1);
            let implied = FOLLOWER_SHARE_MIN * sampled_share * inliers_wanted as f64;
            let wanted = Wanted {
                followers: implied.max(by_chance).ceil() as usize,
                agreeing: (implied.ceil() as usize).max(AGREEING_COUNT_MIN),
            };
            let ends = self.sample(rng)?;
            if best.is_some_and(|best| self.both_agree(ends, &best.target_from_source)) {
                // They would give the same again.
                continue;
            }
            let hypothesis = self
                .pose_by(ends, &wanted)
                .and_then(|pose| self.support.narrowed(&pose, &self.fit, inliers_wanted));
            if let Some(hypothesis) = hypothesis {
                sample_count_needed = sample_count(hypothesis.inlier_count);
                best = Some(hypothesis);
            }
        }
        best
    }

    fn sample(&self, rng: &mut impl Rng) -> Option<[usize; 2]> {
        let ends: [usize; 2] = sample_array(rng, self.live.len())?;
        Some(ends.map(|idx| self.live[idx] as usize))
    }

    fn both_agree(&self, ends: [usize; 2], pose: &Similarity<Target, Source>) -> bool {
        let placed = Placed::new(pose);
        ends.iter()
            .all(|idx| placed.distance(&self.sampled[*idx]) <= self.settings.inlier_distance)
    }

    /// More followers than a sample has by chance, nearly always.
    fn followers_by_chance(&mut self, rng: &mut impl Rng) -> Option<f64> {
        let (mut sum, mut count) = (0, 0);
        for _ in 0..CHANCE_SAMPLE_COUNT {
            let ends = self.sample(rng)?;
            self.lengths.measure(&self.sampled, ends);
            let (in_target, in_source) = self.lengths.between(ends);
            if let Some(scale) = self.fit.scale_of(in_target, in_source) {
                let slack = self.fit.length_slack(in_target);
                sum += self.lengths.chance_count(ends, scale, slack);
                count += 1;
            }
        }
        let mean = f64::from(sum as u32) / f64::from(count.max(1));
        Some(mean + FOLLOWER_SIGMAS * mean.sqrt())
    }

    /// A pose from two correspondences and what follows them.
    fn pose_by(&mut self, ends: [usize; 2], wanted: &Wanted) -> Option<Similarity<Target, Source>> {
        let [first, second] = ends.map(|idx| self.sampled[idx]);
        if self.settings.gravity.is_some() {
            let pose = self.fit.of_two(&first, &second)?;
            let wide = 2.0 * self.settings.inlier_distance;
            let count = self.support.count_within(&pose, wide);
            return (count >= wanted.agreeing + 2).then_some(pose);
        }
        self.lengths.measure(&self.sampled, ends);
        let (in_target, in_source) = self.lengths.between(ends);
        let scale = self.fit.scale_of(in_target, in_source)?;
        let slack = self.fit.length_slack(in_target);
        // The ends keep the scale too.
        if self.lengths.follower_count(ends, scale, slack) < wanted.followers + 2 {
            return None;
        }
        let followers = &mut self.followers;
        self.lengths
            .followers(ends, scale, slack, &self.live, followers);
        if followers.len() < wanted.followers {
            return None;
        }
        let (pose, count) = self.third(&first, &second)?;
        (count >= wanted.agreeing).then_some(pose)
    }

    /// The pose by two correspondences and the one of their followers that most others agree with.
    fn third(
        &self,
        first: &Correspondence,
        second: &Correspondence,
    ) -> Option<(Similarity<Target, Source>, usize)> {
        let step = self.followers.len().div_ceil(THIRD_COUNT_MAX).max(1);
        let wide = 2.0 * self.settings.inlier_distance;
        let mut best: Option<(Similarity<Target, Source>, usize)> = None;
        for third in self.followers.iter().step_by(step) {
            let three = [*first, *second, self.sampled[*third as usize]];
            let Some(pose) = self.fit.of(three.iter()) else {
                continue;
            };
            let placed = Placed::new(&pose);
            let followers = self.followers.iter();
            let count = followers
                .filter(|idx| placed.distance(&self.sampled[**idx as usize]) <= wide)
                .count();
            if best.is_none_or(|(_, most)| count > most) {
                best = Some((pose, count));
            }
        }
        best
    }

    fn drop_explained(&mut self, by: &Similarity<Target, Source>) {
        let distance = EXPLAINED_DISTANCES * self.settings.inlier_distance;
        let (sampled, placed) = (&self.sampled, Placed::new(by));
        self.live
            .retain(|idx| placed.distance(&sampled[*idx as usize]) > distance);
        self.support.drop_within(by, distance);
    }
}

#[cfg(test)]
mod tests;

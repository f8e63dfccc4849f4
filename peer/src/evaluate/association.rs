//! Which poses of two trajectories belong to the same frame.

use geometry::Timestamp;

use super::STAMP_TOLERANCE_S;
use crate::files::StampedPose;

/// Two poses of one instant, by their place in either list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    pub truth_idx: usize,
    pub estimate_idx: usize,
}

/// Pairs poses that are each other's nearest in time, at most [`STAMP_TOLERANCE_S`] apart, in the
/// order of the estimate. The truth must be in the order of its stamps; neither need be complete.
pub fn associate<A, B>(truth: &[StampedPose<A>], estimate: &[StampedPose<B>]) -> Vec<Pair> {
    let mut best_of_truth: Vec<Option<usize>> = vec![None; truth.len()];
    let gap_s = |pair: &Pair| {
        (truth[pair.truth_idx].captured_at - estimate[pair.estimate_idx].captured_at).abs()
    };
    let mut pairs = Vec::new();
    for (estimate_idx, pose) in estimate.iter().enumerate() {
        let Some(truth_idx) = nearest(truth, pose.captured_at) else {
            continue;
        };
        let pair = Pair {
            truth_idx,
            estimate_idx,
        };
        if gap_s(&pair) > STAMP_TOLERANCE_S {
            continue;
        }
        match best_of_truth[truth_idx] {
            Some(taken) if gap_s(&pairs[taken]) <= gap_s(&pair) => {}
            Some(taken) => pairs[taken] = pair,
            None => {
                best_of_truth[truth_idx] = Some(pairs.len());
                pairs.push(pair);
            }
        }
    }
    pairs
}

/// The pose nearest in time in an ordered list.
pub(super) fn nearest<A>(poses: &[StampedPose<A>], at: Timestamp) -> Option<usize> {
    let after = poses.partition_point(|pose| pose.captured_at < at);
    let candidates = [after.checked_sub(1), Some(after)];
    candidates
        .into_iter()
        .flatten()
        .filter(|&idx| idx < poses.len())
        .min_by(|&left, &right| {
            let gap_s = |idx: usize| (poses[idx].captured_at - at).abs();
            gap_s(left).total_cmp(&gap_s(right))
        })
}

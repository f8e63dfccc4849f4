//! The similarity that most fixes agree with, found without a guess.

use std::collections::BTreeMap;

use geometry::{DegenerateAlignment, Enu, Map, Similarity, umeyama};
use nalgebra::Vector3;
use vslam::KeyframeId;

use super::NotObservable;
use super::association::Tie;
use crate::KeyframePose;

/// Triples that are tried: with 30 % outliers one in three is clean.
const TRIPLE_COUNT: usize = 96;
/// Fixes that a triple is scored on.
const SCORED_COUNT_MAX: usize = 256;
/// How far drift may bend the path from any one similarity, as a share of its extent.
const DRIFT_SHARE: f64 = 0.03;

type Pair = (Vector3<f64>, Vector3<f64>);

/// A robust similarity of the camera's path to the fixes; lever arm and drift are left for later.
pub(super) fn find(
    ties: &[&Tie],
    keyframes: &BTreeMap<KeyframeId, KeyframePose>,
) -> Result<Similarity<Enu, Map>, NotObservable> {
    let stride = ties.len().div_ceil(SCORED_COUNT_MAX);
    let pairs: Vec<Pair> = ties
        .iter()
        .step_by(stride)
        .filter_map(|tie| {
            let map_from_keyframe = keyframes.get(&tie.keyframe)?.map_from_camera;
            let camera_in_map = map_from_keyframe * *tie.keyframe_from_camera.translation();
            Some((tie.fix.antenna_in_enu, camera_in_map))
        })
        .collect();
    let tolerance_m = tolerance_m(ties, &pairs);
    let best = (0..TRIPLE_COUNT)
        .filter_map(|trial| candidate(&pairs, trial))
        .min_by(|a, b| score(a, &pairs, tolerance_m).total_cmp(&score(b, &pairs, tolerance_m)))
        .map_or_else(|| fit(&pairs, |_| 1.0), Ok);
    let mut enu_from_map = best.map_err(|_| NotObservable::Hovering)?;
    for _ in 0..5 {
        let weight = |pair: &Pair| {
            let ratio = (enu_from_map * pair.1 - pair.0).norm() / tolerance_m;
            1.0 / (1.0 + ratio * ratio)
        };
        // A path that is exactly straight keeps the candidate: the chain will say so.
        let Ok(refined) = fit(&pairs, weight) else {
            break;
        };
        enu_from_map = refined;
    }
    Ok(enu_from_map)
}

fn fit(
    pairs: &[Pair],
    weight: impl Fn(&Pair) -> f64,
) -> Result<Similarity<Enu, Map>, DegenerateAlignment> {
    let weights: Vec<f64> = pairs.iter().map(weight).collect();
    umeyama(
        pairs
            .iter()
            .zip(&weights)
            .map(|((target, source), weight)| (*target, *source, *weight)),
        true,
    )
}

/// The similarity of three fixes, one from each third of the path so that they are far apart.
fn candidate(pairs: &[Pair], trial: usize) -> Option<Similarity<Enu, Map>> {
    let third = pairs.len() / 3;
    if third == 0 {
        return None;
    }
    // Steps along the golden ratio and its like visit the thirds evenly without chance.
    let pick = |part: usize, step: f64| {
        let share = ((trial + 1) as f64 * step).fract();
        pairs[part * third + (share * third as f64) as usize]
    };
    let triple = [pick(0, 0.618_034), pick(1, 0.754_878), pick(2, 0.569_840)];
    umeyama(
        triple
            .iter()
            .map(|(target, source)| (*target, *source, 1.0)),
        true,
    )
    .ok()
}

fn score(candidate: &Similarity<Enu, Map>, pairs: &[Pair], tolerance_m: f64) -> f64 {
    let cost = |(target, source): &Pair| {
        let ratio = (*candidate * *source - target).norm() / tolerance_m;
        (ratio * ratio).min(1.0)
    };
    pairs.iter().map(cost).sum()
}

fn tolerance_m(ties: &[&Tie], pairs: &[Pair]) -> f64 {
    let mean_variance = ties
        .iter()
        .map(|tie| tie.fix.covariance.trace())
        .sum::<f64>()
        / ties.len() as f64;
    let mut distances: Vec<f64> = pairs
        .iter()
        .map(|pair| (pair.0 - pairs[0].0).norm())
        .collect();
    distances.sort_by(f64::total_cmp);
    let extent_m = distances
        .get(distances.len() * 4 / 5)
        .copied()
        .unwrap_or(0.0);
    3.0 * mean_variance.sqrt() + DRIFT_SHARE * extent_m
}

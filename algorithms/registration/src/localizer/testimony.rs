//! What landmarks say that should be in view: rooms that look alike share some things exactly and
//! others not at all.

use std::collections::BTreeMap;

use features::Descriptor;
use geometry::{Camera, Transform};
use nalgebra::Vector3;

use super::landmarks::{AnchorLandmarks, AnchorMap};
use super::matching::{FeatureIndex, View};
use super::types::{ChunkIdx, LocalizerSettings};
use crate::evidence::Evenness;

/// Only landmarks seen from nearly where they were seen first: cosine of the angle, and how many
/// times nearer or farther.
const ANGLE_COSINE_MIN: f64 = 0.9;
const DISTANCE_FACTOR_MAX: f64 = 3.0;
/// Where there are fewer features so near, on the ideal plane, something hides the landmark, or
/// the picture shows nothing.
const TEXTURE_RADIUS: f64 = 0.03;
const TEXTURE_COUNT_MIN: usize = 3;
/// Fewer landmarks say nothing.
const WITNESS_COUNT_MIN: usize = 30;

/// A landmark that a keyframe should show.
#[derive(Clone, Copy, Debug)]
pub(super) struct Witness {
    chunk: ChunkIdx,
    landmark_idx: u32,
    point: Vector3<f64>,
    /// Whether a feature there looks like it.
    agrees: bool,
}

/// Asks each landmark that should be in view whether it is.
pub(super) fn ask(
    features: &FeatureIndex,
    anchor: &AnchorLandmarks,
    camera_from_anchor: &Transform<Camera, AnchorMap>,
    settings: &LocalizerSettings,
) -> Vec<Witness> {
    let view = View::new(features, camera_from_anchor, 0.0);
    let mut witnesses = Vec::new();
    for (chunk, stored) in anchor.chunks_near(&view.position, settings.predicted_landmark_count_max)
    {
        let (centre, radius) = stored.bounds();
        if !view.may_see(&centre, radius) {
            continue;
        }
        for (landmark_idx, landmark) in (0..).zip(stored.placed()) {
            let position = view.project_within(landmark, ANGLE_COSINE_MIN, DISTANCE_FACTOR_MAX);
            let Some(position) = position else {
                continue;
            };
            let mut near_count = 0;
            features.for_each_near(&position, TEXTURE_RADIUS, |_| near_count += 1);
            if near_count < TEXTURE_COUNT_MIN {
                continue;
            }
            let mut agrees = false;
            features.for_each_near(&position, settings.refine_radius, |idx| {
                agrees |= is_alike(&landmark.descriptor, features.descriptor(idx), settings);
            });
            witnesses.push(Witness {
                chunk,
                landmark_idx,
                point: landmark.point,
                agrees,
            });
        }
    }
    witnesses
}

fn is_alike(first: &Descriptor, second: &Descriptor, settings: &LocalizerSettings) -> bool {
    first.distance(second) <= settings.search_distance_max
}

/// What the landmarks say to several keyframes together; `None` if there are too few.
pub(super) fn evenness<'a>(witnesses: impl Iterator<Item = &'a Witness>) -> Option<Evenness> {
    let mut together: BTreeMap<(ChunkIdx, u32), (Vector3<f64>, bool)> = BTreeMap::new();
    for witness in witnesses {
        let key = (witness.chunk, witness.landmark_idx);
        let known = together.entry(key).or_insert((witness.point, false));
        known.1 |= witness.agrees;
    }
    let (points, agree): (Vec<_>, Vec<_>) = together.into_values().unzip();
    (points.len() >= WITNESS_COUNT_MIN).then(|| Evenness::of(&points, &agree))
}

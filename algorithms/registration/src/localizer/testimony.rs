//! What a keyframe says of a place that it was located in: which landmarks should be in view and
//! are, and what it sees itself that the anchor should have seen.

use std::collections::{BTreeMap, BTreeSet};

use features::Descriptor;
use geometry::{Camera, Similarity, Transform};
use nalgebra::{Vector2, Vector3};

use super::landmarks::{AnchorLandmarks, AnchorMap};
use super::matching::{FeatureIndex, View};
use super::types::{ChunkIdx, KeyframeObservation, LocalizerSettings};
use crate::likeness::{Bareness, Evenness, Gates, Likeness, Things};

/// Only landmarks seen from nearly where they were seen first: cosine of the angle, and how far
/// they are relative to that.
const ANGLE_COSINE_MIN: f64 = 0.9;
const DISTANCE_FACTORS: [f64; 2] = [1.0 / 3.0, 3.0];
/// Where there are fewer features so near, on the ideal plane, something hides the landmark, or
/// the picture shows nothing.
const TEXTURE_RADIUS: f64 = 0.03;
const TEXTURE_COUNT_MIN: usize = 3;
/// There is a corner even where it looks otherwise: from farther aside, and from much nearer. From
/// farther, corners melt together.
const CORNER_ANGLE_COSINE_MIN: f64 = 0.81;
const CORNER_DISTANCE_FACTORS: [f64; 2] = [0.4, 1.5];
/// Places beside a corner, and how far they are, on the ideal plane.
const BESIDE_COUNT: u8 = 8;
const BESIDE_DISTANCE: f64 = 0.05;
/// How far a point of the own map may be from the landmark that it is, in depths of the scene.
const REACH_DEPTHS: f64 = 0.04;
/// Own points nearer to each other, in depths of the scene, are one that several keyframes saw.
const SAME_DEPTHS: f64 = 0.004;

/// What one keyframe says.
#[derive(Clone, Debug, Default)]
pub(super) struct Testimony {
    landmarks: Vec<Witness>,
    own_points: Vec<OwnPoint>,
    bareness: Bareness,
}

/// A landmark that a keyframe should show.
#[derive(Clone, Copy, Debug)]
struct Witness {
    chunk: ChunkIdx,
    landmark_idx: u32,
    point: Vector3<f64>,
    /// Whether a feature there looks like it.
    agrees: bool,
}

/// A point of the own map that a keyframe shows.
#[derive(Clone, Copy, Debug)]
struct OwnPoint {
    /// In the own map's unit.
    in_camera: Vector3<f64>,
    descriptor: Descriptor,
}

/// A testimony, and where it was given.
pub(super) struct Statement<'a> {
    pub testimony: &'a Testimony,
    pub anchor_from_camera: Similarity<AnchorMap, Camera>,
    /// Of the scene, in the anchor's unit.
    pub depth: f64,
}

impl Testimony {
    pub fn of(
        (keyframe, features): (&KeyframeObservation, &FeatureIndex),
        anchor: &AnchorLandmarks,
        camera_from_anchor: &Transform<Camera, AnchorMap>,
        settings: &LocalizerSettings,
    ) -> Self {
        let camera_from_map = keyframe.map_from_camera.inverse();
        let own_points = keyframe.features.iter().filter_map(|feature| {
            let in_map = feature.point?.point_in_map;
            Some(OwnPoint {
                in_camera: camera_from_map * in_map,
                descriptor: feature.descriptor,
            })
        });
        let (landmarks, bareness) = ask(features, anchor, camera_from_anchor, settings);
        Self {
            landmarks,
            own_points: own_points.collect(),
            bareness,
        }
    }

    /// Lengths of the own map about the keyframe have grown.
    pub fn stretch(&mut self, factor: f64) {
        for point in &mut self.own_points {
            point.in_camera *= factor;
        }
    }
}

/// Asks each landmark that should be in view whether it is.
fn ask(
    features: &FeatureIndex,
    anchor: &AnchorLandmarks,
    camera_from_anchor: &Transform<Camera, AnchorMap>,
    settings: &LocalizerSettings,
) -> (Vec<Witness>, Bareness) {
    let view = View::new(features, camera_from_anchor, 0.0);
    let (mut witnesses, mut bareness) = (Vec::new(), Bareness::default());
    for (chunk, stored) in anchor.chunks_near(&view.position, settings.predicted_landmark_count_max)
    {
        let (centre, radius) = stored.bounds();
        if !view.may_see(&centre, radius) {
            continue;
        }
        for (landmark_idx, landmark) in (0..).zip(stored.placed()) {
            let Some(seen) = view.appearance(landmark) else {
                continue;
            };
            let position = seen.position;
            if seen.is_within(CORNER_ANGLE_COSINE_MIN, CORNER_DISTANCE_FACTORS) {
                let radius = settings.refine_radius;
                bareness.add(&look_for_corner(features, &position, radius));
            }
            if !seen.is_within(ANGLE_COSINE_MIN, DISTANCE_FACTORS) {
                continue;
            }
            let mut near_count = 0;
            features.for_each_near(&position, TEXTURE_RADIUS, |_| near_count += 1);
            if near_count < TEXTURE_COUNT_MIN {
                continue;
            }
            let mut agrees = false;
            features.for_each_near(&position, settings.refine_radius, |idx| {
                let distance = landmark.descriptor.distance(features.descriptor(idx));
                agrees |= distance <= settings.search_distance_max;
            });
            witnesses.push(Witness {
                chunk,
                landmark_idx,
                point: landmark.point,
                agrees,
            });
        }
    }
    (witnesses, bareness)
}

/// Whether there is any corner where one should be, and beside it.
fn look_for_corner(features: &FeatureIndex, position: &Vector2<f64>, radius: f64) -> Bareness {
    let is_bare = |place: &Vector2<f64>| {
        let mut is_bare = true;
        features.for_each_near(place, radius, |_| is_bare = false);
        is_bare
    };
    let (lowest, highest) = features.bounds();
    let mut found = Bareness {
        asked_count: 1,
        bare_count: usize::from(is_bare(position)),
        ..Bareness::default()
    };
    for direction in 0..BESIDE_COUNT {
        let angle = std::f64::consts::TAU * f64::from(direction) / f64::from(BESIDE_COUNT);
        let place = position + Vector2::new(angle.cos(), angle.sin()) * BESIDE_DISTANCE;
        if (0..2).all(|axis| (lowest[axis]..=highest[axis]).contains(&place[axis])) {
            found.beside_count += 1;
            found.bare_beside_count += usize::from(is_bare(&place));
        }
    }
    found
}

/// What several keyframes say together of the place where they put the own map.
pub(super) fn weigh(
    statements: &[Statement],
    anchor: &AnchorLandmarks,
    settings: &LocalizerSettings,
) -> Likeness {
    let testimonies = statements.iter().map(|one| one.testimony);
    let in_view = landmarks_in_view(testimonies.flat_map(|one| &one.landmarks));
    let depth_sum: f64 = statements.iter().map(|one| one.depth).sum();
    let reach = REACH_DEPTHS * depth_sum / statements.len().max(1) as f64;
    let (own_points, own_descriptors) = own_things(statements);
    let (points, descriptors) = landmarks_among(&own_points, statements, anchor, reach, settings);
    let own = Things::new(&own_points, &own_descriptors);
    let theirs = Things::new(&points, &descriptors);
    let gates = Gates {
        reach,
        bits_max: settings.search_distance_max,
    };
    let views = statements.iter().map(|one| &one.testimony.bareness);
    Likeness {
        bareness: Bareness::of_all(views).ratio(),
        ..Likeness::between([&own, &theirs], gates, [in_view])
    }
}

/// A landmark agrees if one of the keyframes shows it.
fn landmarks_in_view<'a>(witnesses: impl Iterator<Item = &'a Witness>) -> Evenness {
    let mut together: BTreeMap<(ChunkIdx, u32), (Vector3<f64>, bool)> = BTreeMap::new();
    for witness in witnesses {
        let key = (witness.chunk, witness.landmark_idx);
        let known = together.entry(key).or_insert((witness.point, false));
        known.1 |= witness.agrees;
    }
    let (points, agree): (Vec<_>, Vec<_>) = together.into_values().unzip();
    Evenness::of(&points, &agree)
}

/// What the keyframes show of the own map, in the anchor's, each point once.
fn own_things(statements: &[Statement]) -> (Vec<Vector3<f64>>, Vec<Descriptor>) {
    let mut known = BTreeSet::new();
    let mut things = Vec::new();
    for statement in statements {
        let placed = statement.anchor_from_camera;
        let edge = SAME_DEPTHS * statement.depth;
        for own in &statement.testimony.own_points {
            // Where it is now: since keyframes spoke, the own map may have moved.
            let point = placed * own.in_camera;
            let cell: [i64; 3] = (point / edge).map(|along| along.floor() as i64).into();
            if known.insert(cell) {
                things.push((point, own.descriptor));
            }
        }
    }
    things.into_iter().unzip()
}

/// The landmarks in the box around own points.
fn landmarks_among(
    own_points: &[Vector3<f64>],
    statements: &[Statement],
    anchor: &AnchorLandmarks,
    reach: f64,
    settings: &LocalizerSettings,
) -> (Vec<Vector3<f64>>, Vec<Descriptor>) {
    let (Some(first), Some(newest)) = (own_points.first(), statements.last()) else {
        return Default::default();
    };
    let margin = Vector3::repeat(reach);
    let lowest = own_points.iter().fold(*first, |low, one| low.inf(one)) - margin;
    let highest = own_points.iter().fold(*first, |high, one| high.sup(one)) + margin;
    let position = newest.anchor_from_camera.translation();
    let near = anchor.chunks_near(position, settings.predicted_landmark_count_max);
    let landmarks = near.into_iter().flat_map(|(_, stored)| stored.placed());
    let inside = landmarks.filter(|landmark| {
        let point = &landmark.point;
        (0..3).all(|axis| (lowest[axis]..=highest[axis]).contains(&point[axis]))
    });
    inside.map(|one| (one.point, one.descriptor)).unzip()
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    /// Goal: a point that two keyframes saw counts once, although the own map has moved between.
    /// Method: it is known where the keyframes are now; where they were then is not asked.
    #[test]
    fn a_point_counts_once_after_the_own_map_has_moved() {
        let sees = |point: Vector3<f64>| Testimony {
            own_points: vec![OwnPoint {
                in_camera: point,
                descriptor: Descriptor([0; 4]),
            }],
            ..Testimony::default()
        };
        let seen = [
            sees(Vector3::new(0.001, 0.001, 2.001)),
            sees(Vector3::new(-0.499, 0.001, 2.001)),
            sees(Vector3::new(-0.999, 0.001, 2.001)),
        ];
        let statements: Vec<Statement> = seen
            .iter()
            .zip([0.0, 0.5, 0.5])
            .map(|(testimony, x)| Statement {
                testimony,
                anchor_from_camera: Similarity::new(
                    1.0,
                    UnitQuaternion::identity(),
                    Vector3::new(x, 0.0, 0.0),
                ),
                depth: 2.0,
            })
            .collect();
        let (points, _) = own_things(&statements);
        assert_eq!(points.len(), 2, "{points:?}");
    }
}

use features::Descriptor;
use geometry::Timestamp;
use nalgebra::{Vector2, Vector3};

use super::*;
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, MapId, PointId, View};

/// A keyframe at the origin that sees a point of known range at each of these places.
fn map_of(points: &[Vector3<f64>]) -> (VslamMap, KeyframeId) {
    let observation = |point: &Vector3<f64>| Observation {
        position: point.xy() / point.z,
        position_px: Vector2::zeros(),
        sigma: 0.002,
        level: 0,
        angle_rad: 0.0,
        descriptor: Descriptor([0; 4]),
        point: None,
    };
    let frame = Frame {
        frame_idx: 0,
        captured_at: Timestamp::default(),
        observations: points.iter().map(observation).collect(),
        grid: PlaneGrid::default(),
    };
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let keyframe = map.add_keyframe(frame, Transform::identity());
    for (observation_idx, point) in (0..).zip(points) {
        let new = NewPoint {
            position_in_map: *point,
            covariance_in_map: Matrix3::identity(),
            parallax_rad: 0.1,
            expected_range: None,
        };
        let view = View {
            keyframe,
            observation_idx,
        };
        map.add_point(new, vec![view]);
    }
    (map, keyframe)
}

/// Points in a square of the image of this half-width, at depths of 3 and about.
fn points(count: usize, half_width: f64, depth_spread: f64) -> Vec<Vector3<f64>> {
    let at = |idx: usize| {
        let (column, row) = (idx % 5, idx / 5 % 4);
        let depth = 3.0 + depth_spread * ((idx * 7 % 11) as f64 / 5.0 - 1.0);
        let x = 0.4 + half_width * (column as f64 / 2.0 - 1.0);
        let y = half_width * (row as f64 / 1.5 - 1.0);
        Vector3::new(x, y, 1.0) * depth
    };
    (0..count).map(at).collect()
}

fn placed(points: &[Vector3<f64>]) -> bool {
    let (map, id) = map_of(points);
    is_placed(&map, map.keyframe(id).unwrap())
}

#[test]
fn a_few_points_far_apart_tell_a_place() {
    assert!(placed(&points(16, 0.5, 1.0)));
}

#[test]
fn points_in_one_corner_do_not_tell_a_place() {
    // Twice as many, but seen under 6°: a step and a turn look the same.
    assert!(!placed(&points(32, 0.05, 0.1)));
}

#[test]
fn a_handful_of_points_is_a_coincidence() {
    assert!(!placed(&points(11, 0.5, 1.0)));
    assert!(!placed(&[]));
}

#[test]
fn the_misfit_counts_standard_deviations_in_the_median() {
    let (map, id) = map_of(&points(16, 0.5, 1.0));
    let keyframe = map.keyframe(id).unwrap();
    let mut observations = keyframe.observations.clone();
    for (idx, observation) in observations.iter_mut().enumerate() {
        // One is wrong by far.
        let off = if idx == 3 { 900.0 } else { 0.7 };
        observation.position.x += off * observation.sigma;
    }
    let misfit_of =
        |observations: &[Observation]| misfit(&map, &Transform::identity(), observations);
    assert!((misfit_of(&observations).unwrap() - 0.7).abs() < 1e-9);
    assert_eq!(misfit_of(&[]), None);
}

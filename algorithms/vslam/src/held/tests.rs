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
    uncertain_map_of(points, |_| Matrix3::identity())
}

/// The same, each point with this covariance.
fn uncertain_map_of(
    points: &[Vector3<f64>],
    covariance: impl Fn(&Vector3<f64>) -> Matrix3<f64>,
) -> (VslamMap, KeyframeId) {
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
            covariance_in_map: covariance(point),
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

/// How uncertain a camera's place is that stands so far to the right of the keyframe, if points are
/// uncertain by this share of their range.
fn sigma_beside(step: f64, range_share: f64) -> f64 {
    let error = |point: &Vector3<f64>| point * point.transpose() * range_share.powi(2);
    let (map, id) = uncertain_map_of(&points(40, 0.5, 1.0), error);
    let camera_from_map = Transform::new(Default::default(), Vector3::x() * -step);
    let mut observations = map.keyframe(id).unwrap().observations.clone();
    for observation in &mut observations {
        let point = map.point(observation.point.unwrap()).unwrap();
        let in_camera = point.position_in_map - Vector3::x() * step;
        observation.position = in_camera.xy() / in_camera.z;
    }
    place_sigma(&map, &camera_from_map, &observations).unwrap()
}

#[test]
fn points_that_are_all_too_far_move_a_camera_that_stands_elsewhere() {
    // What is a tenth too far as seen from the keyframe is a larger copy: a camera 0.9 beside it
    // stands 0.09 too far from it, however many points say so. Beside that, what the points are
    // wrong by each for itself counts a little.
    let exact = sigma_beside(0.9, 0.0);
    assert!(exact < 0.01, "{exact}");
    let beside = sigma_beside(0.9, 0.1);
    assert!((0.09..0.12).contains(&beside), "{beside}");
    // Where the keyframe was the points lie in the same directions at any range.
    let there = sigma_beside(0.0, 0.1);
    assert!(
        (there / sigma_beside(0.0, 0.0) - 1.0).abs() < 1e-6,
        "{there}"
    );
}

#[test]
fn no_points_tell_no_place() {
    let (map, _) = map_of(&points(16, 0.5, 1.0));
    assert_eq!(place_sigma(&map, &Transform::identity(), &[]), None);
}

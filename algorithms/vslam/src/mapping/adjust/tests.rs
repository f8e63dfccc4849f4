use features::Descriptor;
use geometry::Timestamp;
use nalgebra::{UnitQuaternion, Vector2};

use super::*;
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::plane_grid::PlaneGrid;
use crate::{MapId, Observation, View};

/// Three cameras in a row that see two points; the first is fixed.
fn row() -> BundleProblem {
    let pose = |x: f64| BundlePose {
        camera_from_map: Transform::new(Default::default(), Vector3::new(-x, 0.0, 0.0)),
        fixed: x == 0.5,
    };
    let observation = |idx: usize| BundleObservation {
        pose_idx: idx % 3,
        point_idx: idx / 3,
        position: Vector2::zeros(),
        sigma: 0.01,
    };
    BundleProblem {
        poses: [0.5, 1.0, 1.5].map(pose).to_vec(),
        points: vec![Vector3::new(0.5, 0.0, 4.0), Vector3::new(1.0, 1.0, 5.0)],
        observations: (0..6).map(observation).collect(),
    }
}

/// The same, everything but the first camera moved away from it.
fn stretched(factor: f64) -> BundleProblem {
    let mut problem = row();
    let origin = Vector3::new(0.5, 0.0, 0.0);
    for pose in &mut problem.poses {
        let centre = -pose.camera_from_map.translation();
        let centre = origin + (centre - origin) * factor;
        pose.camera_from_map = Transform::new(Default::default(), -centre);
    }
    for point in &mut problem.points {
        *point = origin + (*point - origin) * factor;
    }
    problem
}

#[test]
fn a_free_scale_stays_as_it_was() {
    let mut after = stretched(0.6);
    let scale = keep_scale(&row(), &mut after);
    assert!((scale - 1.0 / 0.6).abs() < 1e-12);
    for (ours, before) in after.poses.iter().zip(row().poses) {
        let ours = ours.camera_from_map.translation();
        assert!((ours - before.camera_from_map.translation()).norm() < 1e-12);
    }
    for (ours, before) in after.points.iter().zip(row().points) {
        assert!((ours - before).norm() < 1e-12);
    }
}

#[test]
fn a_scale_that_two_keyframes_hold_is_what_they_say() {
    let (mut before, mut after) = (row(), stretched(0.6));
    before.poses[1].fixed = true;
    let adjusted = after.clone();
    assert!(keep_scale(&before, &mut after) == 1.0 && after == adjusted);
    // One that sees nothing holds nothing.
    before.observations.retain(|one| one.pose_idx != 1);
    assert!(keep_scale(&before, &mut after) > 1.5);
}

fn seen_from(centre: &Vector3<f64>, point: &Vector3<f64>) -> Vector2<f64> {
    let ray = point - centre;
    ray.xy() / ray.z
}

/// Where the camera that [`turning_camera`] adds last is.
const LAST_CENTRE: Vector3<f64> = Vector3::new(1.05, 0.0, 0.0);

/// Eight cameras in a row before a wall, with keypoints of this sigma. The last one sees the wall
/// in a strip at the edge of its image, as after a turn; `last` says where.
fn turning_camera(
    sigma: f64,
    last: impl Fn(usize, &Vector3<f64>) -> Vector2<f64>,
) -> (VslamMap, KeyframeId) {
    let point = |idx: usize| {
        let even = |step: f64| (0.5 + step * idx as f64).fract() - 0.5;
        let depth = 4.0 + 0.5 * even(0.323_1);
        Vector3::new(0.6 + 0.5 * even(0.754_878), 0.8 * even(0.569_840), 1.0) * depth
    };
    let points: Vec<Vector3<f64>> = (0..120).map(point).collect();
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let mut keyframes = Vec::new();
    for camera_idx in 0..8 {
        let is_last = camera_idx == 7;
        let centre = LAST_CENTRE * (camera_idx as f64 / 7.0);
        let observation = |(idx, point): (usize, &Vector3<f64>)| {
            let position = if is_last {
                last(idx, point)
            } else {
                seen_from(&centre, point)
            };
            Observation {
                position,
                position_px: Vector2::zeros(),
                sigma,
                level: 0,
                angle_rad: 0.0,
                descriptor: Descriptor([0; 4]),
                point: None,
            }
        };
        let frame = Frame {
            frame_idx: camera_idx,
            captured_at: Timestamp::default(),
            observations: points.iter().enumerate().map(observation).collect(),
            grid: PlaneGrid::default(),
        };
        keyframes.push(map.add_keyframe(frame, Transform::new(Default::default(), -centre)));
    }
    for (observation_idx, point) in (0..).zip(&points) {
        let new = NewPoint {
            position_in_map: *point,
            covariance_in_map: Matrix3::identity(),
            parallax_rad: 0.1,
            expected_range: None,
        };
        let view = |&keyframe: &KeyframeId| View {
            keyframe,
            observation_idx,
        };
        map.add_point(new, keyframes.iter().map(view).collect());
    }
    (map, keyframes[7])
}

#[test]
fn a_few_wrong_matches_do_not_move_a_keyframe() {
    let (mut map, newest) = turning_camera(0.004, |idx, point| {
        let wrong = if idx.is_multiple_of(10) { 0.12 } else { 0.0 };
        seen_from(&LAST_CENTRE, point) + Vector2::new(wrong, 0.0)
    });
    adjust_local(&mut map, newest, &mut Workspace::default());
    let keyframe = map.keyframe(newest).unwrap();
    let error = keyframe.centre_in_map() - LAST_CENTRE;
    assert!(error.norm() < 1e-3, "{error}");
    assert!(keyframe.points().count() == 108);
}

/// Goal: where a step with a turn explains the newest keyframe's images a little better, it stays
/// where it was tracked to; where it explains them much better, it follows. Method: its images are
/// those of a camera 20 cm aside that turned back by as much, with keypoints of two precisions.
#[test]
fn the_newest_keyframe_follows_no_valley() {
    let shift_m = |sigma: f64| {
        let aside = LAST_CENTRE + Vector3::x() * 0.2;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.036);
        let (mut map, id) = turning_camera(sigma, |_, point| {
            let ray = turn * (point - aside);
            ray.xy() / ray.z
        });
        adjust_local(&mut map, id, &mut Workspace::default());
        (map.keyframe(id).unwrap().centre_in_map() - LAST_CENTRE).norm()
    };
    assert!(shift_m(0.005) < 1e-9, "{}", shift_m(0.005));
    assert!(shift_m(0.0005) > 0.1, "{}", shift_m(0.0005));
}

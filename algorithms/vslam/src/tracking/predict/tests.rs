use features::Descriptor;
use nalgebra::{Matrix3, Vector2, Vector3};

use super::*;
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, MapId, Observation, PointId, View};

#[test]
fn a_camera_that_nothing_places_comes_to_rest() {
    // However far single poses jump while no point of known range is in sight, the camera is
    // expected to take ever smaller steps.
    let at = |frame: usize| Timestamp::from_seconds(frame as f64 * 0.1).unwrap();
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let empty = Frame {
        frame_idx: 0,
        captured_at: at(0),
        observations: Vec::new(),
        grid: PlaneGrid::default(),
    };
    let keyframe = map.add_keyframe(empty, Transform::identity());
    let frame = |idx: usize, x: f64| {
        let pose = Transform::new(UnitQuaternion::identity(), Vector3::new(-x, 0.0, 0.0));
        TrackedFrame {
            captured_at: at(idx),
            place: map.place(keyframe, &pose).unwrap(),
            observations: Vec::new(),
        }
    };
    let mut motion = Motion::starting_at(frame(0, 0.0));
    motion.speed_max = 1.0;
    let step = |motion: &Motion, idx: usize| {
        let whereabouts = motion.whereabouts(&map, at(idx)).unwrap();
        (whereabouts.expected_in_map - whereabouts.last_in_map).norm()
    };
    let mut steps = Vec::new();
    for idx in 1..6 {
        motion.advance(&map, frame(idx, 0.5 * (idx * idx) as f64));
        steps.push(step(&motion, idx + 1));
    }
    assert!(steps[0] <= 0.1, "{steps:?}");
    assert!(steps.windows(2).all(|pair| pair[1] < pair[0]), "{steps:?}");
    assert!(steps[4] > 0.0 && steps[4] < 0.03, "{steps:?}");
}

#[test]
fn a_doubtful_pose_must_fit_about_as_well_as_others() {
    let at = |frame: usize| Timestamp::from_seconds(frame as f64 * 0.1).unwrap();
    let position = |idx: usize| Vector2::new(0.1 * (idx % 5) as f64, 0.1 * (idx / 5) as f64);
    let observations = |sigmas_off: f64| -> Vec<Observation> {
        let observation = |idx| Observation {
            position: position(idx) + Vector2::x() * (0.002 * sigmas_off),
            position_px: Vector2::zeros(),
            sigma: 0.002,
            level: 0,
            angle_rad: 0.0,
            descriptor: Descriptor([0; 4]),
            point: None,
        };
        (0..20).map(observation).collect()
    };
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let first = Frame {
        frame_idx: 0,
        captured_at: at(0),
        observations: observations(0.0),
        grid: PlaneGrid::default(),
    };
    let keyframe = map.add_keyframe(first, Transform::identity());
    let mut points = Vec::new();
    for idx in 0..20 {
        let new = NewPoint {
            position_in_map: position(idx).push(1.0) * 3.0,
            covariance_in_map: Matrix3::identity(),
            parallax_rad: 0.1,
            expected_range: None,
        };
        let observation_idx = idx as u32;
        let view = View {
            keyframe,
            observation_idx,
        };
        points.push(map.add_point(new, vec![view]));
    }
    let frame = |idx: usize, sigmas_off: f64| {
        let mut observations = observations(sigmas_off);
        for (observation, point) in observations.iter_mut().zip(&points) {
            observation.point = Some(*point);
        }
        TrackedFrame {
            captured_at: at(idx),
            place: map.place(keyframe, &Transform::identity()).unwrap(),
            observations,
        }
    };
    let mut motion = Motion::starting_at(frame(0, 0.0));
    assert!(!motion.is_chance(Some(2.0)), "nothing is usual yet");
    for idx in 1..40 {
        // A single bad frame changes little of what is usual.
        motion.advance(&map, frame(idx, if idx == 30 { 1.5 } else { 0.4 }));
    }
    assert!(!motion.is_chance(Some(0.6)));
    assert!(motion.is_chance(Some(0.9)));
    // Whatever it is, where the frame shows what it should.
    assert!(!motion.is_chance(None));
    motion.turn = Some(UnitQuaternion::identity());
    assert!(!motion.is_chance(Some(0.9)), "a gyroscope vouches for it");
}

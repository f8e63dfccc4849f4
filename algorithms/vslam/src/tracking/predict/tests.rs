use nalgebra::Vector3;

use super::*;
use crate::frame::Frame;
use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, MapId, PointId};

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

use features::Descriptor;
use geometry::{Timestamp, Transform};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::*;
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, MapId, PointId, View};

/// Large enough that a short way decides.
const SIGMA: f64 = 0.02;
const POINTS: usize = 20;

/// At depths about 3, all over the image.
fn point(idx: usize) -> Vector3<f64> {
    let (column, row) = ((idx % 5) as f64, (idx / 5) as f64);
    Vector3::new(0.25 * column - 0.5, 0.3 * row - 0.45, 1.0) * (3.0 + 0.2 * column)
}

/// Keypoints that miss these points by half a standard deviation.
fn observations() -> Vec<Observation> {
    let observation = |idx| Observation {
        position: point(idx).xy() / point(idx).z + Vector2::x() * (0.5 * SIGMA),
        position_px: Vector2::zeros(),
        sigma: SIGMA,
        level: 0,
        angle_rad: 0.0,
        descriptor: Descriptor([0; 4]),
        point: None,
    };
    (0..POINTS).map(observation).collect()
}

/// A keyframe at the origin that sees exact points.
fn map() -> (VslamMap, KeyframeId) {
    let frame = Frame {
        frame_idx: 0,
        captured_at: Timestamp::default(),
        observations: observations(),
        grid: PlaneGrid::default(),
    };
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let keyframe = map.add_keyframe(frame, Transform::identity());
    for idx in 0..POINTS {
        let new = NewPoint {
            position_in_map: point(idx),
            covariance_in_map: Matrix3::zeros(),
            parallax_rad: 0.1,
            expected_range: None,
        };
        let observation_idx = idx as u32;
        map.add_point(
            new,
            vec![View {
                keyframe,
                observation_idx,
            }],
        );
    }
    (map, keyframe)
}

/// A camera that went straight on, in steps of this length.
fn steps(map: &VslamMap, keyframe: KeyframeId, count: usize, length: f64) -> Vec<FrameRecord> {
    let record = |idx| {
        let moved = Transform::new(Default::default(), Vector3::x() * (idx as f64 * length));
        FrameRecord {
            captured_at: Timestamp::default(),
            map_id: map.id(),
            place: map.place(keyframe, &moved),
            was_tracked: true,
        }
    };
    (0..=count).map(record).collect()
}

/// A frame where the keyframe is, and what it should show.
fn seen(map: &VslamMap, expected_count: usize) -> (Vec<Observation>, Tracked) {
    let mut seen = observations();
    for (one, point) in seen.iter_mut().zip(map.points()) {
        one.point = Some(point.id());
    }
    let tracked = Tracked {
        camera_from_map: Transform::identity(),
        covariance: None,
        inlier_count: POINTS,
        ranged_count: POINTS,
        expected_count,
        is_placed: true,
        doubtful_misfit: None,
        reference: KeyframeId(0),
    };
    (seen, tracked)
}

#[test]
fn a_camera_that_went_a_short_way_is_placed_well_or_not_at_all() {
    let (map, keyframe) = map();
    let (observations, tracked) = seen(&map, POINTS);
    let sigma = place_sigma(&map, &tracked.camera_from_map, &observations).unwrap();
    let sure = |count, length| {
        let trajectory = steps(&map, keyframe, count, length);
        is_sure(&map, &trajectory, (&observations, &tracked))
    };
    assert!(sure(9, 10.0 * sigma));
    assert!(!sure(7, 10.0 * sigma));
    // What may be noise is no way, however often it is added up.
    assert!(!sure(900, 0.0));
    let trembling = |idx: usize| if idx.is_multiple_of(2) { 0.0 } else { sigma };
    let mut trajectory = steps(&map, keyframe, 900, 0.0);
    for (idx, record) in trajectory.iter_mut().enumerate() {
        let moved = Transform::new(Default::default(), Vector3::x() * trembling(idx));
        record.place = map.place(keyframe, &moved);
    }
    assert!(!is_sure(&map, &trajectory, (&observations, &tracked)));
}

#[test]
fn a_camera_that_hovers_is_placed_by_what_it_sees() {
    let (map, _) = map();
    let (mut observations, tracked) = seen(&map, POINTS);
    assert!(!is_sure(&map, &[], (&observations, &tracked)));
    for observation in &mut observations {
        observation.sigma = 0.1 * SIGMA;
    }
    assert!(is_sure(&map, &[], (&observations, &tracked)));
}

#[test]
fn the_way_in_another_map_does_not_count() {
    let (map, keyframe) = map();
    let (observations, tracked) = seen(&map, POINTS);
    let mut trajectory = steps(&map, keyframe, 90, 1.0);
    for record in &mut trajectory {
        record.map_id = MapId(7);
    }
    assert!(!is_sure(&map, &trajectory, (&observations, &tracked)));
}

#[test]
fn few_of_many_that_should_be_there_are_of_another_place() {
    let (map, keyframe) = map();
    let trajectory = steps(&map, keyframe, 90, 1.0);
    let sure = |expected_count| {
        let (observations, tracked) = seen(&map, expected_count);
        is_sure(&map, &trajectory, (&observations, &tracked))
    };
    assert!(sure(3 * POINTS));
    assert!(!sure(4 * POINTS));
}

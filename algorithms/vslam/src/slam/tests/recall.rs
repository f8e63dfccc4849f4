//! Maps that are taken apart, put together, and continued.

use camera::Image;
use geometry::{Map, umeyama};
use nalgebra::Vector3;
use proptest::prelude::*;

use super::world::{self, Pose, World, camera};
use super::{machine, pose, stamp};
use crate::{
    LostReason, MapParts, MapPartsError, TrackingState, ViewParts, Vslam, VslamMap, VslamSettings,
};

fn reassemble(parts: &MapParts) -> Result<VslamMap, MapPartsError> {
    VslamMap::from_parts(parts, &camera(), &VslamSettings::default())
}

/// The machine after the first part of the walk.
fn first_session() -> Vslam {
    let world = World::new(7);
    let mut slam = machine();
    for frame in 0..45 {
        slam.process(&world.render(&pose(frame)), stamp(frame));
    }
    slam
}

#[test]
fn a_map_taken_apart_and_put_together_is_the_same() {
    let slam = first_session();
    let parts = slam.map().to_parts();
    assert!(parts.keyframes.len() >= 3 && parts.points.len() > 100);
    let map = reassemble(&parts).unwrap();
    assert_eq!(map.to_parts(), parts);
    for (one, other) in map
        .points()
        .zip(slam.map().points().filter(|one| one.has_range()))
    {
        assert_eq!(one.descriptor(), other.descriptor());
        assert_eq!(one.view_count(), other.view_count());
    }
    let observations = |map: &VslamMap| -> Vec<_> {
        let keyframes = map.keyframes().flat_map(|one| one.observations().to_vec());
        keyframes.map(|one| (one.position, one.sigma)).collect()
    };
    assert_eq!(observations(&map), observations(slam.map()));
}

#[test]
fn the_second_session_goes_on_in_the_frame_of_the_first() {
    let world = World::new(7);
    let first = first_session();
    let map = reassemble(&first.map().to_parts()).unwrap();
    let (id, keyframe_count) = (map.id(), map.keyframe_count());
    let mut second = Vslam::continuing(camera(), VslamSettings::default(), map);
    // Nothing is to be seen, then the camera goes on from where it was before, and further.
    let blank = Image::filled(world::WIDTH, world::HEIGHT, 90);
    let (report, _) = second.process(&blank, stamp(0));
    let expected = TrackingState::Lost {
        reason: LostReason::FewKeypoints,
    };
    assert_eq!((report.state, report.map_id), (expected, id));
    for frame in 1..40 {
        second.process(&world.render(&pose(29 + frame)), stamp(frame));
    }
    let tracked: Vec<_> = second
        .trajectory()
        .into_iter()
        .filter_map(|one| Some((one.frame_idx as usize, one.map_id, one.map_from_camera?)))
        .collect();
    assert!(tracked.len() >= 38, "{}", tracked.len());
    assert!(tracked.iter().all(|(_, map_id, _)| *map_id == id));
    assert!(second.map().keyframe_count() > keyframe_count);
    // The similarity of the first session holds for the second.
    let truth_from_map = umeyama::<Map, Map>(
        first.trajectory().iter().filter_map(|one| {
            let truth = pose(one.frame_idx as usize).position;
            Some((truth, *one.map_from_camera?.translation(), 1.0))
        }),
        true,
    )
    .unwrap();
    let error = |(frame, _, map_from_camera): &(usize, _, geometry::Transform<Map, _>)| {
        let estimate: Vector3<f64> = truth_from_map * *map_from_camera.translation();
        (pose(29 + frame).position - estimate).norm()
    };
    let worst = tracked.iter().map(error).fold(0.0, f64::max);
    assert!(worst < 0.03, "{worst} m");
}

#[test]
fn every_place_of_a_continued_map_is_recognised_at_first_sight() {
    // Along the wall and turning with it: the ends of the walk see next to nothing of its middle,
    // so that only the looks of the keyframes there can tell where it is.
    let pose = |frame: usize| Pose {
        position: Vector3::new(-4.5 + 0.06 * frame as f64, 0.0, 0.0),
        yaw_rad: -0.75 + 0.01 * frame as f64,
        pitch_rad: 0.0,
    };
    let world = World::new(7);
    let mut first = machine();
    for frame in 0..150 {
        first.process(&world.render(&pose(frame)), stamp(frame));
    }
    let parts = first.map().to_parts();
    let settings = VslamSettings::default();
    for frame in [20, 65, 75, 85, 130] {
        let map = reassemble(&parts).unwrap();
        let mut second = Vslam::continuing(camera(), settings.clone(), map);
        let (report, _) = second.process(&world.render(&pose(frame)), stamp(0));
        assert_eq!(report.state, TrackingState::Tracking, "{frame}");
    }
}

#[test]
fn a_place_that_is_not_in_the_map_begins_another_and_loses_none() {
    let strange = World::new(99);
    let map = reassemble(&first_session().map().to_parts()).unwrap();
    let kept = map.to_parts();
    let mut slam = Vslam::continuing(camera(), VslamSettings::default(), map);
    let id = slam.map().id();
    // Longer than the machine has patience.
    for frame in 0..120 {
        slam.process(&strange.render(&pose(frame % 60)), stamp(frame));
    }
    assert_ne!(slam.map().id(), id);
    assert_eq!(slam.largest_map().id(), id);
    assert_eq!(slam.largest_map().to_parts(), kept);
}

#[test]
fn parts_that_do_not_fit_together_are_refused() {
    let parts = first_session().map().to_parts();
    let refusal = |change: &dyn Fn(&mut MapParts)| {
        let mut changed = parts.clone();
        change(&mut changed);
        reassemble(&changed).unwrap_err().to_string()
    };
    type Change<'a> = &'a dyn Fn(&mut MapParts);
    let cases: [(Change<'_>, &str); 12] = [
        (&|one| one.keyframes.truncate(1), "1 keyframes and"),
        (&|one| one.points.clear(), "and 0 points are no map"),
        (&|one| one.keyframes[1].parent = None, "keyframe 1 has no"),
        (
            &|one| one.keyframes[1].parent = Some(1),
            "keyframe 1 has no",
        ),
        (
            &|one| one.keyframes[0].parent = Some(0),
            "keyframe 0 has no",
        ),
        (
            &|one| one.keyframes[1].keypoints[3].position_px.x = f64::NAN,
            "keypoint 3 of keyframe 1",
        ),
        (
            &|one| one.keyframes[1].keypoints[3].level = 200,
            "keypoint 3 of keyframe 1",
        ),
        (
            &|one| one.points[5].position_in_map.y = f64::NAN,
            "point 5 has numbers",
        ),
        (
            &|one| one.points[5].covariance_in_map[(0, 0)] = -1.0,
            "point 5 has numbers",
        ),
        (
            &|one| one.points[5].views.truncate(1),
            "point 5 is not seen by two",
        ),
        (
            &|one| one.points[5].views[0].keyframe_idx = 999,
            "of keyframe 999, which",
        ),
        (
            &|one| one.points[5].views[0] = one.points[4].views[0],
            "point 5 is seen as",
        ),
    ];
    for (change, expected) in cases {
        let message = refusal(change);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn damaged_parts_never_panic_and_what_is_taken_can_be_continued() {
    let parts = first_session().map().to_parts();
    let image = World::new(7).render(&pose(20));
    let keyframe_count = parts.keyframes.len() as u32;
    proptest!(ProptestConfig::with_cases(40), |(
        point_idx in 0..parts.points.len(),
        view in (0..keyframe_count + 1, 0..1200_u32),
        number in prop_oneof![Just(f64::MAX), Just(-1e11), Just(0.0), any::<f64>()],
        axis in 0..3_usize,
    )| {
        let mut changed = parts.clone();
        let point = &mut changed.points[point_idx];
        point.position_in_map[axis] = number;
        point.views[0] = ViewParts { keyframe_idx: view.0, keypoint_idx: view.1 };
        if let Ok(map) = reassemble(&changed) {
            let mut slam = Vslam::continuing(camera(), VslamSettings::default(), map);
            slam.process(&image, stamp(0));
        }
    });
}

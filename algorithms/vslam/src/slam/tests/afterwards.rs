//! Frames found afterwards, in a map that shows them well.

use nalgebra::Matrix3;

use super::world::World;
use super::{machine, pose, stamp};
use crate::frame::Frame;
use crate::slam::backfill::{Backfill, Missed};
use crate::slam::waiting::{Search, Waiting};
use crate::tracking::TrackedFrame;
use crate::trajectory::FrameRecord;
use crate::{MapPoint, PointId, Vslam};

/// A machine after a walk, and a frame from the middle of it that it does not know.
fn walked() -> (Vslam, Frame) {
    let world = World::new(7);
    let mut slam = machine();
    for frame in 0..40 {
        slam.process(&world.render(&pose(frame)), stamp(frame));
    }
    slam.finish();
    let extracted = slam.front_end.extract(&world.render(&pose(20)), stamp(40));
    let mut frame = slam.admit(extracted).unwrap();
    frame.frame_idx = 40;
    slam.trajectory.push(FrameRecord {
        captured_at: frame.captured_at,
        map_id: slam.map.id(),
        place: None,
        was_tracked: false,
    });
    (slam, frame)
}

/// Leaves a hundred metres uncertain of each point, and forgets that the frame was found.
fn doubt_points(slam: &mut Vslam) {
    slam.trajectory[40].place = None;
    let ids: Vec<PointId> = slam.map.points().map(MapPoint::id).collect();
    for id in ids {
        slam.map.point_mut(id).unwrap().covariance_in_map = Matrix3::identity() * 1e4;
    }
}

fn is_found_waiting(slam: &mut Vslam, frame: &Frame) -> bool {
    let mut waiting = Waiting::default();
    waiting.remember(frame);
    let mut search = Search {
        optics: &slam.optics,
        places: &slam.places,
        relocaliser: &mut slam.relocaliser,
        rng: &mut slam.rng,
    };
    waiting.finish(&mut search, &mut slam.map, &mut slam.trajectory);
    slam.trajectory[40].place.is_some()
}

#[test]
fn a_waiting_frame_has_a_place_only_if_that_is_certain() {
    let (mut slam, frame) = walked();
    assert!(is_found_waiting(&mut slam, &frame));
    doubt_points(&mut slam);
    assert!(!is_found_waiting(&mut slam, &frame));
}

#[test]
fn so_has_a_frame_before_the_start_and_it_leads_on_either_way() {
    let (mut slam, frame) = walked();
    let newest = slam.map.keyframes().find(|one| one.frame_idx >= Some(20));
    let newest = newest.unwrap();
    let later = TrackedFrame {
        captured_at: newest.captured_at,
        place: slam.map.place(newest.id, &newest.camera_from_map).unwrap(),
        observations: newest.observations.clone(),
    };
    let step = |slam: &mut Vslam| {
        let mut backfill = Backfill::default();
        backfill.remember(&frame);
        backfill.remember(&frame);
        backfill.begin(later.clone());
        let map = (&slam.optics, &mut slam.map);
        let missed = backfill.step(map, &mut slam.trajectory, &mut slam.rng);
        (missed, slam.trajectory[40].place.is_some(), backfill)
    };
    let (missed, found, _) = step(&mut slam);
    assert!(missed.is_none() && found);
    doubt_points(&mut slam);
    let (missed, found, backfill) = step(&mut slam);
    assert!(matches!(missed, Some(Missed::Unsure(_))) && !found);
    assert_eq!(backfill.leads_from(), Some(frame.captured_at));
}

//! The whole machine on small rendered worlds.

mod afterwards;
mod faults;
mod gyro;
mod recall;
mod world;

use camera::Image;
use geometry::{Map, Timestamp, umeyama};
use nalgebra::Vector3;

use self::world::{Pose, World, camera};
use crate::{
    FrameRefusal, FrameReport, LostReason, MappingReport, StartReason, TrackingState, Vslam,
    VslamSettings,
};

/// Frames per second of the made-up camera.
const RATE_HZ: f64 = 15.0;

fn stamp(frame: usize) -> Timestamp {
    Timestamp::from_seconds(frame as f64 / RATE_HZ).unwrap()
}

fn machine() -> Vslam {
    Vslam::new(camera(), VslamSettings::default())
}

/// Sideways along the wall with some turning, as a hovering vehicle would.
fn pose(frame: usize) -> Pose {
    let phase = frame as f64 * 0.05;
    Pose {
        position: Vector3::new(
            -0.8 + 0.03 * frame as f64,
            0.1 * phase.sin(),
            0.1 * phase.cos(),
        ),
        yaw_rad: 0.1 * phase.sin(),
        pitch_rad: 0.03 * (2.0 * phase).sin(),
    }
}

/// Forty frames of a walk, ten blank ones, and a return to the middle of the walk.
fn walk_blackout_return(slam: &mut Vslam) -> (Vec<FrameReport>, Vec<MappingReport>) {
    let images = walk_images();
    let processed = images.iter().enumerate();
    processed
        .map(|(frame, image)| slam.process(image, stamp(frame)))
        .unzip()
}

fn walk_images() -> Vec<Image> {
    let world = World::new(7);
    let image = |frame| match frame {
        0..40 => world.render(&pose(frame)),
        40..50 => Image::filled(world::WIDTH, world::HEIGHT, 90),
        _ => world.render(&pose(70 - frame)),
    };
    (0..60).map(image).collect()
}

#[test]
fn starts_tracks_loses_and_finds_itself_again() {
    let mut slam = machine();
    let (reports, mapped) = walk_blackout_return(&mut slam);
    let tracking = |range: std::ops::Range<usize>| {
        let frames = &reports[range];
        frames
            .iter()
            .filter(|one| one.state == TrackingState::Tracking)
            .count()
    };
    assert!(tracking(0..40) >= 28, "{:?}", states(&reports));
    assert_eq!(tracking(40..50), 0);
    assert!(tracking(50..60) >= 8, "{:?}", states(&reports));
    assert!(
        reports[40].state
            == TrackingState::Lost {
                reason: LostReason::FewKeypoints
            }
    );
    let keyframes: Vec<_> = mapped.iter().filter_map(|one| one.new_keyframe).collect();
    assert!(keyframes.len() >= 3);
    assert!(keyframes.is_sorted());
    // The pose of a report is what the caller may rely on: it comes with its uncertainty.
    let known = reports.iter().filter(|one| one.map_from_camera.is_some());
    assert!(
        known
            .skip(1)
            .all(|one| one.pose_covariance.is_some_and(|c| c.trace() > 0.0))
    );
}

#[test]
fn the_trajectory_is_that_of_the_camera_up_to_scale() {
    // A keypoint is off by a third of a pixel, so a point at 3 m by 3 mm and a pose from
    // a hundred of them by less; drift over 1 m of path adds to that.
    let mut slam = machine();
    walk_blackout_return(&mut slam);
    slam.finish();
    let pairs: Vec<(Vector3<f64>, Vector3<f64>, f64)> = slam
        .trajectory()
        .iter()
        .filter_map(|entry| {
            let frame = entry.frame_idx as usize;
            let truth = pose(if frame < 50 { frame } else { 70 - frame }).position;
            Some((truth, *entry.map_from_camera?.translation(), 1.0))
        })
        .collect();
    // The frames of the start-up are found afterwards, the blank ones are not.
    assert!(pairs.len() >= 45 && pairs.len() <= 50, "{}", pairs.len());
    let truth_from_map = umeyama::<Map, Map>(pairs.iter().copied(), true).unwrap();
    let worst = pairs
        .iter()
        .map(|(truth, estimate, _)| (truth - truth_from_map * *estimate).norm())
        .fold(0.0, f64::max);
    assert!(worst < 0.03, "{worst} m");
}

#[test]
fn a_quarter_of_the_pixels_do() {
    // 160×120 pixels. One of them is 31 mm at 4 m, and a pose rests on a hundred keypoints or more
    // that are off by half of that; drift over 2 m of path adds to it.
    let world = World::new(7);
    let mut slam = Vslam::new(world::coarse_camera(), VslamSettings::default());
    let frame_count = 70;
    for frame in 0..frame_count {
        let image = world::coarsened(&world.render(&pose(frame)));
        slam.process(&image, stamp(frame));
    }
    slam.finish();
    let (frames, worst) = found(&slam, |frame| pose(frame).position);
    assert!(frames.len() >= frame_count - 2, "{}", frames.len());
    assert!(worst < 0.03, "{worst} m");
}

#[test]
fn a_camera_that_comes_back_after_long_returns_to_its_map() {
    let world = World::new(7);
    let blank = Image::filled(world::WIDTH, world::HEIGHT, 90);
    let mut slam = machine();
    // Until the map is large enough to be kept, then longer than the machine has patience.
    for frame in 0..60 {
        slam.process(&world.render(&pose(frame)), stamp(frame));
    }
    let kept = (slam.map().id(), slam.map().keyframe_count());
    for frame in 60..140 {
        slam.process(&blank, stamp(frame));
    }
    assert_eq!(slam.map().keyframe_count(), 0, "a new map was begun");
    assert_eq!(
        (slam.largest_map().id(), slam.largest_map().keyframe_count()),
        kept
    );
    let back: Vec<_> = (140..150)
        .map(|frame| {
            slam.process(&world.render(&pose(180 - frame)), stamp(frame))
                .0
        })
        .collect();
    let last = back.last().unwrap();
    assert_eq!((last.state, last.map_id), (TrackingState::Tracking, kept.0));
}

/// The frames at which the trajectory of the largest map has a pose, and the worst error of its
/// positions after alignment to the truth.
fn found(slam: &Vslam, truth: impl Fn(usize) -> Vector3<f64>) -> (Vec<usize>, f64) {
    let largest = slam.largest_map().id();
    let posed: Vec<(usize, Vector3<f64>)> = slam
        .trajectory()
        .iter()
        .filter(|entry| entry.map_id == largest)
        .filter_map(|entry| {
            Some((
                entry.frame_idx as usize,
                *entry.map_from_camera?.translation(),
            ))
        })
        .collect();
    let pairs = posed
        .iter()
        .map(|(frame, place)| (truth(*frame), *place, 1.0));
    let truth_from_map = umeyama::<Map, Map>(pairs, true).unwrap();
    let errors = posed
        .iter()
        .map(|(frame, place)| (truth(*frame) - truth_from_map * *place).norm());
    let worst = errors.fold(0.0, f64::max);
    (posed.into_iter().map(|(frame, _)| frame).collect(), worst)
}

#[test]
fn maps_before_and_after_a_long_blackout_become_one() {
    // The second map begins where the first has not been; then the camera goes back.
    let world = World::new(7);
    let blank = Image::filled(world::WIDTH, world::HEIGHT, 90);
    let step = |frame: usize| match frame {
        0..50 => frame,
        50..130 => 50,
        // From where the first map ends on, and back into it.
        130..175 => 62 + (frame - 130) / 2,
        _ => 84_usize.saturating_sub(frame - 175),
    };
    let mut slam = machine();
    let mut ids = Vec::new();
    for frame in 0..230 {
        let image = match frame {
            50..130 => blank.clone(),
            _ => world.render(&pose(step(frame))),
        };
        ids.push(slam.process(&image, stamp(frame)).1.map_id);
    }
    slam.finish();
    assert!(ids[0] == ids[229], "the larger, earlier map keeps its name");
    assert!(
        ids.iter().any(|id| *id != ids[0]),
        "another map was begun: {ids:?}"
    );
    let (frames, worst) = found(&slam, |frame| pose(step(frame)).position);
    let seen = (0..230).filter(|frame| !(50..130).contains(frame)).count();
    assert!(frames.len() >= seen - 8, "{} of {seen}", frames.len());
    assert!(frames.iter().all(|frame| !(50..130).contains(frame)));
    assert!(worst < 0.05, "{worst} m");
}

#[test]
fn frames_of_a_place_that_is_mapped_later_are_found_then() {
    // The camera looks for four frames at what it reaches only six seconds later. A second passes
    // before and after, for which there are no images: a camera does not jump.
    let world = World::new(7);
    let at =
        |frame: usize| stamp(frame + 30 * (usize::from(frame >= 40) + usize::from(frame >= 44)));
    let ahead = 40..44;
    let step = |frame: usize| match frame {
        0..40 => 2 * frame,
        40..44 => 2 * (frame + 90),
        _ => 2 * (frame - 4),
    };
    let mut slam = machine();
    let mut lost = Vec::new();
    for frame in 0..142 {
        let (report, _) = slam.process(&world.render(&pose(step(frame))), at(frame));
        if matches!(report.state, TrackingState::Lost { .. }) {
            lost.push(frame);
        }
    }
    assert!(ahead.clone().all(|frame| lost.contains(&frame)), "{lost:?}");
    slam.finish();
    let (frames, worst) = found(&slam, |frame| pose(step(frame)).position);
    assert!(
        ahead.clone().all(|frame| frames.contains(&frame)),
        "{frames:?}"
    );
    // A map drifts by one or two hundredths of the way, which is 8 m.
    assert!(worst < 0.16, "{worst} m");
}

#[test]
fn two_runs_agree_bit_for_bit() {
    let (mut first, mut second) = (machine(), machine());
    assert_eq!(
        walk_blackout_return(&mut first),
        walk_blackout_return(&mut second)
    );
    assert_eq!(first.trajectory(), second.trajectory());
}

#[test]
fn extraction_ahead_changes_nothing() {
    // Each image is extracted by another front end before the last frame is mapped.
    let images = walk_images();
    let (mut inline, mut ahead) = (machine(), machine());
    let mut front_end = ahead.front_end();
    let mut extracted = Some(front_end.extract(&images[0], stamp(0)));
    for (frame, image) in images.iter().enumerate() {
        let report = ahead.track(extracted.take().unwrap());
        let next = images.get(frame + 1);
        extracted = next.map(|image| front_end.extract(image, stamp(frame + 1)));
        let mapped = ahead.map_frame();
        assert_eq!((report, mapped), inline.process(image, stamp(frame)));
    }
    assert_eq!(inline.trajectory(), ahead.trajectory());
}

#[test]
fn the_pose_is_out_before_the_map_grows() {
    let mut slam = machine();
    let mut front_end = slam.front_end();
    let mut insertion_count = 0;
    for (frame, image) in walk_images().iter().enumerate() {
        let before = slam.map().keyframe_count();
        slam.track(front_end.extract(image, stamp(frame)));
        if before > 0 {
            assert_eq!(slam.map().keyframe_count(), before, "frame {frame}");
        }
        let mapped = slam.map_frame();
        let pose = mapped.new_keyframe.map(|id| {
            insertion_count += usize::from(before > 0);
            slam.map().keyframe(id).unwrap().map_from_camera()
        });
        assert_eq!(mapped.map_from_keyframe, pose);
        // There is nothing left to do.
        assert_eq!(slam.map_frame().new_keyframe, None);
    }
    assert!(insertion_count > 0);
}

#[test]
fn mapping_that_was_left_out_is_made_up_for() {
    let images = walk_images();
    let (mut patient, mut hasty) = (machine(), machine());
    let mut front_end = hasty.front_end();
    for (frame, image) in images.iter().enumerate() {
        let (expected, _) = patient.process(image, stamp(frame));
        assert_eq!(
            hasty.track(front_end.extract(image, stamp(frame))),
            expected
        );
    }
}

#[test]
fn the_map_is_consistent() {
    let mut slam = machine();
    walk_blackout_return(&mut slam);
    let map = slam.map();
    for point in map.points() {
        assert!(point.view_count() >= 2);
        assert!(
            point
                .covariance_in_map()
                .iter()
                .all(|value| value.is_finite())
        );
        for view in point.views() {
            let keyframe = map.keyframe(view.keyframe).unwrap();
            let observation = &keyframe.observations()[view.observation_idx as usize];
            assert_eq!(observation.point, Some(point.id()));
        }
    }
    for keyframe in map.keyframes() {
        for (idx, observation) in keyframe.observations().iter().enumerate() {
            let Some(point) = observation.point else {
                continue;
            };
            let views = map.point(point).unwrap().views();
            assert!(views.iter().any(|view| {
                view.keyframe == keyframe.id() && view.observation_idx as usize == idx
            }));
        }
    }
}

#[test]
fn settled_keyframes_are_named_once() {
    let mut slam = machine();
    let (_, mapped) = walk_blackout_return(&mut slam);
    let settled: Vec<_> = mapped.iter().flat_map(|one| one.settled.clone()).collect();
    let mut unique = settled.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), settled.len());
}

#[test]
fn turning_on_the_spot_is_no_start() {
    let world = World::new(3);
    let mut slam = machine();
    for frame in 0..15 {
        let turned = Pose {
            position: Vector3::zeros(),
            yaw_rad: 0.01 * frame as f64,
            pitch_rad: 0.0,
        };
        let (report, _) = slam.process(&world.render(&turned), stamp(frame));
        assert!(
            matches!(report.state, TrackingState::Starting { .. }),
            "frame {frame}"
        );
    }
}

#[test]
fn a_turn_to_what_was_never_seen_from_elsewhere_is_followed_and_said() {
    // Goal: a camera that turns on the spot by its whole field of view, so that nothing that it
    // sees has any parallax, claims no place there, and is in its map at once when it turns back.
    let world = World::new(5);
    let mut slam = machine();
    let (walk, away) = (45, 34);
    let turned = |frame: usize| {
        let since = frame.saturating_sub(walk);
        0.035 * away.min(since).min((2 * away).saturating_sub(since)) as f64
    };
    let mut unplaced_count = 0;
    for frame in 0..walk + 2 * away {
        let shot = Pose {
            position: pose(frame.min(walk)).position,
            yaw_rad: -turned(frame),
            pitch_rad: 0.0,
        };
        let state = slam.process(&world.render(&shot), stamp(frame)).0.state;
        let unplaced = TrackingState::Lost {
            reason: LostReason::OnlyDirections,
        };
        if frame >= walk {
            assert!(
                state == TrackingState::Tracking || state == unplaced,
                "frame {frame}: {state}"
            );
            unplaced_count += usize::from(state == unplaced);
        }
        if turned(frame) < 0.3 && frame >= walk {
            assert_eq!(state, TrackingState::Tracking, "frame {frame}");
        }
    }
    assert!(unplaced_count > 3, "{unplaced_count}");
    let trajectory = slam.trajectory();
    let [first, last] = [walk, walk + 2 * away - 1].map(|frame| {
        let pose = trajectory[frame].map_from_camera;
        pose.expect("both ends of the turn are tracked")
    });
    let motion = first.inverse() * last;
    let turn_rad = motion.rotation().angle();
    assert!((turn_rad - 0.035).abs() < 0.01, "turned by {turn_rad} rad");
    // In depths of what was seen first.
    assert!(motion.translation().norm() < 0.02, "{motion:?}");
    assert!(slam.map().points().any(|point| !point.has_range()));
}

#[test]
fn a_long_wait_before_the_start_is_found_afterwards() {
    // A vehicle that stands for longer than the frames before a start are remembered for it.
    let world = World::new(7);
    let waiting = 140;
    let mut slam = machine();
    for frame in 0..waiting + 40_usize {
        let shot = pose(frame.saturating_sub(waiting));
        slam.process(&world.render(&shot), stamp(frame));
    }
    slam.finish();
    let trajectory = slam.trajectory();
    let missing = trajectory
        .iter()
        .filter(|one| one.map_from_camera.is_none());
    assert_eq!(missing.count(), 0);
}

#[test]
fn images_without_content_are_no_start() {
    let mut slam = machine();
    let mut noise = 1_u32;
    for frame in 0..6 {
        let mut image = Image::filled(world::WIDTH, world::HEIGHT, 128);
        if frame >= 3 {
            for pixel in image.pixels_mut() {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *pixel = (noise >> 24) as u8;
            }
        }
        let (report, _) = slam.process(&image, stamp(frame));
        assert!(matches!(report.state, TrackingState::Starting { .. }));
        assert_eq!(report.map_from_camera, None);
    }
    assert_eq!(slam.map().keyframe_count(), 0);
}

#[test]
fn wrong_sizes_and_stamps_are_refused_and_change_nothing() {
    let world = World::new(7);
    let mut slam = machine();
    slam.process(&world.render(&pose(0)), stamp(5));
    let refused =
        |slam: &mut Vslam, image: &Image, frame: usize| slam.process(image, stamp(frame)).0.state;
    for (width, height) in [(1, 1), (world::WIDTH, world::HEIGHT - 1), (640, 480)] {
        let state = refused(&mut slam, &Image::filled(width, height, 0), 6);
        let TrackingState::Starting {
            reason: StartReason::Refused(refusal),
        } = state
        else {
            panic!("{state}");
        };
        let expected = (world::WIDTH, world::HEIGHT);
        assert_eq!(
            refusal,
            FrameRefusal::ImageSize {
                got: (width, height),
                expected
            }
        );
    }
    let early = refused(&mut slam, &world.render(&pose(1)), 5);
    assert_eq!(
        early.to_string(),
        "starting: the frame is not newer than the one before"
    );
    // The frame is still the first reference: the walk that follows starts from it.
    let reports: Vec<_> = (1..30)
        .map(|frame| {
            slam.process(&world.render(&pose(frame)), stamp(10 + frame))
                .0
        })
        .collect();
    assert!(reports.last().unwrap().state == TrackingState::Tracking);
    assert_eq!(slam.trajectory().len(), 34);
}

fn states(reports: &[FrameReport]) -> Vec<String> {
    reports.iter().map(|one| one.state.to_string()).collect()
}

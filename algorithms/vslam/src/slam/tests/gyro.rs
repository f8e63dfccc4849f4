//! A gyroscope and an accelerometer beside the camera.

use camera::Image;
use geometry::{Map, Timestamp, umeyama};
use nalgebra::{Matrix3, Vector3};

use super::world::{self, Pose, World};
use super::{RATE_HZ, machine, pose, stamp};
use crate::{FrameReport, GyroFault, GyroState, ImuSample, LostReason, TrackingState, Vslam};

/// Frames of the walk before the jerks, and of these.
const WALK_FRAMES: usize = 41;
const JERKS: usize = 30;
/// Readings between two frames.
const SAMPLES_PER_FRAME: usize = 40;

/// What is wrong with a gyroscope.
#[derive(Clone, Copy)]
struct Flaws {
    bias: Vector3<f64>,
    noise: f64,
    /// What its readings are multiplied by: another unit, other axes.
    told_from_true: Matrix3<f64>,
}

impl Default for Flaws {
    fn default() -> Self {
        Self {
            bias: Vector3::zeros(),
            noise: 0.0,
            told_from_true: Matrix3::identity(),
        }
    }
}

/// Flies along the poses; with a gyroscope unless there are no `flaws` to speak of.
fn fly(images: &[Image], poses: &[Pose], flaws: Option<Flaws>) -> (Vslam, Vec<FrameReport>) {
    let mut slam = machine();
    let mut reports = Vec::new();
    for (frame, here) in poses.iter().enumerate().take(images.len()) {
        if let (Some(flaws), true) = (flaws, frame > 0) {
            feed(&mut slam, frame, (&poses[frame - 1], here), flaws);
        }
        reports.push(slam.process(&images[frame], stamp(frame)).0);
    }
    (slam, reports)
}

/// Motion blur along the rows.
fn smeared(mut image: Image, smear_px: usize) -> Image {
    let width = image.width();
    for row in image.pixels_mut().chunks_mut(width) {
        let sharp = row.to_vec();
        for (x, pixel) in row.iter_mut().enumerate() {
            let seen = &sharp[x..width.min(x + smear_px)];
            let sum: usize = seen.iter().map(|shade| usize::from(*shade)).sum();
            *pixel = (sum / seen.len()) as u8;
        }
    }
    image
}

fn render(poses: &[Pose]) -> Vec<Image> {
    let world = World::new(7);
    poses.iter().map(|pose| world.render(pose)).collect()
}

fn feed(slam: &mut Vslam, frame: usize, (before, here): (&Pose, &Pose), flaws: Flaws) {
    let earlier_from_later = before.world_from_camera().inverse() * here.world_from_camera();
    let rate = earlier_from_later.scaled_axis() * RATE_HZ;
    let up_in_world = -Vector3::y();
    for idx in 1..=SAMPLES_PER_FRAME {
        let share = idx as f64 / SAMPLES_PER_FRAME as f64;
        let seconds = (frame as f64 - 1.0 + share) / RATE_HZ;
        let phase = 1000.0 * seconds;
        let noise = Vector3::new(phase.sin(), (1.7 * phase).sin(), (2.9 * phase).sin());
        let taken = slam.take_imu(ImuSample {
            captured_at: Timestamp::from_seconds(seconds).unwrap(),
            rate_in_camera: flaws.told_from_true * (rate + flaws.bias + noise * flaws.noise),
            specific_force_in_camera: Some(here.world_from_camera().inverse() * up_in_world * 9.8),
        });
        assert!(taken);
    }
}

fn tracking_count(reports: &[FrameReport]) -> usize {
    let tracking = |one: &&FrameReport| one.state == TrackingState::Tracking;
    reports.iter().filter(tracking).count()
}

/// A walk along a wall on which every half metre looks alike, then jerks to the sides: each by more
/// than constant velocity can be wrong.
fn walk_and_jerks(factor: f64) -> Vec<Pose> {
    let jerks = [0.0, 0.2, -0.1, 0.15, -0.15, 0.1, -0.2, 0.05, 0.25, -0.05];
    let jerky = (0..JERKS).map(|idx| Pose {
        yaw_rad: factor * jerks[idx % jerks.len()],
        ..pose(WALK_FRAMES - 1)
    });
    (0..WALK_FRAMES).map(pose).chain(jerky).collect()
}

/// Frames of the jerks at which the camera looks where it does; what repeats lies 0.2 rad apart.
fn right_count(slam: &Vslam, poses: &[Pose], reports: &[FrameReport]) -> usize {
    let Some(first) = slam.map().keyframes().next() else {
        return 0;
    };
    let first_idx = first.frame_idx().unwrap() as usize;
    let world_from_map = poses[first_idx].world_from_camera();
    let right = reports
        .iter()
        .zip(poses)
        .skip(WALK_FRAMES)
        .filter(|(report, pose)| {
            report.map_from_camera.is_some_and(|map_from_camera| {
                let estimate = map_from_camera.rotation().to_rotation_matrix();
                let error = (world_from_map * estimate).rotation_to(&pose.world_from_camera());
                error.angle() < 0.1
            })
        });
    right.count()
}

#[test]
fn fast_turns_are_followed_with_a_gyroscope() {
    // Patches that repeat, smeared as by the turn: descriptors alone go wrong now and then.
    let (mut blind_count, mut guided_count) = (0, 0);
    for factor in [1.0, 1.6] {
        let world = World::repeating(7, 2);
        let poses = walk_and_jerks(factor);
        let image = |frame: usize| {
            let sharp = world.render(&poses[frame]);
            if frame < WALK_FRAMES {
                sharp
            } else {
                smeared(sharp, 13)
            }
        };
        let images: Vec<Image> = (0..poses.len()).map(image).collect();
        let (slam, reports) = fly(&images, &poses, None);
        blind_count += right_count(&slam, &poses, &reports);
        let (slam, reports) = fly(&images, &poses, Some(Flaws::default()));
        guided_count += right_count(&slam, &poses, &reports);
        assert_eq!(slam.gyro_state(), GyroState::Confirmed);
    }
    assert!(guided_count >= 2 * JERKS - 1, "{guided_count}");
    assert!(blind_count <= guided_count, "{blind_count}");
}

#[test]
fn a_turn_in_the_dark_is_followed_with_a_gyroscope() {
    // Ten black frames, and behind them a smeared view that descriptors alone do not recognise.
    let dark = WALK_FRAMES..WALK_FRAMES + 10;
    let last = pose(WALK_FRAMES - 1);
    let turning = (0..JERKS + dark.len()).map(|idx| Pose {
        yaw_rad: last.yaw_rad + 0.055 * idx.min(10) as f64,
        ..last
    });
    let poses: Vec<Pose> = (0..WALK_FRAMES).map(pose).chain(turning).collect();
    let world = World::repeating(9, 2);
    let image = |frame: usize| match frame {
        _ if dark.contains(&frame) => Image::filled(world::WIDTH, world::HEIGHT, 10),
        0..WALK_FRAMES => world.render(&poses[frame]),
        _ => smeared(world.render(&poses[frame]), 13),
    };
    let images: Vec<Image> = (0..poses.len()).map(image).collect();
    let (slam, reports) = fly(&images, &poses, None);
    let blind_count = right_count(&slam, &poses, &reports);
    assert!(blind_count < JERKS / 2, "{blind_count}");
    let (slam, reports) = fly(&images, &poses, Some(Flaws::default()));
    assert!(right_count(&slam, &poses, &reports) >= JERKS - 2);
}

#[test]
fn a_pose_against_the_gyroscope_is_refused_for_a_while() {
    let poses: Vec<Pose> = (0..60).map(pose).collect();
    let images = render(&poses);
    let (mut slam, reports) = fly(&images[..40], &poses, Some(Flaws::default()));
    assert_eq!(reports[39].state, TrackingState::Tracking);
    // The gyroscope says that the camera turned by half a radian; the images do not.
    let astray = Pose {
        yaw_rad: poses[39].yaw_rad + 0.5,
        ..poses[39]
    };
    feed(&mut slam, 40, (&poses[39], &astray), Flaws::default());
    let states: Vec<TrackingState> = (40..60)
        .map(|frame| {
            if frame > 40 {
                let before = (&poses[frame - 1], &poses[frame]);
                feed(&mut slam, frame, before, Flaws::default());
            }
            slam.process(&images[frame], stamp(frame)).0.state
        })
        .collect();
    let refused = TrackingState::Lost {
        reason: LostReason::AgainstGyroscope,
    };
    assert_eq!(states[0], refused);
    assert_eq!(*states.last().unwrap(), TrackingState::Tracking);
}

#[test]
fn a_poor_gyroscope_does_no_harm() {
    let poses: Vec<Pose> = (0..60).map(pose).collect();
    let images = render(&poses);
    let poor = Flaws {
        bias: Vector3::new(0.02, -0.02, 0.02),
        noise: 0.02,
        ..Flaws::default()
    };
    let (_, without) = fly(&images, &poses, None);
    let (mut slam, with) = fly(&images, &poses, Some(poor));
    assert!(tracking_count(&with) + 1 >= tracking_count(&without));
    slam.finish();
    let pairs: Vec<(Vector3<f64>, Vector3<f64>, f64)> = slam
        .trajectory()
        .iter()
        .filter_map(|one| {
            let truth = poses[one.frame_idx as usize].position;
            Some((truth, *one.map_from_camera?.translation(), 1.0))
        })
        .collect();
    assert!(pairs.len() >= 58, "{}", pairs.len());
    let truth_from_map = umeyama::<Map, Map>(pairs.iter().copied(), true).unwrap();
    let errors = pairs
        .iter()
        .map(|(truth, estimate, _)| (truth - truth_from_map * *estimate).norm());
    let worst = errors.fold(0.0, f64::max);
    assert!(worst < 0.03, "{worst} m");
}

/// Goal: with a wrong gyroscope the camera does as well as with none, from the start on, and it is
/// said what is wrong. Method: a walk that turns about all axes, and faster in the end.
#[test]
fn a_gyroscope_that_the_pictures_contradict_is_left_alone() {
    let swaying = |frame: usize| {
        let (seconds, walk) = (frame as f64 / RATE_HZ, pose(frame));
        let sway = if frame < WALK_FRAMES { 0.05 } else { 0.15 };
        Pose {
            yaw_rad: walk.yaw_rad + sway * (2.5 * seconds).sin(),
            pitch_rad: walk.pitch_rad + 0.05 * (3.1 * seconds).sin(),
            ..walk
        }
    };
    let poses: Vec<Pose> = (0..75).map(swaying).collect();
    let images = render(&poses);
    let (_, without) = fly(&images, &poses, None);
    let without_count = tracking_count(&without);
    assert!(without_count > 60, "{without_count}");
    let degrees = Matrix3::identity() * 1_f64.to_degrees();
    let other_axes = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
    for (told_from_true, is_scaled) in [
        (degrees, true),
        (other_axes, false),
        (-Matrix3::identity(), false),
    ] {
        let flaws = Flaws {
            told_from_true,
            ..Flaws::default()
        };
        let (slam, with) = fly(&images, &poses, Some(flaws));
        let with_count = tracking_count(&with);
        assert!(with_count >= without_count, "{with_count} {told_from_true}");
        match slam.gyro_state() {
            GyroState::Refuted(GyroFault::Scale { factor }) if is_scaled => {
                assert!((factor / 1_f64.to_degrees() - 1.0).abs() < 0.3, "{factor}");
            }
            state => assert_eq!(state, GyroState::Refuted(GyroFault::Axes)),
        }
        assert_eq!(slam.up_in_map(), None);
    }
    let (slam, with) = fly(&images, &poses, Some(Flaws::default()));
    assert_eq!(slam.gyro_state(), GyroState::Confirmed);
    assert!(tracking_count(&with) >= without_count);
}

/// Goal: a gyroscope that was right and fails costs a young map some frames, not its life. Method:
/// one that tells half a radian too much, once, over a map of a few keyframes.
#[test]
fn a_young_map_outlives_a_gyroscope_that_fails() {
    // At a few steps along the wall the camera looks about.
    let looking_about = |frame: usize| {
        let seconds = frame as f64 / RATE_HZ;
        Pose {
            position: pose(frame.min(12)).position,
            yaw_rad: 0.06 * (2.5 * seconds).sin(),
            pitch_rad: 0.04 * (3.1 * seconds).sin(),
        }
    };
    let poses: Vec<Pose> = (0..80).map(looking_about).collect();
    let images = render(&poses);
    let (mut slam, reports) = fly(&images[..60], &poses, Some(Flaws::default()));
    assert_eq!(reports[59].state, TrackingState::Tracking);
    assert_eq!(slam.gyro_state(), GyroState::Confirmed);
    let (map_id, keyframe_count) = (slam.map().id(), slam.map().keyframe_count());
    assert!(keyframe_count < 6, "{keyframe_count}");
    let astray = Pose {
        yaw_rad: poses[59].yaw_rad + 0.5,
        ..poses[59]
    };
    feed(&mut slam, 60, (&poses[59], &astray), Flaws::default());
    let mut last = None;
    for frame in 60..80 {
        if frame > 60 {
            let before = (&poses[frame - 1], &poses[frame]);
            feed(&mut slam, frame, before, Flaws::default());
        }
        last = Some(slam.process(&images[frame], stamp(frame)).0);
    }
    let last = last.unwrap();
    assert_eq!((last.state, last.map_id), (TrackingState::Tracking, map_id));
}

#[test]
fn up_is_known_in_the_map() {
    let poses: Vec<Pose> = (0..70).map(pose).collect();
    let images = render(&poses);
    let (without, _) = fly(&images, &poses, None);
    assert_eq!(without.up_in_map(), None);
    let (slam, _) = fly(&images, &poses, Some(Flaws::default()));
    // The map's axes are those of its first keyframe's camera.
    let first = slam.map().keyframes().next().unwrap();
    let frame = first.frame_idx().unwrap() as usize;
    let expected = poses[frame].world_from_camera().inverse() * -Vector3::y();
    let up = slam.up_in_map().unwrap();
    assert!(up.dot(&expected) > 0.01_f64.cos(), "{up:?} {expected:?}");
}

use nalgebra::Vector3;

use super::*;
use crate::world::Surroundings;

fn recording(world: RecordingWorld, seed: u64, conditions: &[Condition]) -> Recording {
    Recording::new(RecordingSettings {
        world,
        seed,
        conditions: conditions.to_vec(),
        frame_count_max: None,
    })
}

fn positions(recording: &Recording) -> Vec<Vector3<f64>> {
    let truth = recording.truth();
    truth.map(|(_, pose)| *pose.translation()).collect()
}

fn length_m(positions: &[Vector3<f64>]) -> f64 {
    let steps = positions.windows(2);
    steps.map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// How far a camera turns in all, radians.
fn turned_rad(recording: &Recording) -> f64 {
    let poses: Vec<_> = recording.truth().map(|(_, pose)| pose).collect();
    let steps = poses.windows(2);
    steps
        .map(|pair| pair[0].rotation().angle_to(pair[1].rotation()))
        .sum()
}

#[test]
fn no_camera_goes_through_anything() {
    for world in RecordingWorld::ALL {
        for seed in 1..=2 {
            let recording = recording(world, seed, &[]);
            let surroundings = Surroundings::new(&recording.stage.world);
            let positions = positions(&recording);
            let stride = (positions.len() / 25).max(1);
            for (idx, position) in positions.iter().enumerate().step_by(stride) {
                let clearance_m = surroundings.clearance_m(position);
                let name = world.name();
                assert!(
                    clearance_m > 0.15,
                    "{name} {seed} at {idx}: {clearance_m} m"
                );
            }
            for pair in positions.windows(2).step_by(stride) {
                assert!(surroundings.sees(&pair[0], &pair[1]));
            }
        }
    }
}

#[test]
fn a_camera_that_stays_only_turns() {
    for seed in 1..=3 {
        let still = recording(RecordingWorld::Still, seed, &[]);
        let positions = positions(&still);
        let way_max_m = positions.iter().map(|one| (one - positions[0]).norm());
        assert!(way_max_m.fold(0.0, f64::max) < 0.04);
        assert!(turned_rad(&still) > 0.5);
    }
}

#[test]
fn routes_are_what_they_are_named_for() {
    for seed in 1..=3 {
        let way_m = |world| length_m(&positions(&recording(world, seed, &[])));
        let office_m = way_m(RecordingWorld::Office);
        assert!((25.0..75.0).contains(&office_m), "{seed}: {office_m} m");
        let corridor = recording(RecordingWorld::Corridor, seed, &[]);
        let corridor_m = positions(&corridor);
        assert!((300.0..345.0).contains(&length_m(&corridor_m)));
        // The end overlaps the beginning.
        let last = corridor_m.last().unwrap();
        let back = corridor_m
            .iter()
            .position(|place| (place - last).norm() < 0.7);
        assert!(back.is_some_and(|idx| idx > 30 && idx < corridor_m.len() / 4));
        let handheld = recording(RecordingWorld::Handheld, seed, &[]);
        assert!(turned_rad(&handheld) > 8.0);
        let places = positions(&handheld);
        let span_m = |axis: usize| {
            let along = places.iter().map(|place| place[axis]);
            let most = along.clone().fold(f64::MIN, f64::max);
            most - along.fold(f64::MAX, f64::min)
        };
        assert!(span_m(0).max(span_m(1)) < 2.2);
        let board = positions(&recording(RecordingWorld::Board, seed, &[]));
        let fastest = board
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).norm() * 30.0);
        assert!((0.4..1.5).contains(&fastest.fold(0.0, f64::max)));
    }
}

#[test]
fn a_seed_gives_one_recording_and_another_seed_another() {
    let first = |seed| {
        let settings = RecordingSettings {
            world: RecordingWorld::Board,
            seed,
            conditions: Condition::ALL.to_vec(),
            frame_count_max: Some(4),
        };
        Recording::new(settings).frames().collect::<Vec<_>>()
    };
    assert_eq!(first(2), first(2));
    assert_ne!(first(2), first(3));
}

/// The mean shade of each frame.
fn shades(recording: &Recording) -> Vec<f64> {
    let mean = |frame: RecordedFrame| {
        let pixels = frame.image.pixels();
        pixels.iter().map(|pixel| f64::from(*pixel)).sum::<f64>() / pixels.len() as f64
    };
    recording.frames().map(mean).collect()
}

fn short(condition: Condition, frame_count: usize) -> Recording {
    Recording::new(RecordingSettings {
        world: RecordingWorld::Lab,
        seed: 4,
        conditions: vec![condition],
        frame_count_max: Some(frame_count),
    })
}

#[test]
fn a_covered_lens_is_dark_for_two_seconds() {
    let dark = shades(&short(Condition::Cover, 50));
    let count = dark.iter().filter(|shade| **shade < 8.0).count();
    assert!((19..=21).contains(&count), "{count}");
    assert!(dark[..7].iter().all(|shade| *shade > 40.0));
}

#[test]
fn each_condition_shows() {
    let clear = Recording::new(RecordingSettings {
        conditions: Vec::new(),
        ..short(Condition::Blur, 30).settings
    });
    let clear_frames: Vec<_> = clear.frames().collect();
    let lasting = [
        Condition::Blur,
        Condition::Noise,
        Condition::Exposure,
        Condition::Cover,
        Condition::Occlusion,
        Condition::LowTexture,
    ];
    for condition in lasting {
        let frames: Vec<_> = short(condition, 30).frames().collect();
        let name = condition.name();
        assert_eq!(frames.len(), clear_frames.len());
        let differing = frames.iter().zip(&clear_frames);
        let count = differing.filter(|(frame, clear)| frame != clear).count();
        assert!(count > 2, "{name} shows in {count} frames");
        assert!(frames.iter().zip(&clear_frames).all(|(frame, clear)| {
            frame.captured_at == clear.captured_at
                && frame.site_from_camera == clear.site_from_camera
        }));
    }
}

#[test]
fn a_link_disturbs_and_drops_some_frames() {
    for seed in 1..=3 {
        let weather = Weather::new(&[Condition::Drops, Condition::Radio], seed, 100.0);
        let dropped = (0..1000).filter(|frame_idx| weather.drops(*frame_idx));
        let dropped = dropped.count();
        assert!((20..120).contains(&dropped), "seed {seed}: {dropped}");
        let grey = Image::filled(64, 48, 100);
        let is_disturbed = |frame_idx: &usize| {
            let mut image = grey.clone();
            weather.disturb(*frame_idx, &mut image);
            image != grey
        };
        let disturbed = (0..1000).filter(is_disturbed).count();
        // Lines of one shade look the same when they are torn, so only snow shows.
        assert!((60..450).contains(&disturbed), "seed {seed}: {disturbed}");
    }
}

//! Tracks over seeded pictures that move: 20 frames a second.

use camera::Image;
use geometry::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::marker_light::{Irradiance, LightSpot, MarkerScene, Sensor};

use super::*;
use crate::markers::{CameraMarkers, FinderSettings};

const FRAME_S: f64 = 0.05;

fn stamp(frame_idx: usize) -> Timestamp {
    Timestamp::from_seconds(10.0 + FRAME_S * frame_idx as f64).unwrap()
}

fn camera(settings: TrackerSettings) -> CameraMarkers {
    CameraMarkers::new(FinderSettings::default(), settings, 324)
}

/// A dim room with lights: column, row, peak.
fn picture(lights: &[[f64; 3]], seed: usize) -> Image {
    let mut picture = Irradiance::filled(324, 244, 30.0);
    for [x, y, peak] in lights {
        picture.add_spot(&LightSpot {
            center_px: [*x, *y],
            sigma_px: 0.9,
            peak: *peak,
            streak_px: [0.0, 0.0],
        });
    }
    let sensor = Sensor {
        exposure: 1.0,
        noise: 3.0,
    };
    picture.expose(&sensor, &mut ChaCha8Rng::seed_from_u64(seed as u64))
}

/// The two lights of a drone.
fn drone(u_px: f64, v_px: f64, separation_px: f64) -> [[f64; 3]; 2] {
    [-0.5, 0.5].map(|side| [u_px, v_px + side * separation_px, 300.0])
}

/// Shows frame after frame and gives the tracks after each.
fn watch(
    camera: &mut CameraMarkers,
    frames: std::ops::Range<usize>,
    lights: impl Fn(usize) -> Vec<[f64; 3]>,
) -> Vec<Vec<MarkerTrack>> {
    let see = |idx| {
        let image = picture(&lights(idx), idx);
        camera.see(&image, stamp(idx), None).1.to_vec()
    };
    frames.map(see).collect()
}

#[test]
fn a_pair_is_believed_in_its_third_frame_and_measured_as_it_comes_near() {
    let mut camera = camera(TrackerSettings::default());
    // Half a metre a second towards a drone at 3 m: one sixth per second.
    let separation_px = |idx: usize| 6.0 * (FRAME_S * idx as f64 / 6.0).exp();
    let seen = watch(&mut camera, 0..60, |idx| {
        drone(100.0 + idx as f64, 120.0, separation_px(idx)).to_vec()
    });
    assert_eq!(seen[1][0].state, TrackState::Acquire);
    assert_eq!(seen[2][0].state, TrackState::Track);
    for (idx, tracks) in seen.iter().enumerate().skip(2) {
        let [track] = tracks[..] else {
            panic!("{} tracks in frame {idx}", tracks.len());
        };
        let error_px = track.separation_px - separation_px(idx);
        assert!(error_px.abs() < 0.12, "{error_px} px in frame {idx}");
        assert!((track.u_px - 100.0 - idx as f64).abs() < 0.1);
        assert_eq!((track.id, track.age_s), (seen[0][0].id, 0.0));
    }
    let rate_per_s = seen[59][0].rate_per_s;
    assert!((rate_per_s - 1.0 / 6.0).abs() < 0.1, "{rate_per_s}");
}

#[test]
fn a_gap_is_coasted_with_growing_sigma_and_ends_with_the_first_sighting() {
    let mut camera = camera(TrackerSettings::default());
    let seen = watch(&mut camera, 0..20, |idx| match idx {
        10..15 => Vec::new(),
        _ => drone(150.0, 100.0, 10.0).to_vec(),
    });
    let before = seen[9][0];
    for idx in 10..15 {
        let track = seen[idx][0];
        assert_eq!(track.state, TrackState::Coast);
        assert!((track.age_s - FRAME_S * (idx - 9) as f64).abs() < 1e-9);
        assert!(track.sigma_separation_px > seen[idx - 1][0].sigma_separation_px);
        assert!((track.separation_px / before.separation_px).ln().abs() < 0.1);
    }
    assert_eq!(
        (seen[15][0].state, seen[15][0].id),
        (TrackState::Track, before.id)
    );
}

#[test]
fn a_longer_gap_ends_belief_and_two_sightings_bring_it_back() {
    let mut camera = camera(TrackerSettings::default());
    let seen = watch(&mut camera, 0..60, |idx| match idx {
        10..20 | 30..60 => Vec::new(),
        _ => drone(150.0, 100.0, 10.0).to_vec(),
    });
    let id = seen[9][0].id;
    assert_eq!(seen[15][0].state, TrackState::Acquire);
    assert!(!seen[20][0].is_confirmed());
    assert_eq!((seen[21][0].state, seen[21][0].id), (TrackState::Track, id));
    assert!(seen[59].is_empty(), "a track is forgotten in the end");
}

#[test]
fn the_survivor_of_a_pair_is_not_paired_with_another_light() {
    // One light goes out; another light is as far below the survivor as the lost one was above.
    for lost in [0, 1] {
        let mut camera = camera(TrackerSettings::default());
        let seen = watch(&mut camera, 0..15, |idx| {
            let mut lights = drone(150.0, 100.0, 10.0).to_vec();
            lights.push([150.0, if lost == 0 { 115.0 } else { 85.0 }, 300.0]);
            if idx < 10 {
                lights.truncate(2);
            } else {
                lights.remove(lost);
            }
            lights
        });
        for (idx, tracks) in seen.iter().enumerate().skip(10) {
            let track = tracks[0];
            let slipped_px = (track.v_px - 100.0).abs();
            assert!(
                !track.is_confirmed() || slipped_px < 1.0,
                "frame {idx}: {track:?}"
            );
            assert_ne!(track.state, TrackState::Track, "frame {idx}");
        }
    }
}

#[test]
fn two_drones_keep_their_tracks_as_they_pass() {
    let mut camera = camera(TrackerSettings::default());
    let place = |idx: usize| {
        let step = 2.0 * idx as f64;
        [[100.0 + step, 100.0, 12.0], [220.0 - step, 135.0, 8.0]]
    };
    let seen = watch(&mut camera, 0..60, |idx| {
        let drones = place(idx).map(|[u, v, separation]| drone(u, v, separation));
        drones.into_iter().flatten().collect()
    });
    for (idx, tracks) in seen.iter().enumerate().skip(3) {
        assert_eq!(tracks.len(), 2, "frame {idx}");
        for [u, v, _] in place(idx) {
            let near = |track: &&MarkerTrack| (track.u_px - u).hypot(track.v_px - v) < 1.0;
            let now = tracks.iter().find(near).unwrap();
            let [u, v, _] = place(3)[usize::from(v > 120.0)];
            let near = |track: &&MarkerTrack| (track.u_px - u).hypot(track.v_px - v) < 1.0;
            assert_eq!(now.id, seen[3].iter().find(near).unwrap().id, "frame {idx}");
        }
    }
}

#[test]
fn flickering_lights_confirm_no_track() {
    // Eight lights in other places in every frame: half of the single frames have a false pair.
    let scene = MarkerScene {
        distractor_count: 8,
        ..MarkerScene::lab()
    };
    let scene = scene.without_pairs();
    let mut camera = camera(TrackerSettings::default());
    let (mut pair_count, mut confirmed_count) = (0, 0);
    for idx in 0..1000 {
        let image = scene.draw(idx as u64).image;
        let (frame, tracks) = camera.see(&image, stamp(idx), None);
        pair_count += usize::from(!frame.pairs.is_empty());
        confirmed_count += usize::from(tracks.iter().any(MarkerTrack::is_confirmed));
    }
    println!("1000 frames of 8 lights: {pair_count} with a pair, {confirmed_count} believed");
    assert!(pair_count > 100, "the test shows nothing: {pair_count}");
    assert!(
        confirmed_count <= 1,
        "{confirmed_count} frames with a believed track"
    );
}

#[test]
fn lamps_on_a_wall_are_believed_only_without_a_code() {
    let code = BlinkCode::new(0b0001_1101, 8, 2.0 * FRAME_S).unwrap();
    let blinking = TrackerSettings {
        blink: Some(code),
        ..TrackerSettings::default()
    };
    let lights = |idx: usize| {
        let dimmed = if code.is_full(0.013 + FRAME_S * idx as f64) {
            1.0
        } else {
            0.5
        };
        let mut lights = drone(200.0, 80.0, 12.0).to_vec();
        lights.extend(drone(90.0, 150.0, 10.0).map(|[x, y, peak]| [x, y, dimmed * peak]));
        lights
    };
    let confirmed = |settings| {
        let seen = watch(&mut camera(settings), 0..40, lights);
        let last = seen[39].iter().filter(|track| track.is_confirmed());
        last.map(|track| track.u_px.round()).collect::<Vec<_>>()
    };
    assert_eq!(confirmed(TrackerSettings::default()).len(), 2);
    assert_eq!(confirmed(blinking), [90.0]);
}

#[test]
fn a_turning_camera_keeps_its_tracks_if_it_knows_that_it_turns() {
    let intrinsics = Intrinsics {
        fx: 180.9,
        fy: 180.94,
        cx: 159.23,
        cy: 155.72,
    };
    // 4 degrees a frame to the left: things move some 13 px to the right, more than the gate.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 4_f64.to_radians());
    let ego = EgoMotion {
        now_from_before: turn,
        intrinsics,
    };
    let mut pixels = vec![[60.0, 120.0]];
    for _ in 0..12 {
        pixels.push(ego.moved(pixels[pixels.len() - 1]));
    }
    assert!(pixels[1][0] - pixels[0][0] > 12.0);
    for (ego, is_kept) in [(Some(ego), true), (None, false)] {
        let mut camera = camera(TrackerSettings::default());
        for (idx, [u, v]) in pixels.iter().enumerate() {
            camera.see(
                &picture(&drone(*u, *v, 10.0), idx),
                stamp(idx),
                ego.as_ref(),
            );
        }
        let kept = camera.tracks().iter().any(MarkerTrack::is_confirmed);
        assert_eq!(kept, is_kept);
    }
}

#[test]
fn lights_that_run_into_each_other_are_too_far_away_not_gone() {
    let mut camera = camera(TrackerSettings::default());
    let seen = watch(&mut camera, 0..80, |idx| {
        let separation_px = (6.0 * (-(idx as f64) * FRAME_S / 3.0).exp()).max(1.9);
        drone(150.0, 100.0, separation_px).to_vec()
    });
    let merged = seen.iter().flatten().filter(|track| track.merged).count();
    assert!(merged > 0, "no frame says that the lights have merged");
    assert!(seen[20][0].is_confirmed());
}

#[test]
fn stamps_that_repeat_or_go_back_break_nothing() {
    let mut camera = camera(TrackerSettings::default());
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for idx in 0..50 {
        let image = picture(&drone(150.0, 100.0, 10.0), idx);
        let at = stamp(rng.random_range(0..5));
        let (_, tracks) = camera.see(&image, at, None);
        for track in tracks {
            assert!(track.separation_px.is_finite() && track.sigma_separation_px.is_finite());
            assert!(track.u_px.is_finite() && track.rate_per_s.is_finite());
        }
    }
}

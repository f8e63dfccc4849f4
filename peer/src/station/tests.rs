//! The loop by itself: no link, no node, no process around it.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use camera::{Calibration, Image};
use geometry::Timestamp;
use keeping::Obstacle;
use nalgebra::Vector3;
use sim::marker_light::{MarkerLights, picture_of_pair};

use super::*;

const LIGHTS_M: f64 = 0.1;

fn calibration() -> Calibration {
    let text = "intrinsics: [180, 180, 160, 120]\nresolution: [320, 240]\n";
    Calibration::from_euroc_yaml(text).unwrap()
}

fn settings() -> StationSettings {
    behind(10.0)
}

fn behind(separation_px: f64) -> StationSettings {
    StationSettings {
        light_distance_m: LIGHTS_M,
        distance_m_min: 0.8,
        rule: StationRule::Follow {
            separation_px,
            lateral_px: None,
            speed_mps_max: 0.5,
        },
    }
}

fn stamp(image_idx: usize) -> Timestamp {
    Timestamp::from_nanoseconds(100_000_000 * (image_idx as i64 + 1))
}

/// What a camera shows of two lights ahead and to the left of it.
fn picture(ahead_m: f64, left_m: f64, seed: u64) -> Image {
    let lights = MarkerLights { length_m: LIGHTS_M };
    let middle_in_camera = Vector3::new(-left_m, 0.0, ahead_m);
    picture_of_pair(&calibration().camera, &lights, &middle_in_camera, seed)
}

/// Goal: pixels to motion and back, the place is taken. Method: a vehicle with 0.3 s of lag that
/// flies what comes out, and a picture of where that leaves it.
#[test]
fn the_loop_closes_over_rendered_lights() {
    let mut keeper = StationKeeper::new(&settings(), &calibration()).unwrap();
    let (mut ahead_m, mut left_m) = (2.6, 0.5);
    let mut velocity = Vector3::zeros();
    let mut seen_count = 0;
    for idx in 0..300 {
        let image = picture(ahead_m, left_m, idx as u64);
        let moment = keeper.see(stamp(idx), &image, &[]).unwrap();
        seen_count += usize::from(moment.followed.is_some());
        velocity += (moment.velocity - velocity) * (1.0 - (-0.1 / 0.3_f64).exp());
        ahead_m -= 0.1 * velocity.x;
        left_m -= 0.1 * velocity.y;
        assert!(ahead_m.hypot(left_m) > 1.5, "{ahead_m} {left_m}");
    }
    assert!(
        (ahead_m - 1.8).abs() < 0.05 && left_m.abs() < 0.05,
        "{ahead_m} {left_m}"
    );
    assert!(seen_count > 290, "{seen_count}");
}

/// Goal: among others the rule's distance is taken where the camera looks, and nobody backs up
/// where it does not. Method: the same flight with the rule of the first shell, whose place ahead
/// is 1.3 times as far.
#[test]
fn the_rule_of_the_first_shell_closes_the_loop_too() {
    let settings = StationSettings {
        rule: StationRule::Gabriel {
            preferred_m: 2.0,
            speed_mps: 0.0,
        },
        ..settings()
    };
    let end_m = |start_m: f64| {
        let mut keeper = StationKeeper::new(&settings, &calibration()).unwrap();
        let mut ahead_m = start_m;
        let mut velocity = Vector3::zeros();
        for idx in 0..400 {
            let image = picture(ahead_m, 0.0, idx as u64);
            let moment = keeper.see(stamp(idx), &image, &[]).unwrap();
            velocity += (moment.velocity - velocity) * (1.0 - (-0.1 / 0.3_f64).exp());
            ahead_m -= 0.1 * velocity.x;
        }
        ahead_m
    };
    // Ten per cent of the distance neither push nor pull.
    let from_afar_m = end_m(3.6);
    assert!((from_afar_m / 2.6).ln().abs() < 0.13, "{from_afar_m}");
    assert_eq!(end_m(1.9), 1.9);
}

#[test]
fn a_camera_that_falls_silent_lets_the_velocity_decay() {
    let mut keeper = StationKeeper::new(&settings(), &calibration()).unwrap();
    assert_eq!(keeper.velocity_at(stamp(0)), Vector3::zeros());
    for idx in 0..10 {
        keeper.see(stamp(idx), &picture(2.6, 0.5, idx as u64), &[]);
    }
    let flying = keeper.velocity_at(stamp(9));
    assert!(flying.norm() > 0.2, "{flying:?}");
    assert_eq!(keeper.velocity_at(stamp(11)), flying);
    assert!(keeper.velocity_at(stamp(25)).norm() < 0.01);
}

#[test]
fn an_image_from_the_past_changes_nothing() {
    let mut keeper = StationKeeper::new(&settings(), &calibration()).unwrap();
    keeper.see(stamp(5), &picture(2.6, 0.5, 1), &[]);
    assert_eq!(keeper.see(stamp(5), &picture(1.0, 0.0, 2), &[]), None);
    assert_eq!(keeper.see(stamp(3), &picture(1.0, 0.0, 2), &[]), None);
}

#[test]
fn a_place_within_the_smallest_distance_is_refused() {
    let error = StationKeeper::new(&behind(40.0), &calibration()).unwrap_err();
    assert!(
        error.to_string().starts_with("the place is 0.45 m"),
        "{error}"
    );
}

/// Tells what comes out.
struct Listener(Sender<(Timestamp, Vector3<f64>)>);

impl Outlet for Listener {
    fn fly(&mut self, now: Timestamp, velocity_in_heading: &Vector3<f64>) {
        let _ = self.0.send((now, *velocity_in_heading));
    }

    fn note(&mut self, moment: &StationMoment) {
        // The second image is one too many for this one.
        assert!(moment.captured_at < stamp(100));
    }

    fn fault(&mut self, captured_at: Timestamp) {
        let _ = self.0.send((captured_at, Vector3::repeat(f64::NAN)));
    }
}

fn start() -> (StationLoop<Listener>, Receiver<(Timestamp, Vector3<f64>)>) {
    let keeper = StationKeeper::new(&settings(), &calibration()).unwrap();
    let (sender, velocities) = channel();
    let period = Duration::from_millis(5);
    (
        StationLoop::start(keeper, period, Listener(sender)),
        velocities,
    )
}

/// Goal: the place is held without any link, and while nobody else does anything.
#[test]
fn images_are_answered_and_velocities_go_on_between_them() {
    let (station, velocities) = start();
    let window = station.window();
    for idx in 0..5 {
        window.show(stamp(idx), picture(2.6, 0.5, idx as u64));
        window.wait_until_answered();
        // What was sent before the answer is there now.
        let answered = velocities.try_iter().find(|(now, _)| *now == stamp(idx));
        assert!(answered.is_some(), "image {idx}");
    }
    // No image comes any more, and still three beats do, each later than the one before.
    let mut before = stamp(4);
    for _ in 0..3 {
        let (now, _) = velocities.recv().unwrap();
        assert!(now > before);
        before = now;
    }
    assert!(station.finish().is_some());
}

/// Goal: obstacles are heeded while they are known, and no longer. Method: the same picture,
/// with a wall beside the vehicle that was told of now, long ago, and never.
#[test]
fn obstacles_that_were_told_of_are_heeded_while_they_are_new() {
    let left_mps = |told_at: Option<Timestamp>| {
        let (station, velocities) = start();
        let window = station.window();
        if let Some(told_at) = told_at {
            let wall = Obstacle {
                direction: Vector3::y(),
                clearance_m: 0.4,
            };
            window.tell(told_at, vec![wall]);
        }
        for idx in 50..55 {
            window.show(stamp(idx), picture(2.0, 0.8, idx as u64));
            window.wait_until_answered();
        }
        let last = velocities.try_iter().find(|(now, _)| *now == stamp(54));
        last.unwrap().1.y
    };
    assert!(left_mps(Some(stamp(52))) < 1e-6);
    let free = left_mps(None);
    assert!(free > 0.2, "{free}");
    assert_eq!(left_mps(Some(stamp(10))), free);
}

/// Goal: an image that makes the keeper panic costs that image, and nothing of what it broke is
/// gone on with. Method: panic in the middle of a flight.
#[test]
fn a_fault_costs_one_image() {
    let fresh = StationKeeper::new(&settings(), &calibration()).unwrap();
    let mut keeper = fresh.clone();
    for idx in 0..10 {
        let image = picture(2.6, 0.5, idx as u64);
        let seen = beat::look(&mut keeper, &fresh, |keeper| {
            keeper.see(stamp(idx), &image, &[])
        });
        assert!(seen.unwrap().is_some());
    }
    assert!(keeper.velocity_at(stamp(9)).norm() > 0.2);
    let broken = beat::look(&mut keeper, &fresh, |keeper| {
        keeper.see(stamp(10), &picture(2.6, 0.5, 10), &[]);
        panic!("as if an image had broken it")
    });
    assert_eq!(broken, Err(beat::Fault));
    assert_eq!(keeper.velocity_at(stamp(10)), Vector3::zeros());
    let image = picture(2.6, 0.5, 11);
    let after = beat::look(&mut keeper, &fresh, |keeper| {
        keeper.see(stamp(11), &image, &[])
    });
    assert!(after.unwrap().is_some());
}

/// Goal: a vehicle is not left flying by a loop that ends.
#[test]
fn the_last_word_is_to_stand_still() {
    let (station, velocities) = start();
    let window = station.window();
    for idx in 0..5 {
        window.show(stamp(idx), picture(2.6, 0.5, idx as u64));
        window.wait_until_answered();
    }
    station.finish().unwrap();
    let (_, last) = velocities.try_iter().last().unwrap();
    assert_eq!(last, Vector3::zeros());
}

#[test]
fn a_camera_on_its_side_is_refused() {
    let text = "intrinsics: [180, 180, 160, 120]\nresolution: [320, 240]\n\
                T_BS:\n  data: [0, 0, 1, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1]\n";
    let calibration = Calibration::from_euroc_yaml(text).unwrap();
    let error = StationKeeper::new(&settings(), &calibration).unwrap_err();
    assert!(error.to_string().contains("turned by 90°"), "{error}");
}

#[test]
fn a_loop_that_has_died_keeps_nobody_waiting() {
    let (station, _velocities) = start();
    let window = station.window();
    window.show(stamp(100), picture(2.6, 0.5, 0));
    window.show(stamp(101), picture(2.6, 0.5, 0));
    window.wait_until_answered();
    assert!(station.finish().is_none());
}

/// Goal: the loop can reach no network, map or other part of the process. Method: what its sources
/// name, and what the crate that it stands on depends on.
#[test]
fn nothing_of_the_network_is_within_reach() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.join("src/station");
    let mut sources: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| !path.ends_with("tests.rs"))
        .collect();
    sources.push(root.join("src/station.rs"));
    assert!(sources.len() >= 3);
    for path in sources {
        let text = std::fs::read_to_string(&path).unwrap();
        for word in [
            "crate::",
            "super::super",
            "std::net",
            "std::os",
            "std::process",
            "extern ",
        ] {
            assert!(!text.contains(word), "{}: {word}", path.display());
        }
        let mut roots = text
            .split(|letter: char| !(letter.is_alphanumeric() || "_:".contains(letter)))
            .filter_map(|path| path.split_once("::").map(|(root, _)| root))
            .filter(|root| root.starts_with(char::is_lowercase));
        let known = [
            "std",
            "camera",
            "geometry",
            "keeping",
            "nalgebra",
            "thiserror",
            "super",
        ];
        let own = ["keeper", "beat", "mount"];
        let stranger = roots.find(|root| !known.contains(root) && !own.contains(root));
        assert_eq!(stranger, None, "{}", path.display());
    }
    let manifest = std::fs::read_to_string(root.join("../algorithms/keeping/Cargo.toml")).unwrap();
    let manifest: toml::Table = toml::from_str(&manifest).unwrap();
    let dependencies: Vec<&str> = manifest["dependencies"]
        .as_table()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    assert_eq!(
        dependencies,
        ["camera", "geometry", "nalgebra", "thiserror"]
    );
}

//! Goal: a vehicle holds its place by sight with nobody to talk to. Method: play its camera and
//! its autopilot, with another vehicle's lights ahead, and fly what it commands.

use std::fs;
use std::net::{TcpListener, TcpStream};

use camera::Image;
use geometry::Timestamp;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sim::marker_light::{Irradiance, LightSpot, Sensor};
use sim::stream::{self, Frame, Message, read_message, write_message};
use tempfile::TempDir;

use crate::processes::{starling, summary};

const FOCAL_PX: f64 = 180.0;
const LIGHTS_M: f64 = 0.1;
const FRAME_COUNT: usize = 120;
const FRAME_S: f64 = 0.1;

/// Two lights, so far ahead and to the left, before a wall without a mark.
fn picture(ahead_m: f64, left_m: f64, frame_idx: usize) -> Image {
    let mut light = Irradiance::filled(320, 240, 70.0);
    for up_m in [0.5 * LIGHTS_M, -0.5 * LIGHTS_M] {
        light.add_spot(&LightSpot {
            center_px: [
                160.0 - FOCAL_PX * left_m / ahead_m,
                120.0 - FOCAL_PX * up_m / ahead_m,
            ],
            sigma_px: 0.9,
            peak: 600.0 / ahead_m.powi(2),
            streak_px: [0.0, 0.0],
        });
    }
    let sensor = Sensor {
        exposure: 1.0,
        noise: 2.0,
    };
    light.expose(&sensor, &mut ChaCha8Rng::seed_from_u64(frame_idx as u64))
}

/// Shows frames and flies the newest velocity that came before each acknowledgement.
fn play(mut stream: TcpStream) -> Vector3<f64> {
    let mut place = Vector3::new(2.7, -0.5, 0.0);
    let mut velocity = Vector3::zeros();
    write_message(&mut stream, &Message::Hello).unwrap();
    for frame_idx in 0..FRAME_COUNT {
        let captured_at = Timestamp::from_nanoseconds(100_000_000 * (frame_idx as i64 + 1));
        let image = picture(place.x, place.y, frame_idx);
        write_message(&mut stream, &Message::Frame(Frame { captured_at, image })).unwrap();
        let mut commanded = None;
        loop {
            match read_message(&mut stream).unwrap() {
                Message::Velocity(command) => commanded = Some(command),
                Message::Acknowledgement { .. } => break,
                Message::Hello => {}
                other => panic!("{other:?}"),
            }
        }
        let command: stream::VelocityCommand = commanded.expect("a velocity for each frame");
        assert!(command.captured_at >= captured_at);
        velocity += (command.velocity_in_heading - velocity) * (1.0 - (-FRAME_S / 0.3).exp());
        place -= velocity * FRAME_S;
    }
    write_message(&mut stream, &Message::End).unwrap();
    // Until the vehicle has closed.
    while read_message(&mut stream).is_ok() {}
    place
}

#[test]
fn a_place_is_held_by_sight_without_any_link() {
    let folder = TempDir::new().unwrap();
    let calibration = folder.path().join("camera.yaml");
    let text = "intrinsics: [180, 180, 160, 120]\nresolution: [320, 240]\n";
    fs::write(&calibration, text).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let driver = std::thread::spawn(move || play(listener.accept().unwrap().0));
    let config = folder.path().join("v.toml");
    let text = format!(
        "id = \"v\"\nout = {:?}\n[camera]\nstream = {address:?}\ncalibration = {calibration:?}\n\
         [keeping]\nlight_distance_m = {LIGHTS_M}\n[zenoh]\nlisten = [\"tcp/127.0.0.1:0\"]\n",
        folder.path()
    );
    fs::write(&config, text).unwrap();
    let output = starling()
        .args(["run", "--config"])
        .arg(&config)
        .output()
        .unwrap();
    let diagnostics = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{diagnostics}");
    let place = driver.join().unwrap();
    assert!(
        (place - Vector3::new(1.8, 0.0, 0.0)).norm() < 0.1,
        "{place:?}"
    );
    let vehicle = summary(folder.path(), "v");
    assert_eq!(vehicle["state"], "NoMap", "{vehicle}");
    assert_eq!(vehicle["bytes_received"], 0, "{vehicle}");
    let keeping = &vehicle["keeping"];
    assert_eq!(keeping["frame_count"], FRAME_COUNT, "{vehicle}");
    assert!(
        keeping["seen_count"].as_u64().unwrap() as usize > FRAME_COUNT - 5,
        "{vehicle}"
    );
    let log = fs::read_to_string(folder.path().join("v.keeping.csv")).unwrap();
    assert_eq!(log.lines().count(), FRAME_COUNT + 1);
}

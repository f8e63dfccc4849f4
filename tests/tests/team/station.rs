//! Goal: a vehicle holds its place by sight with nobody to talk to. Method: play its camera and
//! its autopilot, with another vehicle's lights ahead, and fly what it commands.

use std::fs;
use std::net::{TcpListener, TcpStream};

use camera::Calibration;
use geometry::Timestamp;
use nalgebra::Vector3;
use sim::marker_light::{MarkerLights, picture_of_pair};
use sim::stream::{Frame, Message, read_message, write_message};
use tempfile::TempDir;

use crate::processes::{starling, summary};

const CALIBRATION: &str = "intrinsics: [180, 180, 160, 120]\nresolution: [320, 240]\n";
const LIGHTS_M: f64 = 0.1;
const FRAME_COUNT: usize = 120;
const FRAME_S: f64 = 0.1;

/// Shows frames and flies what is commanded because of each.
fn play(mut stream: TcpStream) -> Vector3<f64> {
    let camera = Calibration::from_euroc_yaml(CALIBRATION).unwrap().camera;
    let lights = MarkerLights { length_m: LIGHTS_M };
    let mut place = Vector3::new(2.7, -0.5, 0.0);
    let mut velocity = Vector3::zeros();
    write_message(&mut stream, &Message::Hello).unwrap();
    for frame_idx in 0..FRAME_COUNT {
        let captured_at = Timestamp::from_nanoseconds(100_000_000 * (frame_idx as i64 + 1));
        let middle_in_camera = Vector3::new(-place.y, 0.0, place.x);
        let image = picture_of_pair(&camera, &lights, &middle_in_camera, frame_idx as u64);
        write_message(&mut stream, &Message::Frame(Frame { captured_at, image })).unwrap();
        let mut commanded = None;
        loop {
            match read_message(&mut stream).unwrap() {
                // Later ones repeat it, less and less, on the wall clock of a slow vehicle.
                Message::Velocity(command) if command.captured_at == captured_at => {
                    commanded = Some(command);
                }
                Message::Hello | Message::Velocity(_) => {}
                Message::Acknowledgement { .. } => break,
                other => panic!("{other:?}"),
            }
        }
        let command = commanded.expect("a velocity because of each frame");
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
    fs::write(&calibration, CALIBRATION).unwrap();
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

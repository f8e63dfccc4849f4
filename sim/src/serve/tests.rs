use std::io::Write;
use std::net::TcpStream;
use std::sync::mpsc::{Sender, channel};

use nalgebra::Vector3;

use super::*;
use crate::stream::{self, Frame, Message, VelocityCommand};

/// What a vehicle saw of the stream.
#[derive(Debug, Default, PartialEq)]
struct Seen {
    frames: Vec<Frame>,
    fixes: Vec<Fix>,
    ended: bool,
}

/// Acknowledges up to `frame_count_max` frames, then leaves.
fn fly(address: SocketAddr, frame_count_max: usize) -> Seen {
    fly_commanding(address, frame_count_max, &[])
}

/// The same, with these commands before each acknowledgement. The first one has the frame's stamp,
/// and each other one is stamped half a second after the one before, as on the wall clock of a slow
/// vehicle.
fn fly_commanding(address: SocketAddr, frame_count_max: usize, velocities: &[[f64; 3]]) -> Seen {
    let mut stream = TcpStream::connect(address).unwrap();
    stream::write_message(&mut stream, &Message::Hello).unwrap();
    assert_eq!(stream::read_message(&mut stream).unwrap(), Message::Hello);
    let mut seen = Seen::default();
    while seen.frames.len() < frame_count_max {
        match stream::read_message(&mut stream).unwrap() {
            Message::Frame(frame) => {
                let captured_at = frame.captured_at;
                seen.frames.push(frame);
                for (idx, velocity) in velocities.iter().enumerate() {
                    let late = Duration::from_millis(500 * idx as u64);
                    let command = Message::Velocity(VelocityCommand {
                        captured_at: captured_at.after(late),
                        velocity_in_heading: Vector3::from(*velocity),
                    });
                    stream::write_message(&mut stream, &command).unwrap();
                }
                let answer = Message::Acknowledgement { captured_at };
                stream::write_message(&mut stream, &answer).unwrap();
            }
            Message::Fix(fix) => seen.fixes.push(fix),
            Message::End => {
                seen.ended = true;
                return seen;
            }
            other => panic!("unexpected {other:?}"),
        }
    }
    seen
}

/// The lab with a single wall, which is painted quickly.
fn scenario() -> Scenario {
    let mut scenario = Scenario::lab(1);
    scenario.world.panels.drain(..5);
    scenario.world.panels.truncate(1);
    scenario
}

/// Runs the simulator with a vehicle on every listener; each leaves after so many frames.
fn run(settings: &ServeSettings, frame_counts_max: [usize; 3]) -> (ServeReport, Vec<Seen>) {
    run_commanded(settings, frame_counts_max, &[])
}

/// The same, with vehicles that all command this before every acknowledgement.
fn run_commanded(
    settings: &ServeSettings,
    frame_counts_max: [usize; 3],
    velocities: &'static [[f64; 3]],
) -> (ServeReport, Vec<Seen>) {
    let (sender, listening): (Sender<Vec<Listener>>, _) = channel();
    thread::scope(|scope| {
        let vehicles = scope.spawn(move || {
            let listeners = listening.recv().unwrap();
            let flights: Vec<_> = listeners
                .into_iter()
                .zip(frame_counts_max)
                .filter(|(_, count)| *count > 0)
                .map(|(listener, count)| {
                    thread::spawn(move || fly_commanding(listener.address, count, velocities))
                })
                .collect();
            let landed = flights.into_iter().map(|flight| flight.join().unwrap());
            landed.collect::<Vec<Seen>>()
        });
        let report = serve_scenario(&scenario(), settings, &mut |event| {
            if let ServeEvent::Listening { vehicles, .. } = event {
                sender.send(vehicles.clone()).unwrap();
            }
        });
        (report.unwrap(), vehicles.join().unwrap())
    })
}

fn settings() -> ServeSettings {
    ServeSettings {
        pace: Pace::Unlimited,
        frame_count_max: Some(5),
        acknowledge_timeout: Duration::from_secs(20),
        ..Default::default()
    }
}

#[test]
fn every_vehicle_gets_its_frames_and_only_the_anchor_gets_fixes() {
    let (report, seen) = run(&settings(), [100; 3]);
    assert_eq!(report.frame_count, 5);
    assert_eq!(seen.len(), 3);
    for (idx, vehicle) in seen.iter().enumerate() {
        assert_eq!(vehicle.frames.len(), 5);
        assert!(vehicle.ended);
        assert_eq!(vehicle.fixes.len(), if idx == 0 { 2 } else { 0 });
        assert_eq!(report.vehicles[idx].fixes_sent, vehicle.fixes.len());
        assert_eq!(report.vehicles[idx].ending, Ending::RouteFinished);
        let expected = if idx == 0 { (640, 360) } else { (324, 244) };
        let image = &vehicle.frames[0].image;
        assert_eq!((image.width(), image.height()), expected);
        let truth = &report.vehicles[idx].truth_tum;
        assert_eq!(truth.lines().count(), 5);
        let last = truth.lines().last().unwrap();
        assert!(last.starts_with("10.400000000 ") && last.split(' ').count() == 8);
    }
}

#[test]
fn a_wish_ends_the_route_in_order() {
    static WISHED: AtomicBool = AtomicBool::new(true);
    let settings = ServeSettings {
        end_wished: Some(&WISHED),
        ..settings()
    };
    let (report, seen) = run(&settings, [100; 3]);
    assert_eq!(report.frame_count, 0);
    assert!(seen.iter().all(|vehicle| vehicle.ended));
}

/// Why the first vehicle is lost that says hello, then does this, while the others fly.
fn reason_of_loss(then: fn(TcpStream)) -> String {
    let settings = ServeSettings {
        acknowledge_timeout: Duration::from_millis(1200),
        ..settings()
    };
    let mut lost = None;
    let mut observe = |event: &ServeEvent| match event {
        ServeEvent::Listening { vehicles, .. } => {
            for (idx, vehicle) in vehicles.iter().enumerate() {
                let address = vehicle.address;
                thread::spawn(move || match idx {
                    0 => {
                        let mut stream = TcpStream::connect(address).unwrap();
                        stream::write_message(&mut stream, &Message::Hello).unwrap();
                        then(stream);
                    }
                    _ => drop(fly(address, 100)),
                });
            }
        }
        ServeEvent::VehicleLost { id, reason } => {
            lost.get_or_insert(format!("{id} {reason}"));
        }
        _ => {}
    };
    serve_scenario(&scenario(), &settings, &mut observe).unwrap();
    lost.unwrap()
}

const STILL: Message = Message::Velocity(VelocityCommand {
    captured_at: Timestamp::from_nanoseconds(0),
    velocity_in_heading: Vector3::new(0.0, 0.0, 0.0),
});

#[test]
fn a_vehicle_that_hangs_is_lost_with_how_long_was_waited() {
    let reason = reason_of_loss(|_stream| thread::sleep(Duration::from_secs(20)));
    assert_eq!(reason, "ugv1 said nothing for 1 s");
}

#[test]
fn a_vehicle_that_only_commands_is_lost_as_well() {
    let reason = reason_of_loss(
        |mut stream| {
            while stream::write_message(&mut stream, &STILL).is_ok() {}
        },
    );
    let expected = "ugv1 commanded velocities, but acknowledged nothing for 1 s";
    assert_eq!(reason, expected);
}

#[test]
fn a_vehicle_that_speaks_a_byte_at_a_time_is_lost_as_well() {
    let reason = reason_of_loss(|mut stream| {
        let mut bytes = Vec::new();
        stream::encode(&STILL, &mut bytes);
        for byte in bytes {
            if stream.write_all(&[byte]).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(300));
        }
    });
    assert_eq!(reason, "ugv1 said nothing for 1 s");
}

#[test]
fn a_velocity_that_is_no_number_ends_the_link() {
    let reason = reason_of_loss(|mut stream| {
        let command = Message::Velocity(VelocityCommand {
            captured_at: Timestamp::default(),
            velocity_in_heading: Vector3::new(0.0, f64::NAN, 0.0),
        });
        stream::write_message(&mut stream, &command).unwrap();
        thread::sleep(Duration::from_secs(20));
    });
    assert!(reason.contains("not finite"), "{reason}");
}

/// Positions in the truth of a vehicle, one per frame.
fn true_positions(report: &VehicleReport) -> Vec<Vector3<f64>> {
    let lines = report.truth_tum.lines();
    lines
        .map(|line| {
            let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
            Vector3::new(numbers[1], numbers[2], numbers[3])
        })
        .collect()
}

#[test]
fn only_who_keeps_its_place_flies_as_it_commands() {
    let settings = ServeSettings {
        frame_count_max: Some(15),
        ..settings()
    };
    // The command because of the frame counts, not what a slow vehicle says after it.
    let commands: &[[f64; 3]] = &[[-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]];
    let (report, seen) = run_commanded(&settings, [100; 3], commands);
    let scenario = scenario();
    for vehicle_idx in 0..3 {
        let truth = true_positions(&report.vehicles[vehicle_idx]);
        assert_eq!(truth.len(), 15);
        for (frame_idx, position) in truth.iter().enumerate() {
            let time_s = scenario.frame_time_s(frame_idx);
            let planned = scenario.site_from_camera(vehicle_idx, time_s);
            let forward = planned.rotation() * Vector3::z();
            let way = position - planned.translation();
            let carried_m = way.xy().dot(&forward.xy().normalize());
            // What is commanded at one frame acts from the next on.
            if vehicle_idx < 2 || frame_idx < 2 {
                assert!(
                    way.norm() < 1e-6,
                    "vehicle {vehicle_idx}, frame {frame_idx}: {way}"
                );
            } else {
                let flown_s = time_s - 0.1;
                let expected_m = -0.5 * (flown_s - 0.3 * (1.0 - (-flown_s / 0.3).exp()));
                // Less where acceleration is limited, and the heading wobbles.
                assert!(
                    (carried_m - expected_m).abs() < 0.03,
                    "{carried_m}, {expected_m}"
                );
            }
        }
    }
    let (again, same) = run_commanded(&settings, [100; 3], commands);
    assert!(seen == same, "the same commands gave other frames");
    for (vehicle, same) in report.vehicles.iter().zip(&again.vehicles) {
        assert_eq!(vehicle.truth_tum, same.truth_tum);
    }
    let (_, hovering) = run(&settings, [100; 3]);
    assert!(seen[2].frames[14] != hovering[2].frames[14]);
}

#[test]
fn a_vehicle_that_dies_does_not_stop_the_others() {
    let (report, seen) = run(&settings(), [100, 2, 100]);
    let frames: Vec<usize> = seen.iter().map(|vehicle| vehicle.frames.len()).collect();
    assert_eq!(frames, [5, 2, 5]);
    assert!(matches!(report.vehicles[1].ending, Ending::Lost { .. }));
    assert_eq!(report.vehicles[1].frames_acknowledged, 2);
    assert_eq!(report.vehicles[0].ending, Ending::RouteFinished);
    assert_eq!(report.vehicles[2].frames_acknowledged, 5);
}

#[test]
fn all_vehicles_may_leave() {
    let (report, _) = run(&settings(), [1, 2, 3]);
    assert!(report.frame_count <= 4);
    let lost = |vehicle: &VehicleReport| matches!(vehicle.ending, Ending::Lost { .. });
    assert!(report.vehicles.iter().all(lost));
}

#[test]
fn says_who_never_came() {
    let settings = ServeSettings {
        connect_timeout: Duration::from_millis(50),
        ..settings()
    };
    let error = serve_scenario(&scenario(), &settings, &mut |_| {}).unwrap_err();
    assert!(
        error.to_string().contains("ugv1, drone1, drone2"),
        "{error}"
    );
    let late = ServeSettings {
        connect_timeout: Duration::from_secs(2),
        ..settings
    };
    let (report, seen) = run(&late, [0, 100, 0]);
    assert_eq!(seen[0].frames.len(), 5);
    assert!(matches!(report.vehicles[0].ending, Ending::Lost { .. }));
}

/// Goal: a route without pictures does not count as finished, for nobody. Method: a wall that no
/// memory can hold, which stops the painter.
#[test]
fn a_renderer_that_panics_is_an_error() {
    let mut scenario = scenario();
    scenario.world.panels[0].width_m = f64::INFINITY;
    let (sender, endings) = channel();
    let mut observe = |event: &ServeEvent| {
        if let ServeEvent::Listening { vehicles, .. } = event {
            for vehicle in vehicles {
                let (address, sender) = (vehicle.address, sender.clone());
                thread::spawn(move || {
                    let mut stream = TcpStream::connect(address).unwrap();
                    stream::write_message(&mut stream, &Message::Hello).unwrap();
                    assert_eq!(stream::read_message(&mut stream).unwrap(), Message::Hello);
                    sender.send(stream::read_message(&mut stream).is_ok())
                });
            }
        }
    };
    let error = serve_scenario(&scenario, &settings(), &mut observe).unwrap_err();
    let is_panic = matches!(error, ServeError::RendererPanicked { seed: 1, .. });
    assert!(is_panic, "{error}");
    for _ in 0..3 {
        assert!(!endings.recv().unwrap(), "a vehicle heard of an end");
    }
}

#[test]
fn frames_follow_the_wall_clock_and_come_out_the_same() {
    let paced = ServeSettings {
        pace: Pace::RealTime,
        ..settings()
    };
    let (report, seen) = run(&paced, [100; 3]);
    assert!(report.wall_s >= 0.4, "{}", report.wall_s);
    assert!(report.realtime_factor.unwrap() <= 1.0);
    let (_, again) = run(&settings(), [100; 3]);
    assert!(seen == again, "the same seed gave other frames");
}

use std::net::TcpStream;
use std::sync::mpsc::{Sender, channel};

use super::*;
use crate::stream::{self, Frame, Message};

/// What a vehicle saw of the stream.
#[derive(Debug, Default, PartialEq)]
struct Seen {
    frames: Vec<Frame>,
    fixes: Vec<Fix>,
    ended: bool,
}

/// Acknowledges up to `frame_count_max` frames, then leaves.
fn fly(address: SocketAddr, frame_count_max: usize) -> Seen {
    let mut stream = TcpStream::connect(address).unwrap();
    stream::write_message(&mut stream, &Message::Hello).unwrap();
    assert_eq!(stream::read_message(&mut stream).unwrap(), Message::Hello);
    let mut seen = Seen::default();
    while seen.frames.len() < frame_count_max {
        match stream::read_message(&mut stream).unwrap() {
            Message::Frame(frame) => {
                let captured_at = frame.captured_at;
                seen.frames.push(frame);
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
    let (sender, listening): (Sender<Vec<Listener>>, _) = channel();
    thread::scope(|scope| {
        let vehicles = scope.spawn(move || {
            let listeners = listening.recv().unwrap();
            let flights: Vec<_> = listeners
                .into_iter()
                .zip(frame_counts_max)
                .filter(|(_, count)| *count > 0)
                .map(|(listener, count)| thread::spawn(move || fly(listener.address, count)))
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

#[test]
fn a_vehicle_that_hangs_is_lost_with_how_long_was_waited() {
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
                        thread::sleep(Duration::from_secs(20));
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
    assert_eq!(lost.unwrap(), "ugv1 said nothing for 1 s");
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

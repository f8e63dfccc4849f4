//! Goal: whatever a driver sends, the vehicle goes on or ends with a named reason. Method: play
//! the driver on loopback, byte by byte.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::thread::JoinHandle;

use camera::Image;
use nalgebra::{Matrix3, Vector3};
use stream::{Fix, Frame};

use super::*;

/// Long enough for a loaded machine; no test waits for it.
const LONG: Duration = Duration::from_secs(60);

fn calibration() -> Calibration {
    let text = "intrinsics: [30, 30, 16, 12]\nresolution: [32, 24]\n";
    Calibration::from_euroc_yaml(text).unwrap()
}

/// A driver that says hello, sends these bytes and closes; gives back what it was sent.
fn driver(bytes: Vec<u8>) -> (String, JoinHandle<Vec<u8>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let handle = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream::write_message(&mut stream, &Message::Hello).unwrap();
        stream.write_all(&bytes).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let mut received = Vec::new();
        stream.read_to_end(&mut received).unwrap();
        received
    });
    (address, handle)
}

/// What a vehicle makes of these bytes, in a word each, and what it sent.
fn play(bytes: Vec<u8>) -> (Vec<String>, Vec<u8>) {
    let (address, driver) = driver(bytes);
    let mut source = StreamSource::connect(&address, calibration(), LONG).unwrap();
    let mut words = Vec::new();
    while let Some(input) = source.next_input() {
        words.push(match input {
            Input::Frame { captured_at, .. } => format!("frame {}", captured_at.nanoseconds()),
            Input::Fix(fix) => format!("fix {}", fix.captured_at.nanoseconds()),
            Input::Unreadable { reason, .. }
            | Input::Skipped { reason, .. }
            | Input::FixesLeftOut { reason, .. }
            | Input::BrokenOff { reason } => {
                assert!(reason.ends_with(&address), "{reason:?} lacks {address}");
                reason
            }
            Input::End => "end".to_owned(),
        });
    }
    drop(source);
    (words, driver.join().unwrap())
}

fn frame(nanoseconds: i64, width: usize, height: usize) -> Message {
    Message::Frame(Frame {
        captured_at: Timestamp::from_nanoseconds(nanoseconds),
        image: Image::from_pixels(width, height, vec![7; width * height]).unwrap(),
    })
}

fn fix(nanoseconds: i64, x: f64, variance: f64) -> Message {
    Message::Fix(Fix {
        captured_at: Timestamp::from_nanoseconds(nanoseconds),
        position_in_site: Vector3::new(x, 0.0, 0.0),
        covariance_in_site: Matrix3::identity() * variance,
    })
}

fn encoded(messages: &[Message]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for message in messages {
        stream::encode(message, &mut bytes);
    }
    bytes
}

/// Expects these inputs, each described by the start of its word.
fn check(bytes: Vec<u8>, expected: &[&str]) {
    let (words, _) = play(bytes);
    let agree = words.len() == expected.len()
        && words
            .iter()
            .zip(expected)
            .all(|(word, expected)| word.starts_with(expected));
    assert!(agree, "got {words:#?}, expected {expected:#?}");
}

#[test]
fn a_whole_stream_ends_without_a_word() {
    let messages = [
        fix(1, 0.0, 1.0),
        frame(1, 32, 24),
        frame(2, 32, 24),
        Message::End,
    ];
    check(encoded(&messages), &["fix 1", "frame 1", "frame 2"]);
}

#[test]
fn a_stream_that_breaks_off_says_how() {
    let whole = encoded(&[frame(1, 32, 24)]);
    let closed = "the stream broke off: the connection was closed without an end message";
    check(whole.clone(), &["frame 1", closed]);
    let cut = "the stream broke off: the connection was closed in the middle of a message";
    check(
        [whole.clone(), whole[..99].to_vec()].concat(),
        &["frame 1", cut],
    );
    let garbage = b"GET / HTTP/1.1\r\nHost: nobody\r\n\r\n".to_vec();
    let foreign = "the stream broke off: message starts with [47, 45, 54, 20]";
    check([whole, garbage].concat(), &["frame 1", foreign]);
}

#[test]
fn fixes_that_are_none_are_skipped_one_by_one() {
    let messages = [
        fix(1, f64::NAN, 1.0),
        fix(2, 0.0, 1.0),
        fix(3, 0.0, -1.0),
        fix(2, 0.0, 1.0),
        fix(4, 0.0, 1.0),
        Message::End,
    ];
    let expected = [
        "a fix holds a number that is not finite",
        "fix 2",
        "its covariance is none",
        "its time stamp 0.000000002 is not after the one before, 0.000000003",
        "fix 4",
    ];
    check(encoded(&messages), &expected);
}

#[test]
fn frames_out_of_order_are_skipped_and_acknowledged() {
    let frames = [
        frame(5, 32, 24),
        frame(5, 32, 24),
        frame(4, 32, 24),
        frame(6, 32, 24),
    ];
    let (words, received) = play(encoded(&[&frames[..], &[Message::End]].concat()));
    assert_eq!(
        (words[0].as_str(), words[3].as_str()),
        ("frame 5", "frame 6")
    );
    assert!(
        words[1].contains("is not after the one before"),
        "{words:?}"
    );
    assert!(
        words[2].contains("is not after the one before"),
        "{words:?}"
    );
    // The loop acknowledges what it has flown; nobody else would these two.
    let acknowledged = |nanoseconds| Message::Acknowledgement {
        captured_at: Timestamp::from_nanoseconds(nanoseconds),
    };
    let expected = [Message::Hello, acknowledged(5), acknowledged(4)];
    assert_eq!(received, encoded(&expected));
}

#[test]
fn frames_of_another_size_are_unreadable() {
    let messages = [frame(1, 32, 24), frame(2, 16, 12), Message::End];
    let expected = ["frame 1", "image of 16×12, the calibration is for 32×24"];
    check(encoded(&messages), &expected);
}

#[test]
fn a_vehicle_without_a_position_source_leaves_fixes_alone() {
    let messages = [fix(2, f64::NAN, 1.0), fix(1, 0.0, -1.0), Message::End];
    let (address, driver) = driver(encoded(&messages));
    let mut source = StreamSource::connect(&address, calibration(), LONG).unwrap();
    source.takes_fixes = false;
    assert!(source.next_input().is_none());
    drop(source);
    driver.join().unwrap();
}

#[test]
fn a_driver_that_says_no_hello_is_given_up() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let short = Duration::from_millis(50);
    let silent = StreamSource::connect(&address, calibration(), short);
    let error = silent.err().unwrap().to_string();
    let expected = format!("driver at {address} did not say hello: no byte came for 0.05 s");
    assert!(error.contains(&expected), "{error}");
    let _client: TcpStream = listener.accept().unwrap().0;

    drop(listener);
    let error = StreamSource::connect(&address, calibration(), LONG)
        .err()
        .unwrap();
    let expected = format!("cannot reach the stream driver at {address}");
    assert_eq!(error.to_string(), expected);
}

#[test]
fn a_driver_that_stops_within_a_message_is_given_up() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let half = encoded(&[Message::Hello, frame(1, 32, 24)]);
    let client = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&half[..half.len() - 1]).unwrap();
        stream
    });
    let mut source = StreamSource::connect(&address, calibration(), LONG).unwrap();
    source.patience = Duration::from_millis(50);
    let Some(Input::BrokenOff { reason }) = source.next_input() else {
        panic!("half a message is the end");
    };
    assert!(reason.contains("no byte came for 0.05 s"), "{reason}");
    assert!(source.next_input().is_none());
    drop(client.join().unwrap());
}

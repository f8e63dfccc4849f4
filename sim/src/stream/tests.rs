use proptest::prelude::*;

use super::*;

fn fix() -> Fix {
    Fix {
        captured_at: Timestamp::from_nanoseconds(1_237_000_001),
        position_in_site: Vector3::new(1.5, -2.25, 0.4),
        covariance_in_site: Matrix3::new(4.0, 0.5, 0.1, 0.5, 3.0, 0.2, 0.1, 0.2, 2.0) * 1e-4,
    }
}

fn frame() -> Frame {
    Frame {
        captured_at: Timestamp::from_nanoseconds(-7),
        image: Image::from_pixels(5, 3, (0..15).collect()).unwrap(),
    }
}

fn velocity() -> VelocityCommand {
    VelocityCommand {
        captured_at: Timestamp::from_nanoseconds(10_100_000_000),
        velocity_in_heading: Vector3::new(0.25, -0.5, 0.125),
    }
}

fn all_messages() -> Vec<Message> {
    let captured_at = Timestamp::from_nanoseconds(i64::MAX);
    vec![
        Message::Hello,
        Message::Fix(fix()),
        Message::Frame(frame()),
        Message::Velocity(velocity()),
        Message::Acknowledgement { captured_at },
        Message::End,
    ]
}

fn encoded(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    bytes
}

#[test]
fn messages_survive_the_wire_one_after_another() {
    let mut bytes = Vec::new();
    for message in all_messages() {
        encode(&message, &mut bytes);
    }
    let mut reader = bytes.as_slice();
    for expected in all_messages() {
        let before = reader;
        let (message, used_bytes) = decode(before).unwrap().unwrap();
        assert_eq!(message, expected);
        assert_eq!(read_message(&mut reader).unwrap(), expected);
        assert_eq!(before.len() - reader.len(), used_bytes);
    }
    assert!(reader.is_empty());
}

#[test]
fn a_fix_has_these_bytes() {
    let bytes = encoded(&Message::Fix(fix()));
    assert_eq!(&bytes[..8], b"SLS1\x03\x00\x00\x00");
    assert_eq!(&bytes[8..16], &1_237_000_001_i64.to_le_bytes());
    assert_eq!(&bytes[24..28], &72_u32.to_le_bytes());
    assert_eq!(&bytes[28..36], &1.5_f64.to_le_bytes());
    assert_eq!(bytes.len(), HEADER_BYTES + 72);
}

#[test]
fn a_velocity_has_these_bytes() {
    let mut expected = b"SLS1\x06\x00\x00\x00".to_vec();
    expected.extend(10_100_000_000_i64.to_le_bytes());
    expected.extend([0; 8]);
    expected.extend(24_u32.to_le_bytes());
    for number in [0.25_f64, -0.5, 0.125] {
        expected.extend(number.to_le_bytes());
    }
    assert_eq!(encoded(&Message::Velocity(velocity())), expected);
}

#[test]
fn waits_for_more_while_a_message_is_cut_short() {
    for message in all_messages() {
        let bytes = encoded(&message);
        for length in 0..bytes.len() {
            assert_eq!(decode(&bytes[..length]), Ok(None), "{length} bytes");
            let error = read_message(&mut &bytes[..length]).unwrap_err();
            assert!(matches!(error, ReadError::Io(_)));
        }
    }
}

#[test]
fn refuses_headers_that_lie() {
    let check = |message: &Message, offset: usize, patch: &[u8], expected: Malformed| {
        let mut bytes = encoded(message);
        bytes[offset..offset + patch.len()].copy_from_slice(patch);
        assert_eq!(decode(&bytes), Err(expected));
    };
    let frame = Message::Frame(frame());
    check(&frame, 0, b"HTTP", Malformed::Magic { got: *b"HTTP" });
    check(&frame, 4, &[9], Malformed::Kind { got: 9 });
    let format = Malformed::Format {
        got: 2,
        expected: 1,
    };
    check(&frame, 5, &[2], format);
    check(&frame, 6, &[0, 1], Malformed::Reserved { got: [0, 1] });
    let huge = Malformed::ImageSize {
        width: u32::MAX,
        height: 3,
    };
    check(&frame, 16, &u32::MAX.to_le_bytes(), huge);
    let flat = Malformed::ImageSize {
        width: 5,
        height: 0,
    };
    check(&frame, 20, &[0; 4], flat);
    let long = Malformed::PayloadSize {
        got: 4_294_967_295,
        expected: 15,
    };
    check(&frame, 24, &u32::MAX.to_le_bytes(), long);
    let nan = f64::NAN.to_le_bytes();
    let not_finite = |what| Malformed::NotFinite { what };
    check(&Message::Fix(fix()), 36, &nan, not_finite("a fix"));
    let velocity = Message::Velocity(velocity());
    check(&velocity, 44, &nan, not_finite("a velocity"));
    let infinite = f64::INFINITY.to_le_bytes();
    check(&velocity, 28, &infinite, not_finite("a velocity"));
    let format = Malformed::Format {
        got: 1,
        expected: 0,
    };
    check(&velocity, 5, &[1], format);
    let short = Malformed::PayloadSize {
        got: 23,
        expected: 24,
    };
    check(&velocity, 24, &23_u32.to_le_bytes(), short);
    let sized = Malformed::ImageSize {
        width: 1,
        height: 0,
    };
    check(&Message::End, 16, &1_u32.to_le_bytes(), sized);
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = decode(&bytes);
        let _ = read_message(&mut bytes.as_slice());
    }

    #[test]
    fn arbitrary_headers_never_panic(tail in prop::collection::vec(any::<u8>(), 24..120)) {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(tail);
        let _ = decode(&bytes);
    }
}

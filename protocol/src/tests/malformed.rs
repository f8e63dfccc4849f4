//! Bytes from broken, old, foreign or hostile senders: refused with a reason, never a panic.

use proptest::prelude::*;

use super::{Sample, samples};
use crate::DecodeError;

fn refused(sample: &Sample, bytes: &[u8]) -> DecodeError {
    let kind = sample.kind;
    (sample.decode)(bytes).expect_err(&format!("{kind}: {} bytes were accepted", bytes.len()))
}

#[test]
fn a_message_cut_anywhere_is_refused() {
    for sample in samples() {
        for size_bytes in 0..sample.bytes.len() {
            let error = refused(&sample, &sample.bytes[..size_bytes]);
            assert!(matches!(error, DecodeError::Malformed { .. }), "{error}");
        }
    }
}

#[test]
fn bytes_after_the_message_are_refused() {
    for sample in samples() {
        let longer = [&sample.bytes[..], &[0]].concat();
        let error = refused(&sample, &longer).to_string();
        assert!(error.contains("1 bytes after the message"), "{error}");
    }
}

#[test]
fn no_flipped_bit_panics() {
    for sample in samples() {
        let mut bytes = sample.bytes.clone();
        for bit in 0..bytes.len() * 8 {
            bytes[bit / 8] ^= 1 << (bit % 8);
            let _ = (sample.decode)(&bytes);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
    }
}

#[test]
fn another_major_version_is_refused_by_name_and_a_minor_one_accepted() {
    for sample in samples() {
        // "version": [1, 0] is the first entry: a2-style map head, 8 bytes of text, the list.
        let offset = sample
            .bytes
            .windows(8)
            .position(|eight| eight == b"gversion");
        let list = offset.unwrap() + 8;
        assert_eq!(sample.bytes[list..list + 3], [0x82, 1, 0]);
        let mut bytes = sample.bytes.clone();
        bytes[list + 2] = 7;
        assert_eq!((sample.decode)(&bytes), Ok(()));
        bytes[list + 1] = 2;
        let error = refused(&sample, &bytes);
        let expected = format!("{}: version 2.7, this vehicle speaks 1", sample.kind);
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn a_newer_minor_version_may_have_more_fields() {
    for sample in samples() {
        // One more pair at the end of the map, which has fewer than 23.
        let mut bytes = sample.bytes.clone();
        bytes[0] += 1;
        bytes.extend(b"\x66future\x82\x01\xa1\x61x\xf5");
        assert_eq!((sample.decode)(&bytes), Ok(()), "{}", sample.kind);
    }
}

#[test]
fn too_many_bytes_are_refused_before_they_are_read() {
    for sample in samples() {
        let error = refused(&sample, &vec![0x80; sample.size_bytes_max + 1]);
        assert!(matches!(error, DecodeError::TooLarge { .. }));
    }
}

#[test]
fn deep_nesting_does_not_overflow_the_stack() {
    for sample in samples() {
        for opening in [&b"\x81"[..], b"\xa1\x61x", b"\x9f", b"\xc1", b"\xd8\x45"] {
            let bytes = opening.repeat(sample.size_bytes_max / opening.len());
            refused(&sample, &bytes);
            // The same in an unknown field, after the version.
            let field = [&b"\xa2gversion\x82\x01\x00\x61x"[..], &bytes].concat();
            let size_bytes = field.len().min(sample.size_bytes_max);
            refused(&sample, &field[..size_bytes]);
        }
    }
}

#[test]
fn foreign_cbor_is_refused_with_a_reason() {
    let foreign: [&[u8]; 8] = [
        b"",
        b"\xf6",
        b"\x83\x01\x02\x03",
        b"\xa0",
        b"\xa1\x61a\x01",
        b"\xa1gversion\x61x",
        b"\xa1gversion\x82\x01\x00",
        b"not cbor at all",
    ];
    for sample in samples() {
        for bytes in foreign {
            let error = refused(&sample, bytes).to_string();
            assert!(
                error.starts_with(sample.kind) && error.len() < 250,
                "{error}"
            );
        }
    }
}

/// Any half- or single-precision float in a message may arrive as NaN or infinity.
#[test]
fn numbers_that_are_not_finite_are_refused() {
    for sample in samples() {
        for offset in 0..sample.bytes.len() {
            let (size_bytes, special): (usize, &[&[u8]]) = match sample.bytes[offset] {
                0xf9 => (2, &[b"\x7e\x00", b"\x7c\x00"]),
                0xfa => (4, &[b"\x7f\xc0\x00\x00", b"\x7f\x80\x00\x00"]),
                _ => continue,
            };
            for bits in special {
                let mut bytes = sample.bytes.clone();
                if offset + 1 + size_bytes <= bytes.len() {
                    bytes[offset + 1..offset + 1 + size_bytes].copy_from_slice(bits);
                    // Inside of an array of bytes these are no floats: anything but a panic.
                    let outcome = (sample.decode)(&bytes);
                    let is_field = sample.kind != "chunk" && sample.kind != "have";
                    assert!(!is_field || outcome.is_err(), "{} at {offset}", sample.kind);
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        for sample in samples() {
            let _ = (sample.decode)(&bytes);
        }
    }

    #[test]
    fn no_damage_panics(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        for sample in samples() {
            let mut bytes = sample.bytes.clone();
            for (place, value) in &damage {
                let idx = place.index(bytes.len());
                bytes[idx] = *value;
            }
            let _ = (sample.decode)(&bytes);
        }
    }
}

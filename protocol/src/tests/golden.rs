//! The bytes of version 1.0. If this test fails, vehicles of two builds no longer understand each
//! other: restore the layout, or raise the version.

use super::samples;

/// The name of each message, and its bytes in the lines below it, in the order of the samples.
const GOLDEN: &str = include_str!("golden.hex");

#[test]
fn the_bytes_of_every_message_are_those_of_version_1() {
    let mut expected: Vec<(&str, String)> = Vec::new();
    for line in GOLDEN.lines() {
        match (line.strip_prefix("  "), expected.last_mut()) {
            (Some(hex), Some((_, bytes))) => bytes.push_str(hex),
            _ => expected.push((line.trim_end_matches(':'), String::new())),
        }
    }
    let samples = samples();
    assert_eq!(expected.len(), samples.len());
    for ((kind, expected), sample) in expected.iter().zip(samples) {
        let got: String = sample
            .bytes
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(*kind, sample.kind);
        assert_eq!(got, *expected, "{kind}");
    }
}

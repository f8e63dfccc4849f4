//! A chunk is read by three lines of numpy, and gives the same points.

use std::io::Write;
use std::process::{Command, Stdio};

use geometry::Timestamp;
use nalgebra::Vector3;
use protocol::{
    Chunk, ChunkCamera, ChunkHeader, ChunkId, ChunkNumber, ChunkPoint, MapId, Reference, VehicleId,
    encode,
};

fn chunk() -> Chunk {
    let header = ChunkHeader {
        id: ChunkId {
            map: MapId {
                anchor: VehicleId::new("ugv1").expect("it is a legal name"),
                epoch: "1-9f3c21ab".parse().expect("it is a legal epoch"),
            },
            number: ChunkNumber(0),
        },
        captured_at: Timestamp::from_nanoseconds(1),
        camera: ChunkCamera {
            focal_length_px: 480.0,
            width_px: 640,
            height_px: 360,
        },
        replaces: Vec::new(),
        reference: Reference::Fixed,
        provenance: Vec::new(),
        signature: Vec::new(),
    };
    let points: Vec<ChunkPoint> = (0..100)
        .map(|idx| {
            let share = f64::from(idx) / 100.0;
            let depth = 1.0 + 9.0 * share * share;
            ChunkPoint {
                position_in_chunk: Vector3::new(share - 0.5, 0.3 * share, 1.0) * depth,
                depth_sigma: 0.02 * depth,
                descriptor: [idx as u8; 32],
            }
        })
        .collect();
    Chunk::new(header, &points).expect("all points are in front of the camera")
}

/// The interpreter named by `STARLING_PYTHON`, else `python3`; `None` without numpy and cbor2.
fn python() -> Option<String> {
    let python = std::env::var("STARLING_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut probe = Command::new(&python);
    let probe = probe
        .args(["-c", "import numpy, cbor2"])
        .stderr(Stdio::null());
    probe
        .status()
        .is_ok_and(|status| status.success())
        .then_some(python)
}

#[test]
fn three_lines_of_numpy_read_a_chunk() {
    let Some(python) = python() else {
        println!("skipped: no numpy");
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/decode_chunk.py");
    let mut child = Command::new(python)
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child
        .stdin
        .take()
        .unwrap()
        .write_all(&encode(&chunk()))
        .unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.lines().count(), 100);
    for (line, point) in text.lines().zip(chunk().points()) {
        let mut words = line.split(' ');
        let mut number = || words.next().unwrap().parse::<f64>().unwrap();
        let position = Vector3::new(number(), number(), number());
        assert!((position - point.position_in_chunk).norm() < 1e-12 * position.norm());
        assert!((number() / point.depth_sigma - 1.0).abs() < 1e-12);
        let hex: String = point
            .descriptor
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(words.next(), Some(hex.as_str()));
    }
}

//! The quantised layout: its error, its size, its limits.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::{DecodeError, MapId, decode, encode};

pub(crate) fn header() -> ChunkHeader {
    ChunkHeader {
        id: ChunkId {
            map: MapId {
                anchor: VehicleId::new("ugv1").unwrap(),
                epoch: "1-9f3c21ab".parse().unwrap(),
            },
            number: ChunkNumber(17),
        },
        captured_at: Timestamp::from_nanoseconds(1_700_000_000_123_456_789),
        camera: ChunkCamera {
            focal_length_px: 480.0,
            width_px: 640,
            height_px: 360,
        },
        replaces: Vec::new(),
        reference: Reference::Fixed,
        provenance: Vec::new(),
        signature: Vec::new(),
    }
}

fn point(position: Vector3<f64>, relative_sigma: f64) -> ChunkPoint {
    ChunkPoint {
        position_in_chunk: position,
        depth_sigma: relative_sigma * position.z,
        descriptor: std::array::from_fn(|idx| (position.x.to_bits() >> (idx % 8)) as u8),
    }
}

fn points() -> impl Strategy<Value = Vec<ChunkPoint>> {
    let one = (-3.9..3.9_f64, -3.9..3.9_f64, -6.9..6.9_f64, -13.0..1.5_f64).prop_map(
        |(x, y, log_depth, log_sigma)| {
            point(Vector3::new(x, y, 1.0) * log_depth.exp(), log_sigma.exp2())
        },
    );
    prop::collection::vec(one, 1..60)
}

proptest! {
    /// Even in the worst case: 75° to all sides and depths over six decades.
    #[test]
    fn coding_moves_no_point_by_more_than_its_bound(points in points(), scale in -9.0..9.0_f64) {
        let mut points = points;
        for point in &mut points {
            point.position_in_chunk *= scale.exp();
            point.depth_sigma *= scale.exp();
        }
        let chunk = Chunk::new(header(), &points).unwrap();
        for (coded, given) in chunk.points().zip(&points) {
            let error = (coded.position_in_chunk - given.position_in_chunk).norm();
            prop_assert!(error <= 2e-4 * given.position_in_chunk.norm());
            prop_assert_eq!(coded.descriptor, given.descriptor);
            let ratio = coded.depth_sigma / given.depth_sigma;
            prop_assert!((0.999..1.046).contains(&ratio), "{}", ratio);
        }
        let bytes = encode(&chunk);
        let back: Chunk = decode(&bytes).unwrap();
        prop_assert_eq!(&back, &chunk);
        prop_assert_eq!(encode(&back), bytes);
    }

    #[test]
    fn every_list_of_points_is_split_or_refused(count in 0..4000_usize) {
        let points: Vec<ChunkPoint> =
            (0..count).map(|idx| point(Vector3::new(0.0, 0.0, 1.0 + idx as f64), 0.1)).collect();
        let chunks = Chunk::split(&header(), &points).unwrap();
        prop_assert_eq!(chunks.iter().map(Chunk::point_count).sum::<usize>(), count);
        for (idx, chunk) in chunks.iter().enumerate() {
            prop_assert_eq!(chunk.id().number.0, 17 + idx as u32);
            prop_assert!(encode(chunk).len() <= 64 * 1024);
        }
        prop_assert_eq!(Chunk::new(header(), &points).is_ok(), (1..=1600).contains(&count));
    }
}

#[test]
fn a_typical_chunk_costs_less_than_forty_bytes_a_point() {
    let points: Vec<ChunkPoint> = (0..250)
        .map(|idx| {
            let share = f64::from(idx) / 250.0;
            let ray = Vector3::new(1.3 * share - 0.65, 0.37 * (20.0 * share).sin(), 1.0);
            point(ray * (1.0 + 7.0 * (3.0 * share).fract()), 0.03)
        })
        .collect();
    let bytes = encode(&Chunk::new(header(), &points).unwrap());
    println!(
        "{} B for 250 points, {} B beside them",
        bytes.len(),
        bytes.len() - 39 * 250
    );
    assert!(bytes.len() <= 40 * 250);
    // Nor does a chunk of half as many, thanks to half-precision grids and absent defaults.
    assert!(bytes.len() - 39 * 250 < 180);
}

#[test]
fn the_longest_header_fits_beside_the_most_points() {
    let mut header = header();
    header.replaces = (0..64).map(|idx| ChunkNumber(u32::MAX - idx)).collect();
    header.provenance = vec![VehicleId::new(&"x".repeat(32)).unwrap(); 64];
    header.signature = vec![7; 128];
    header.id.map.anchor = header.provenance[0].clone();
    let points = vec![point(Vector3::new(0.1, 0.2, 3.0), 0.1); MAX_POINTS_PER_CHUNK];
    let size_bytes = encode(&Chunk::new(header, &points).unwrap()).len();
    assert!(size_bytes <= Chunk::SIZE_BYTES_MAX + 1, "{size_bytes}");
}

#[test]
fn points_that_no_camera_sees_are_refused() {
    for position in [
        Vector3::new(0.0, 0.0, 0.0),
        Vector3::new(0.0, 0.0, -1.0),
        Vector3::new(4.0, 0.0, 1.0),
        Vector3::new(f64::NAN, 0.0, 1.0),
        Vector3::new(0.0, 0.0, f64::INFINITY),
        Vector3::new(0.0, 0.0, 1e-300),
    ] {
        assert!(!Chunk::holds(&position));
        let refused = Chunk::new(header(), &[point(position, 0.1)]);
        assert!(matches!(
            refused,
            Err(CutRefusal::Point { point_idx: 0, .. })
        ));
    }
    let deep = [
        point(Vector3::z() * 1e-4, 0.1),
        point(Vector3::z() * 1e4, 0.1),
    ];
    assert!(matches!(
        Chunk::new(header(), &deep),
        Err(CutRefusal::DepthSpread { .. })
    ));
    let unknown = Chunk::new(header(), &[point(Vector3::z(), f64::NAN)]).unwrap();
    assert!(unknown.points().next().unwrap().depth_sigma > 3.0);
}

#[test]
fn arrays_of_unequal_length_are_refused() {
    let chunk = Chunk::new(
        header(),
        &[point(Vector3::z(), 0.1), point(Vector3::z(), 0.1)],
    );
    let mut wire = chunk.unwrap().to_wire();
    wire.sigma.0.pop();
    let mut bytes = Vec::new();
    ciborium::into_writer(&wire, &mut bytes).unwrap();
    let error = decode::<Chunk>(&bytes).unwrap_err();
    let reason = "arrays of [2, 1, 2] points, expected as many in each".to_owned();
    assert_eq!(
        error,
        DecodeError::Invalid {
            kind: "chunk",
            reason
        }
    );
}

#[test]
fn uncertainty_grows_with_the_square_of_range_along_and_with_range_across() {
    let near = point(Vector3::new(0.0, 0.0, 2.0), 0.05);
    let covariance = near.covariance_in_chunk(&header().camera);
    assert!((covariance.m33.sqrt() - 0.1).abs() < 1e-3);
    assert!((covariance.m11.sqrt() - 2.0 / 480.0).abs() < 1e-9);
}

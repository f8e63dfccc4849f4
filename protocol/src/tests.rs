//! Every message: golden bytes, round trips, and what comes from broken or foreign senders.

mod golden;
mod malformed;
mod round_trip;

use geodesy::{Datum, Geodetic};
use geometry::{Matrix7, Similarity, Timestamp, Transform};
use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use crate::*;

pub(crate) fn vehicle(name: &str) -> VehicleId {
    VehicleId::new(name).unwrap()
}

fn map_id() -> MapId {
    MapId {
        anchor: vehicle("ugv1"),
        epoch: "1-9f3c21ab".parse().unwrap(),
    }
}

fn similarity<T, S>() -> Similarity<T, S> {
    // A rotation whose quaternion is exact: 0.5 in each part.
    let rotation = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.5, 0.5, 0.5, 0.5));
    Similarity::new(2.5, rotation, Vector3::new(1.0, -2.0, 3.0))
}

fn chunk() -> Chunk {
    let header = ChunkHeader {
        id: ChunkId {
            map: map_id(),
            number: ChunkNumber(17),
        },
        captured_at: Timestamp::from_nanoseconds(1_500_000_000),
        camera: ChunkCamera {
            focal_length_px: 480.0,
            width_px: 640,
            height_px: 360,
        },
        replaces: vec![ChunkNumber(4)],
        reference: Reference::Registered,
        provenance: vec![vehicle("ugv2")],
        signature: Vec::new(),
    };
    let point = |x: f64, z: f64| ChunkPoint {
        position_in_chunk: Vector3::new(x * z, 0.25 * z, z),
        depth_sigma: 0.0625 * z,
        descriptor: std::array::from_fn(|idx| idx as u8),
    };
    Chunk::new(header, &[point(-0.5, 1.0), point(0.5, 2.0)]).unwrap()
}

fn placement() -> Placement {
    Placement {
        map: map_id(),
        revision: 3,
        captured_at: Timestamp::from_nanoseconds(2_000_000_000),
        datum: Datum::Wgs84(Geodetic::from_degrees(47.25, 8.5, 400.0).unwrap()),
        enu_from_map: similarity(),
        covariance: Matrix7::identity() * 0.25,
        fix_sigma_m: 0.5,
        reference: Reference::Fixed,
        provenance: Vec::new(),
        signature: Vec::new(),
    }
}

fn page() -> PlacementPage {
    let placement = |number| ChunkPlacement {
        number: ChunkNumber(number),
        map_from_chunk: similarity(),
    };
    let placements = [placement(256), placement(258), placement(3)];
    PlacementPage::new(map_id(), 1, 4, &placements)
}

fn manifest() -> Manifest {
    let corner = Vector3::new(1.0, 2.0, 3.0);
    Manifest {
        map: map_id(),
        revision: 5,
        datum: Datum::site("lab").unwrap(),
        chunks: Ranges::run(ChunkNumber(0), ChunkNumber(258)),
        bounding_box: BoundingBox::new(-corner, corner),
        reference: Reference::Fixed,
        provenance: Vec::new(),
        public_key: Vec::new(),
        signature: Vec::new(),
        holder: vehicle("drone1"),
        held: [0, 1, 2, 7].into_iter().map(ChunkNumber).collect(),
    }
}

fn have() -> Have {
    let held: Ranges = [0, 1, 2, 7].into_iter().map(ChunkNumber).collect();
    Have {
        vehicle: vehicle("drone1"),
        map_count: 2,
        entries: vec![HaveEntry::new(map_id(), &held, 4, 9)],
    }
}

fn pose() -> Pose {
    Pose {
        vehicle: vehicle("drone1"),
        captured_at: Timestamp::from_nanoseconds(-1),
        state: VehicleState::Global,
        reason: "registered against ugv1".to_owned(),
        jump_count: 1,
        global: Some(GlobalPose {
            datum: Datum::site("lab").unwrap(),
            enu_from_body: Transform::new(
                *similarity::<(), ()>().rotation(),
                Vector3::new(1.0, 2.0, 3.0),
            ),
            covariance: Matrix6::identity() * 0.5,
            geodetic: None,
        }),
    }
}

/// A message's bytes, and whether other bytes are taken for one.
struct Sample {
    kind: &'static str,
    bytes: Vec<u8>,
    size_bytes_max: usize,
    decode: fn(&[u8]) -> Result<(), DecodeError>,
}

fn sample<M: Message>(message: &M) -> Sample {
    Sample {
        kind: M::KIND,
        bytes: encode(message),
        size_bytes_max: M::SIZE_BYTES_MAX,
        decode: |bytes| decode::<M>(bytes).map(|_| ()),
    }
}

fn samples() -> Vec<Sample> {
    vec![
        sample(&chunk()),
        sample(&placement()),
        sample(&page()),
        sample(&manifest()),
        sample(&have()),
        sample(&pose()),
    ]
}

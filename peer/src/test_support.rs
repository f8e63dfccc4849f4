//! Messages of a small map, for tests of whatever takes, keeps or answers with them.

use geodesy::Datum;
use geometry::{Matrix7, Similarity, Timestamp};
use nalgebra::Vector3;
use protocol::{
    Chunk, ChunkCamera, ChunkHeader, ChunkId, ChunkNumber, ChunkPoint, Manifest, MapId, Placement,
    Ranges, Reference, VehicleId,
};

pub fn vehicle(name: &str) -> VehicleId {
    VehicleId::new(name).unwrap()
}

/// An epoch of the ground vehicle's map.
pub fn map() -> MapId {
    MapId {
        anchor: vehicle("ugv1"),
        epoch: "1-0000000a".parse().unwrap(),
    }
}

/// A single point, one unit in front of the camera.
pub fn chunk(map: MapId, number: u32) -> Chunk {
    let header = ChunkHeader {
        id: ChunkId {
            map,
            number: ChunkNumber(number),
        },
        captured_at: Timestamp::default(),
        camera: ChunkCamera {
            focal_length_px: 180.0,
            width_px: 324,
            height_px: 244,
        },
        replaces: Vec::new(),
        reference: Reference::Fixed,
        provenance: Vec::new(),
        signature: Vec::new(),
    };
    let point = ChunkPoint {
        position_in_chunk: Vector3::z(),
        depth_sigma: 0.01,
        descriptor: [1; 32],
    };
    Chunk::new(header, &[point]).unwrap()
}

/// The map's frame is the site's.
pub fn placement(map: MapId, revision: u32) -> Placement {
    Placement {
        map,
        revision,
        captured_at: Timestamp::default(),
        datum: Datum::site("lab").unwrap(),
        enu_from_map: Similarity::identity(),
        covariance: Matrix7::identity(),
        fix_sigma_m: 0.02,
        reference: Reference::Fixed,
        provenance: Vec::new(),
        signature: Vec::new(),
    }
}

/// Ten chunks, all held by the anchor itself.
pub fn manifest(map: MapId, revision: u32) -> Manifest {
    let chunks = Ranges::run(ChunkNumber(0), ChunkNumber(9));
    Manifest {
        holder: map.anchor.clone(),
        map,
        revision,
        datum: Datum::site("lab").unwrap(),
        chunks: chunks.clone(),
        bounding_box: None,
        reference: Reference::Fixed,
        provenance: Vec::new(),
        public_key: Vec::new(),
        signature: Vec::new(),
        held: chunks,
    }
}

//! Chunks: what an anchor saw first from one keyframe, frozen.

use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use crate::arrays::{self, Uint8Array, Uint16Array};
use crate::codec::{Message, VERSION};
use crate::wire::{self, Reference};
use crate::{ChunkId, ChunkNumber, VehicleId};

mod quantise;

use quantise::Grid;

/// A chunk of this many points stays below 64 KiB whatever its header says.
pub const MAX_POINTS_PER_CHUNK: usize = 1600;
/// How many chunks one chunk may replace, and how many sources it may name.
const LIST_COUNT_MAX: usize = 64;

/// Points that were first seen from one keyframe, in that keyframe's camera frame.
///
/// The bytes, with 39 of them per point:
/// ```text
/// { version, anchor, epoch, n, captured_at, camera,
///   start: [x/z, y/z, ln z], step: [x/z, y/z, ln z],
///   points:      u16 × 3 per point   ── start + step · value ──┐
///   sigma:       u8 per point        σ of ln z = 2^(value/16 − 14)
///   descriptors: 32 bytes per point                            │
///   replaces?, reference?, provenance?, signature }            │
///            x = z·(x/z)   y = z·(y/z)   z = exp(ln z)  ◄──────┘
/// ```
/// Steps are chosen per chunk so that coding moves a point by at most 2·10⁻⁴ of its distance.
/// Where the chunk stands in its map is a [`crate::ChunkPlacement`], not part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    header: ChunkHeader,
    grid: Grid,
    points: Vec<[u16; 3]>,
    sigmas: Vec<u8>,
    descriptors: Vec<[u8; 32]>,
}

/// What a chunk says besides its points.
#[derive(Clone, Debug, PartialEq)]
pub struct ChunkHeader {
    /// Its name.
    pub id: ChunkId,
    /// When the keyframe's image was taken, on the anchor's clock.
    pub captured_at: Timestamp,
    /// The camera that took it.
    pub camera: ChunkCamera,
    /// Earlier chunks of the same map that this one makes obsolete once it is stored.
    pub replaces: Vec<ChunkNumber>,
    /// How the map that it is part of came to its global position.
    pub reference: Reference,
    /// The maps' owners whose evidence a registered map rests on.
    pub provenance: Vec<VehicleId>,
    /// The anchor's signature; empty where keys are not configured.
    pub signature: Vec<u8>,
}

/// What is needed to judge what a keyframe could see, after undistortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChunkCamera {
    /// Focal length (px).
    pub focal_length_px: f32,
    /// Image width (px).
    pub width_px: u16,
    /// Image height (px).
    pub height_px: u16,
}

/// One point of a chunk.
#[derive(Clone, Debug, PartialEq)]
pub struct ChunkPoint {
    /// In the keyframe's camera, unit of the map.
    pub position_in_chunk: Vector3<f64>,
    /// The standard deviation of the depth `z` [unit of the map].
    pub depth_sigma: f64,
    /// The 256-bit binary descriptor.
    pub descriptor: [u8; 32],
}

/// Why points cannot be a chunk.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CutRefusal {
    /// No point.
    #[error("no points")]
    Empty,
    /// More than [`MAX_POINTS_PER_CHUNK`].
    #[error("{got} points, at most {MAX_POINTS_PER_CHUNK} fit into 64 KiB")]
    TooMany {
        /// How many there are.
        got: usize,
    },
    /// A point that the layout cannot hold.
    #[error("point {point_idx} at {position:?} is not in front of the camera")]
    Point {
        /// Its index.
        point_idx: usize,
        /// Where it is.
        position: [f64; 3],
    },
    /// The farthest point is more than a million times farther than the nearest.
    #[error("depths from {nearest} to {farthest} are too far apart for one chunk")]
    DepthSpread {
        /// The least depth.
        nearest: f64,
        /// The greatest depth.
        farthest: f64,
    },
    /// A list in the header is too long, or the camera has no area or focal length.
    #[error("the chunk's {part} is out of bounds")]
    Header {
        /// Which part.
        part: &'static str,
    },
}

impl Chunk {
    /// The chunk with these points, or why there is none.
    pub fn new(header: ChunkHeader, points: &[ChunkPoint]) -> Result<Self, CutRefusal> {
        check_header(&header)?;
        if points.len() > MAX_POINTS_PER_CHUNK {
            return Err(CutRefusal::TooMany { got: points.len() });
        }
        let grid = Grid::around(points)?;
        Ok(Self {
            points: points
                .iter()
                .map(|p| grid.quantise(&p.position_in_chunk))
                .collect(),
            sigmas: points.iter().map(quantise::sigma).collect(),
            descriptors: points.iter().map(|point| point.descriptor).collect(),
            header,
            grid,
        })
    }

    /// As many chunks as the points need, numbered upwards from the header's number.
    pub fn split(header: &ChunkHeader, points: &[ChunkPoint]) -> Result<Vec<Self>, CutRefusal> {
        let parts = points.chunks(MAX_POINTS_PER_CHUNK).enumerate();
        parts
            .map(|(idx, part)| {
                let mut header = header.clone();
                header.id.number.0 += idx as u32;
                if idx > 0 {
                    header.replaces.clear();
                }
                Self::new(header, part)
            })
            .collect()
    }

    /// Whether the layout can hold a point: finite, in front of the camera, within 75° of its axis.
    pub fn holds(position_in_chunk: &Vector3<f64>) -> bool {
        quantise::logarithmic(position_in_chunk).is_some()
    }

    /// What the chunk says besides its points.
    pub fn header(&self) -> &ChunkHeader {
        &self.header
    }

    /// Its name.
    pub fn id(&self) -> &ChunkId {
        &self.header.id
    }

    /// How many points it has; at least one.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// The points, as every holder of the chunk decodes them.
    pub fn points(&self) -> impl ExactSizeIterator<Item = ChunkPoint> + '_ {
        (0..self.points.len()).map(|idx| {
            let position_in_chunk = self.grid.position(self.points[idx]);
            ChunkPoint {
                position_in_chunk,
                depth_sigma: position_in_chunk.z * quantise::relative_sigma(self.sigmas[idx]),
                descriptor: self.descriptors[idx],
            }
        })
    }
}

impl ChunkPoint {
    /// The covariance of the position: along the ray from `depth_sigma`, across it one pixel.
    pub fn covariance_in_chunk(&self, camera: &ChunkCamera) -> Matrix3<f64> {
        let depth = self.position_in_chunk.z;
        let ray = self.position_in_chunk / depth;
        let across = depth / f64::from(camera.focal_length_px);
        let mut covariance = ray * ray.transpose() * (self.depth_sigma * self.depth_sigma);
        covariance += Matrix3::identity() * (across * across);
        covariance
    }
}

fn check_header(header: &ChunkHeader) -> Result<(), CutRefusal> {
    let refuse = |part| Err(CutRefusal::Header { part });
    let camera = &header.camera;
    let focal_legal = (1.0..=1e5).contains(&camera.focal_length_px);
    if !focal_legal || camera.width_px == 0 || camera.height_px == 0 {
        return refuse("camera");
    }
    if header.replaces.len() > LIST_COUNT_MAX {
        return refuse("replaces");
    }
    if header.provenance.len() > LIST_COUNT_MAX {
        return refuse("provenance");
    }
    if header.signature.len() > 128 {
        return refuse("signature");
    }
    Ok(())
}

/// The chunk's fields in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct ChunkWire {
    version: [u16; 2],
    anchor: String,
    epoch: String,
    n: u32,
    captured_at: i64,
    camera: (f32, u16, u16),
    start: [f64; 3],
    step: [f64; 3],
    points: Uint16Array,
    sigma: Uint8Array,
    descriptors: Uint8Array,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(deserialize_with = "wire::list::<_, _, LIST_COUNT_MAX>")]
    replaces: Vec<u32>,
    #[serde(default, skip_serializing_if = "Reference::is_fixed")]
    reference: Reference,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(deserialize_with = "wire::list::<_, _, LIST_COUNT_MAX>")]
    provenance: Vec<String>,
    signature: ByteBuf,
}

impl Message for Chunk {
    const KIND: &'static str = "chunk";
    const SIZE_BYTES_MAX: usize = 64 * 1024;
    type Wire = ChunkWire;

    fn to_wire(&self) -> ChunkWire {
        let ChunkHeader { id, camera, .. } = &self.header;
        ChunkWire {
            version: VERSION,
            anchor: id.map.anchor.to_string(),
            epoch: id.map.epoch.to_string(),
            n: id.number.0,
            captured_at: self.header.captured_at.nanoseconds(),
            camera: (camera.focal_length_px, camera.width_px, camera.height_px),
            start: self.grid.start,
            step: self.grid.step,
            points: arrays::from_u16(self.points.iter().flatten().copied()),
            sigma: arrays::bytes(self.sigmas.clone()),
            descriptors: arrays::bytes(self.descriptors.concat()),
            replaces: self.header.replaces.iter().map(|number| number.0).collect(),
            reference: self.header.reference,
            provenance: wire::names(&self.header.provenance),
            signature: ByteBuf::from(self.header.signature.clone()),
        }
    }

    fn from_wire(wire: ChunkWire) -> Result<Self, String> {
        let header = ChunkHeader {
            id: ChunkId {
                map: wire::map_from_wire(&wire.anchor, &wire.epoch)?,
                number: ChunkNumber(wire.n),
            },
            captured_at: Timestamp::from_nanoseconds(wire.captured_at),
            camera: ChunkCamera {
                focal_length_px: wire.camera.0,
                width_px: wire.camera.1,
                height_px: wire.camera.2,
            },
            replaces: wire.replaces.into_iter().map(ChunkNumber).collect(),
            reference: wire.reference,
            provenance: wire::vehicles_from_wire(&wire.provenance)?,
            signature: wire.signature.into_vec(),
        };
        check_header(&header).map_err(|refusal| refusal.to_string())?;
        let values = arrays::to_u16(&wire.points)?;
        let (points, points_rest) = values.as_chunks::<3>();
        let (descriptors, descriptors_rest) = wire.descriptors.0.as_chunks::<32>();
        let whole = points_rest.is_empty() && descriptors_rest.is_empty();
        let counts = [points.len(), wire.sigma.0.len(), descriptors.len()];
        if !whole || counts.iter().any(|count| *count != counts[0]) {
            return Err(format!(
                "arrays of {counts:?} points, expected as many in each"
            ));
        }
        if counts[0] == 0 || counts[0] > MAX_POINTS_PER_CHUNK {
            return Err(format!(
                "{} points, expected 1 to {MAX_POINTS_PER_CHUNK}",
                counts[0]
            ));
        }
        Ok(Self {
            header,
            grid: Grid::new(wire.start, wire.step)?,
            points: points.to_vec(),
            sigmas: wire.sigma.0.to_vec(),
            descriptors: descriptors.to_vec(),
        })
    }
}

#[cfg(test)]
mod tests;

//! What a map consists of, and what of it the replying vehicle holds.

use geodesy::Datum;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use crate::codec::{Message, VERSION};
use crate::wire::{self, DatumWire, PROVENANCE_COUNT_MAX, RUN_COUNT_MAX, Reference};
use crate::{MapId, Ranges, VehicleId};

/// The table of contents of one map. The highest (epoch, revision) counts; `held` of all replies
/// is united.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifest {
    /// Which map.
    pub map: MapId,
    /// Counts the manifests of this epoch, from one.
    pub revision: u32,
    /// What ENU is relative to; the same throughout an epoch.
    pub datum: Datum,
    /// The chunks that exist.
    pub chunks: Ranges,
    /// Where the map's points are, once it stands on the Earth.
    pub bounding_box: Option<BoundingBox>,
    /// How the map came to its global position.
    pub reference: Reference,
    /// Whose evidence a registered map rests on.
    pub provenance: Vec<VehicleId>,
    /// The anchor's public key; empty where keys are not configured.
    pub public_key: Vec<u8>,
    /// The anchor's signature over everything above; empty where keys are not configured.
    pub signature: Vec<u8>,
    /// Who replies.
    pub holder: VehicleId,
    /// The chunks that the replying vehicle holds.
    pub held: Ranges,
}

/// An axis-parallel box in ENU (m), inside out never.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingBox {
    min_m: Vector3<f64>,
    max_m: Vector3<f64>,
}

impl BoundingBox {
    /// The smallest box around these points; `None` without points, or if one is not finite.
    pub fn around(points_in_enu: impl Iterator<Item = Vector3<f64>>) -> Option<Self> {
        let first = Vector3::repeat(f64::INFINITY);
        let (min_m, max_m) = points_in_enu.fold((first, -first), |(min, max), point| {
            // Written so that NaN poisons the box instead of vanishing.
            let finite = point.iter().all(|value| value.is_finite());
            let point = if finite {
                point
            } else {
                Vector3::repeat(f64::NAN)
            };
            (min.zip_map(&point, lower), max.zip_map(&point, higher))
        });
        Self::new(min_m, max_m)
    }

    /// The box with these corners; `None` if not finite or inside out.
    pub fn new(min_m: Vector3<f64>, max_m: Vector3<f64>) -> Option<Self> {
        let legal = |axis: usize| {
            min_m[axis] <= max_m[axis] && min_m[axis].abs() <= 1e9 && max_m[axis].abs() <= 1e9
        };
        (0..3).all(legal).then_some(Self { min_m, max_m })
    }

    /// The corner with the least coordinates (m).
    pub fn min_m(&self) -> &Vector3<f64> {
        &self.min_m
    }

    /// The corner with the greatest coordinates (m).
    pub fn max_m(&self) -> &Vector3<f64> {
        &self.max_m
    }

    /// The smallest box that holds both.
    pub fn united(&self, other: &Self) -> Self {
        Self {
            min_m: self.min_m.inf(&other.min_m),
            max_m: self.max_m.sup(&other.max_m),
        }
    }
}

fn lower(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.min(b)
    }
}

fn higher(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.max(b)
    }
}

/// The manifest's fields in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct ManifestWire {
    version: [u16; 2],
    anchor: String,
    epoch: String,
    revision: u32,
    datum: DatumWire,
    chunk_count: u64,
    #[serde(deserialize_with = "wire::list::<_, _, { 2 * RUN_COUNT_MAX }>")]
    chunks: Vec<u32>,
    bounding_box: Option<[f64; 6]>,
    #[serde(default, skip_serializing_if = "Reference::is_fixed")]
    reference: Reference,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(deserialize_with = "wire::list::<_, _, PROVENANCE_COUNT_MAX>")]
    provenance: Vec<String>,
    public_key: ByteBuf,
    signature: ByteBuf,
    holder: String,
    #[serde(deserialize_with = "wire::list::<_, _, { 2 * RUN_COUNT_MAX }>")]
    held: Vec<u32>,
}

impl Message for Manifest {
    const KIND: &'static str = "manifest";
    const SIZE_BYTES_MAX: usize = 128 * 1024;
    type Wire = ManifestWire;

    fn to_wire(&self) -> ManifestWire {
        ManifestWire {
            version: VERSION,
            anchor: self.map.anchor.to_string(),
            epoch: self.map.epoch.to_string(),
            revision: self.revision,
            datum: wire::datum_to_wire(&self.datum),
            chunk_count: self.chunks.count(),
            chunks: wire::ranges_to_wire(&self.chunks),
            bounding_box: self.bounding_box.map(|area| {
                let (min, max) = (area.min_m, area.max_m);
                [min.x, min.y, min.z, max.x, max.y, max.z]
            }),
            reference: self.reference,
            provenance: wire::names(&self.provenance),
            public_key: ByteBuf::from(self.public_key.clone()),
            signature: ByteBuf::from(self.signature.clone()),
            holder: self.holder.to_string(),
            held: wire::ranges_to_wire(&self.held),
        }
    }

    fn from_wire(wire: ManifestWire) -> Result<Self, String> {
        let bounding_box = match wire.bounding_box {
            None => None,
            Some([a, b, c, d, e, f]) => {
                let area = BoundingBox::new(Vector3::new(a, b, c), Vector3::new(d, e, f));
                Some(area.ok_or("a bounding box inside out or not finite")?)
            }
        };
        let chunks = wire::ranges_from_wire(&wire.chunks)?;
        if chunks.count() > wire.chunk_count {
            let (stated, listed) = (wire.chunk_count, chunks.count());
            return Err(format!("{stated} chunks stated, {listed} listed"));
        }
        Ok(Self {
            map: wire::map_from_wire(&wire.anchor, &wire.epoch)?,
            revision: wire.revision,
            datum: wire::datum_from_wire(&wire.datum)?,
            chunks,
            bounding_box,
            reference: wire.reference,
            provenance: wire::vehicles_from_wire(&wire.provenance)?,
            public_key: wire.public_key.into_vec(),
            signature: wire.signature.into_vec(),
            holder: VehicleId::new(&wire.holder).map_err(|error| error.to_string())?,
            held: wire::ranges_from_wire(&wire.held)?,
        })
    }
}

//! Where a map stands on the Earth, and where its chunks stand in it. Revised as knowledge grows.

use geodesy::Datum;
use geometry::{Chunk as ChunkFrame, Enu, Map, Matrix7, Similarity, Timestamp};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use crate::arrays::{self, Float32Array, Float64Array, Uint8Array};
use crate::codec::{Message, VERSION};
use crate::wire::{self, DatumWire, PROVENANCE_COUNT_MAX, Reference, SimilarityWire};
use crate::{CHUNKS_PER_PAGE, ChunkNumber, MapId, VehicleId};

/// Where a whole map stands. A higher revision supersedes.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// Which map.
    pub map: MapId,
    /// Counts the placements and pages of this epoch, from one.
    pub revision: u32,
    /// When the newest evidence was captured, on the anchor's clock.
    pub captured_at: Timestamp,
    /// What ENU is relative to; the same throughout an epoch.
    pub datum: Datum,
    /// The similarity that puts the map on the Earth.
    pub enu_from_map: Similarity<Enu, Map>,
    /// Its covariance over `[ω; ν; ln s]`, right perturbation.
    pub covariance: Matrix7,
    /// The stated standard deviation of one position fix (m), horizontally.
    pub fix_sigma_m: f64,
    /// How the map came to its global position.
    pub reference: Reference,
    /// Whose evidence a registered map rests on.
    pub provenance: Vec<VehicleId>,
    /// The anchor's signature; empty where keys are not configured.
    pub signature: Vec<u8>,
}

/// Where one chunk stands in its map.
#[derive(Clone, Debug, PartialEq)]
pub struct ChunkPlacement {
    /// Which chunk.
    pub number: ChunkNumber,
    /// Scale one at the cut; later it carries corrections of drift.
    pub map_from_chunk: Similarity<Map, ChunkFrame>,
}

/// Where up to 256 chunks stand. A higher revision supersedes the whole page.
///
/// Translations are single precision relative to `origin`, so they are exact to 10⁻⁷ of the
/// page's extent; [`PlacementPage::new`] rounds at once, so that sender and receiver agree.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacementPage {
    map: MapId,
    page: u32,
    revision: u32,
    origin: Vector3<f64>,
    entries: Vec<(u8, [f32; 8])>,
    signature: Vec<u8>,
}

impl PlacementPage {
    /// The page with these placements, of which those that belong to other pages are left out.
    pub fn new(map: MapId, page: u32, revision: u32, placements: &[ChunkPlacement]) -> Self {
        let mut own: Vec<_> = placements
            .iter()
            .filter(|p| p.number.page() == page)
            .collect();
        own.sort_by_key(|placement| placement.number);
        own.dedup_by_key(|placement| placement.number);
        let first = own
            .first()
            .map(|placement| *placement.map_from_chunk.translation());
        let origin = first.unwrap_or_default();
        let entries = own.iter().map(|placement| {
            let offset = placement.number.0 % CHUNKS_PER_PAGE;
            let similarity = &placement.map_from_chunk;
            let moved = Similarity::<Map, ChunkFrame>::new(
                similarity.scale(),
                *similarity.rotation(),
                similarity.translation() - origin,
            );
            (
                offset as u8,
                wire::similarity_to_wire(&moved).map(|value| value as f32),
            )
        });
        Self {
            entries: entries.collect(),
            map,
            page,
            revision,
            origin,
            signature: Vec::new(),
        }
    }

    /// Which map.
    pub fn map(&self) -> &MapId {
        &self.map
    }

    /// Which page of it.
    pub fn page(&self) -> u32 {
        self.page
    }

    /// Counts the placements and pages of this epoch, from one.
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// Where the page's chunks stand, in ascending order of their numbers.
    pub fn placements(&self) -> impl ExactSizeIterator<Item = ChunkPlacement> + '_ {
        self.entries.iter().map(|(offset, values)| ChunkPlacement {
            number: ChunkNumber(self.page * CHUNKS_PER_PAGE + u32::from(*offset)),
            map_from_chunk: self
                .placement(values)
                .expect("every entry was checked at the door"),
        })
    }

    fn placement(&self, values: &[f32; 8]) -> Result<Similarity<Map, ChunkFrame>, String> {
        let relative: Similarity<Map, ChunkFrame> =
            wire::similarity_from_wire(values.map(f64::from))?;
        let translation = relative.translation() + self.origin;
        Ok(Similarity::new(
            relative.scale(),
            *relative.rotation(),
            translation,
        ))
    }
}

/// The placement's fields in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct PlacementWire {
    version: [u16; 2],
    anchor: String,
    epoch: String,
    revision: u32,
    captured_at: i64,
    datum: DatumWire,
    enu_from_map: SimilarityWire,
    covariance: Float64Array,
    fix_sigma_m: f64,
    #[serde(default, skip_serializing_if = "Reference::is_fixed")]
    reference: Reference,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(deserialize_with = "wire::list::<_, _, PROVENANCE_COUNT_MAX>")]
    provenance: Vec<String>,
    signature: ByteBuf,
}

impl Message for Placement {
    const KIND: &'static str = "placement";
    const SIZE_BYTES_MAX: usize = 4096;
    type Wire = PlacementWire;

    fn to_wire(&self) -> PlacementWire {
        PlacementWire {
            version: VERSION,
            anchor: self.map.anchor.to_string(),
            epoch: self.map.epoch.to_string(),
            revision: self.revision,
            captured_at: self.captured_at.nanoseconds(),
            datum: wire::datum_to_wire(&self.datum),
            enu_from_map: wire::similarity_to_wire(&self.enu_from_map),
            covariance: wire::covariance_to_wire(&self.covariance),
            fix_sigma_m: self.fix_sigma_m,
            reference: self.reference,
            provenance: wire::names(&self.provenance),
            signature: ByteBuf::from(self.signature.clone()),
        }
    }

    fn from_wire(wire: PlacementWire) -> Result<Self, String> {
        if !(wire.fix_sigma_m >= 0.0 && wire.fix_sigma_m <= 1e9) {
            return Err(format!("a fix sigma of {} m", wire.fix_sigma_m));
        }
        Ok(Self {
            map: wire::map_from_wire(&wire.anchor, &wire.epoch)?,
            revision: wire.revision,
            captured_at: Timestamp::from_nanoseconds(wire.captured_at),
            datum: wire::datum_from_wire(&wire.datum)?,
            enu_from_map: wire::similarity_from_wire(wire.enu_from_map)?,
            covariance: wire::covariance7_from_wire(&wire.covariance)?,
            fix_sigma_m: wire.fix_sigma_m,
            reference: wire.reference,
            provenance: wire::vehicles_from_wire(&wire.provenance)?,
            signature: wire.signature.into_vec(),
        })
    }
}

/// The page's fields in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct PlacementPageWire {
    version: [u16; 2],
    anchor: String,
    epoch: String,
    page: u32,
    revision: u32,
    origin: [f64; 3],
    offsets: Uint8Array,
    placements: Float32Array,
    signature: ByteBuf,
}

impl Message for PlacementPage {
    const KIND: &'static str = "placement page";
    const SIZE_BYTES_MAX: usize = 16 * 1024;
    type Wire = PlacementPageWire;

    fn to_wire(&self) -> PlacementPageWire {
        PlacementPageWire {
            version: VERSION,
            anchor: self.map.anchor.to_string(),
            epoch: self.map.epoch.to_string(),
            page: self.page,
            revision: self.revision,
            origin: self.origin.into(),
            offsets: arrays::bytes(self.entries.iter().map(|entry| entry.0).collect()),
            placements: arrays::from_f32(self.entries.iter().flat_map(|entry| entry.1)),
            signature: ByteBuf::from(self.signature.clone()),
        }
    }

    fn from_wire(wire: PlacementPageWire) -> Result<Self, String> {
        let values = arrays::to_f32(&wire.placements)?;
        let (placements, rest) = values.as_chunks::<8>();
        if !rest.is_empty() || placements.len() != wire.offsets.0.len() {
            let count = wire.offsets.0.len();
            return Err(format!("{} numbers for {count} chunks", values.len()));
        }
        if wire.offsets.0.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err("chunks out of order".to_owned());
        }
        if wire.page > u32::MAX / CHUNKS_PER_PAGE {
            return Err(format!("page {} is beyond the last chunk", wire.page));
        }
        let page = Self {
            map: wire::map_from_wire(&wire.anchor, &wire.epoch)?,
            page: wire.page,
            revision: wire.revision,
            origin: wire::point_from_wire(wire.origin)?,
            entries: wire
                .offsets
                .0
                .iter()
                .copied()
                .zip(placements.iter().copied())
                .collect(),
            signature: wire.signature.into_vec(),
        };
        for (_, values) in &page.entries {
            page.placement(values)?;
        }
        Ok(page)
    }
}

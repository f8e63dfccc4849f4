//! What this vehicle holds of every map that it has heard of, its own included.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};

use protocol::sync::SyncEvent;
use protocol::{Chunk, ChunkId, ChunkNumber, Manifest, MapId, Placement, PlacementPage};

/// More maps are not taken in; whoever is heard first stays.
const MAP_COUNT_MAX: usize = 256;

/// What is held of one map.
#[derive(Debug, Default)]
pub struct HeldMap {
    pub manifest: Option<Manifest>,
    pub placement: Option<Placement>,
    pub pages: BTreeMap<u32, PlacementPage>,
    /// A digest of each chunk's bytes: two bodies under one key are equivocation.
    digests: BTreeMap<ChunkNumber, u64>,
}

/// What became of something that arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    New,
    /// Held already, bit for bit, or a newer revision is.
    Known,
    /// A different body under a key that is held: the first stays.
    Equivocation,
    /// The shelf is full of other maps.
    Full,
}

/// All that is held, by map.
#[derive(Debug, Default)]
pub struct Shelf {
    maps: BTreeMap<MapId, HeldMap>,
}

impl Shelf {
    pub fn map(&self, id: &MapId) -> Option<&HeldMap> {
        self.maps.get(id)
    }

    pub fn take_chunk(&mut self, chunk: &Chunk, bytes: &[u8]) -> Taken {
        let ChunkId { map, number } = chunk.id();
        let Some(held) = self.entry(map) else {
            return Taken::Full;
        };
        let digest = digest(bytes);
        if let Some(known) = held.digests.get(number) {
            return if *known == digest {
                Taken::Known
            } else {
                Taken::Equivocation
            };
        }
        held.digests.insert(*number, digest);
        Taken::New
    }

    /// Whether the chunk is held with these bytes.
    pub fn holds_chunk(&self, id: &ChunkId, bytes: &[u8]) -> bool {
        let held = self.maps.get(&id.map);
        held.and_then(|held| held.digests.get(&id.number)) == Some(&digest(bytes))
    }

    pub fn take_manifest(&mut self, manifest: Manifest) -> Taken {
        let Some(held) = self.entry(&manifest.map) else {
            return Taken::Full;
        };
        match &held.manifest {
            Some(known) if known.revision >= manifest.revision => Taken::Known,
            _ => {
                held.manifest = Some(manifest);
                Taken::New
            }
        }
    }

    pub fn take_placement(&mut self, placement: Placement) -> Taken {
        let Some(held) = self.entry(&placement.map) else {
            return Taken::Full;
        };
        match &held.placement {
            Some(known) if known.revision == placement.revision && *known != placement => {
                Taken::Equivocation
            }
            Some(known) if known.revision >= placement.revision => Taken::Known,
            _ => {
                held.placement = Some(placement);
                Taken::New
            }
        }
    }

    pub fn take_page(&mut self, page: PlacementPage) -> Taken {
        let Some(held) = self.entry(page.map()) else {
            return Taken::Full;
        };
        match held.pages.get(&page.page()) {
            Some(known) if known.revision() == page.revision() && *known != page => {
                Taken::Equivocation
            }
            Some(known) if known.revision() >= page.revision() => Taken::Known,
            _ => {
                held.pages.insert(page.page(), page);
                Taken::New
            }
        }
    }

    fn entry(&mut self, map: &MapId) -> Option<&mut HeldMap> {
        if self.maps.len() >= MAP_COUNT_MAX && !self.maps.contains_key(map) {
            return None;
        }
        Some(self.maps.entry(map.clone()).or_default())
    }
}

impl HeldMap {
    /// What the reconciliation is to know of the placements that are held.
    pub fn placement_held(&self, map: MapId) -> SyncEvent {
        let (revision, digest) = self.placement_summary();
        SyncEvent::PlacementHeld {
            map,
            revision,
            digest,
        }
    }

    /// The highest revision of a placement or page, and a digest of all of them.
    fn placement_summary(&self) -> (u32, u64) {
        let placement = self.placement.as_ref().map(|placement| placement.revision);
        let pages = self
            .pages
            .values()
            .map(|page| (page.page(), page.revision()));
        let revisions = placement
            .map(|revision| (u32::MAX, revision))
            .into_iter()
            .chain(pages);
        let mut hasher = Fnv::default();
        let mut highest = 0;
        for (page, revision) in revisions {
            hasher.write(page);
            hasher.write(revision);
            highest = highest.max(revision);
        }
        (highest, if highest == 0 { 0 } else { hasher.0 })
    }
}

/// FNV-1a: beacons of different builds must agree, which the standard hasher does not promise.
struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    fn write(&mut self, value: u32) {
        for byte in value.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

fn digest(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}

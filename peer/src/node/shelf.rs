//! What this vehicle holds of every map that it has heard of, its own included.

use std::collections::{BTreeMap, VecDeque};
use std::hash::{DefaultHasher, Hasher};

use protocol::{
    Chunk, ChunkId, ChunkNumber, HaveEntry, Manifest, MapId, Placement, PlacementPage, Ranges,
};

/// More maps are not taken in; whoever is heard first stays.
const MAP_COUNT_MAX: usize = 256;

/// What is held of one map.
#[derive(Debug, Default)]
pub struct HeldMap {
    pub manifest: Option<Manifest>,
    pub placement: Option<Placement>,
    pub pages: BTreeMap<u32, PlacementPage>,
    pub chunks: Ranges,
    /// A digest of each chunk's bytes: two bodies under one key are equivocation.
    digests: BTreeMap<ChunkNumber, u64>,
    /// Digests of `chunks` as they were: who has one of these lacks nothing that is missing here.
    past_digests: VecDeque<u64>,
}

const PAST_DIGEST_COUNT_MAX: usize = 256;

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
    pub fn maps(&self) -> impl Iterator<Item = (&MapId, &HeldMap)> {
        self.maps.iter()
    }

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
        held.chunks.insert(*number);
        held.remember_digest();
        Taken::New
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

    /// What a beacon says of each map.
    pub fn entries(&self) -> Vec<HaveEntry> {
        self.maps
            .iter()
            .map(|(map, held)| held.entry(map.clone()))
            .collect()
    }

    fn entry(&mut self, map: &MapId) -> Option<&mut HeldMap> {
        if self.maps.len() >= MAP_COUNT_MAX && !self.maps.contains_key(map) {
            return None;
        }
        Some(self.maps.entry(map.clone()).or_default())
    }
}

impl HeldMap {
    pub fn entry(&self, map: MapId) -> HaveEntry {
        let (revision, digest) = self.placement_summary();
        HaveEntry::new(map, &self.chunks, revision, digest)
    }

    /// Whether exactly the chunks with this digest were held here at some time.
    pub fn has_had(&self, digest: u64) -> bool {
        self.past_digests.contains(&digest)
    }

    fn remember_digest(&mut self) {
        if self.past_digests.len() == PAST_DIGEST_COUNT_MAX {
            self.past_digests.pop_front();
        }
        self.past_digests.push_back(self.chunks.digest());
    }

    /// The highest revision of a placement or page, and a digest of all of them.
    fn placement_summary(&self) -> (u32, u64) {
        let placement = self.placement.as_ref().map(|placement| placement.revision);
        let pages = self.pages.values().map(|page| (page.page(), page.revision()));
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

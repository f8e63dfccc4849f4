//! What the vehicle answers with: every chunk, placement and manifest that it holds.

mod segments;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::Vector3;
use protocol::keys::{Key, MapParameters};
use protocol::{
    Chunk, ChunkId, ChunkNumber, Manifest, MapId, Placement, PlacementPage, Ranges, VehicleId,
    decode, encode,
};

use crate::link::{Answer, Holdings, Question};
use segments::Segments;

pub use segments::{Reloaded, StoreError};

/// What the store keeps and answers with.
#[derive(Clone, Debug)]
pub enum Kept {
    Chunk(ChunkId, Arc<[u8]>),
    Manifest(Manifest),
    Placement(Box<Placement>),
    Page(PlacementPage),
    Beacon(Arc<[u8]>),
}

/// The vehicle's holdings, shared between its own loop, which adds, and the link, which answers.
#[derive(Clone)]
pub struct Store {
    id: VehicleId,
    shared: Arc<Mutex<Held>>,
}

#[derive(Default)]
struct Held {
    maps: BTreeMap<MapId, HeldMap>,
    beacon: Option<Arc<[u8]>>,
    segments: Option<Segments>,
}

#[derive(Default)]
struct HeldMap {
    manifest: Option<Manifest>,
    placement: Option<Placement>,
    pages: BTreeMap<u32, PlacementPage>,
    chunks: BTreeMap<ChunkNumber, Arc<[u8]>>,
}

impl Store {
    /// A store in memory only.
    pub fn new(id: VehicleId) -> Self {
        Self {
            id,
            shared: Arc::default(),
        }
    }

    /// A store that outlives the process, and what it holds from before, to be told to the node.
    pub fn open(id: VehicleId, folder: &Path) -> Result<(Self, Vec<Reloaded>), StoreError> {
        let (segments, reloaded) = Segments::open(folder)?;
        let store = Self::new(id);
        store.lock().segments = Some(segments);
        Ok((store, reloaded))
    }

    /// Keeps what came in; on disk too, if the store has a folder, before this returns. After an
    /// error it is kept in memory only.
    pub fn keep(&self, kept: Kept) -> Result<(), StoreError> {
        let written = match &mut self.lock().segments {
            Some(segments) => segments.append(&kept),
            None => Ok(()),
        };
        self.hold(kept);
        written
    }

    /// Ends the open file of a store that has a folder.
    pub fn close(&self) -> Result<(), StoreError> {
        match &mut self.lock().segments {
            Some(segments) => segments.close(),
            None => Ok(()),
        }
    }

    /// Keeps in memory what is on disk already.
    pub fn hold(&self, kept: Kept) {
        let mut held = self.lock();
        match kept {
            Kept::Chunk(id, payload) => {
                let map = held.maps.entry(id.map).or_default();
                map.chunks.entry(id.number).or_insert(payload);
            }
            Kept::Manifest(manifest) => {
                let map = held.maps.entry(manifest.map.clone()).or_default();
                map.manifest = Some(manifest);
            }
            Kept::Placement(placement) => {
                let map = held.maps.entry(placement.map.clone()).or_default();
                map.placement = Some(*placement);
            }
            Kept::Page(page) => {
                let map = held.maps.entry(page.map().clone()).or_default();
                map.pages.insert(page.page(), page);
            }
            Kept::Beacon(payload) => held.beacon = Some(payload),
        }
    }

    pub fn chunk_count(&self) -> usize {
        self.lock().maps.values().map(|map| map.chunks.len()).sum()
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        // A holder of this lock only moves finished values, so even a panic leaves it whole.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Holdings for Store {
    fn answer(&self, question: &Question) -> Result<Vec<Answer>, String> {
        let parameters = MapParameters::parse(question.parameters());
        let parameters = parameters.map_err(|error| error.to_string())?;
        let held = self.lock();
        let mut answers = Vec::new();
        let mut answer = |key: Key, payload: &dyn Fn() -> Arc<[u8]>| {
            let key = key.to_string();
            if question.asks_for(&key) {
                answers.push(Answer {
                    key,
                    payload: payload(),
                });
            }
        };
        if let Some(beacon) = &held.beacon {
            answer(Key::Have(self.id.clone()), &|| Arc::clone(beacon));
        }
        for (map, of_map) in &held.maps {
            of_map.answer(map, &self.id, &parameters, &mut answer);
        }
        Ok(answers)
    }
}

/// Takes a key and how to make its payload, which is made only if the key is wanted.
type Offer<'a> = dyn FnMut(Key, &dyn Fn() -> Arc<[u8]>) + 'a;

impl HeldMap {
    fn answer(
        &self,
        map: &MapId,
        holder: &VehicleId,
        parameters: &MapParameters,
        answer: &mut Offer<'_>,
    ) {
        if let Some(manifest) = &self.manifest {
            answer(Key::Manifest(map.anchor.clone()), &|| {
                Arc::from(encode(&self.stamped(manifest, holder)))
            });
        }
        if let Some(placement) = &self.placement {
            answer(Key::Placement(map.clone()), &|| {
                Arc::from(encode(placement))
            });
        }
        for (page, body) in &self.pages {
            answer(Key::PlacementPage(map.clone(), *page), &|| {
                Arc::from(encode(body))
            });
        }
        for (number, payload) in &self.chunks {
            let wanted = parameters.admits_number(map.epoch, *number)
                && self.stands_in(*number, payload, parameters);
            if wanted {
                let id = ChunkId {
                    map: map.clone(),
                    number: *number,
                };
                answer(Key::HeldChunk(holder.clone(), id.clone()), &|| {
                    Arc::clone(payload)
                });
                answer(Key::Chunk(id), &|| Arc::clone(payload));
            }
        }
    }

    /// The anchor's manifest with what this vehicle holds of it.
    fn stamped(&self, manifest: &Manifest, holder: &VehicleId) -> Manifest {
        let mut held = Ranges::new();
        for number in self.chunks.keys() {
            held.insert(*number);
        }
        Manifest {
            holder: holder.clone(),
            held,
            ..manifest.clone()
        }
    }

    /// Whether a chunk overlaps the box that was asked for; one that is not placed is in no box.
    fn stands_in(&self, number: ChunkNumber, payload: &[u8], parameters: &MapParameters) -> bool {
        if parameters.area.is_none() {
            return true;
        }
        let (Some(placement), Some(page)) = (&self.placement, self.pages.get(&number.page()))
        else {
            return false;
        };
        let placed = page.placements().find(|placed| placed.number == number);
        let (Some(placed), Ok(chunk)) = (placed, decode::<Chunk>(payload)) else {
            return false;
        };
        let enu_from_chunk = placement.enu_from_map * placed.map_from_chunk;
        let points = chunk.points();
        let points: Vec<Vector3<f64>> = points
            .map(|point| enu_from_chunk * point.position_in_chunk)
            .collect();
        protocol::BoundingBox::around(points.into_iter()).is_some_and(|area| {
            let (min, max) = (area.min_m(), area.max_m());
            parameters.admits_area((min.x, min.y), (max.x, max.y))
        })
    }
}

#[cfg(test)]
mod tests;

//! Have and want: finding out what neighbours hold that is missing here, and pulling it.
//!
//! Publishing is the fast path; this is the sure one. A beacon that differs from what is held
//! here for a second means that something was missed. Then the manifests say who holds what, and
//! each missing chunk is pulled from one holder, newest first, a few at a time.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use geometry::Timestamp;
use protocol::keys::Key;
use protocol::{ChunkId, ChunkNumber, Have, HaveEntry, Manifest, MapId, Ranges, VehicleId};

use super::shelf::Shelf;
use crate::link::RequestId;

/// What was published may still be on its way, behind the beacon that mentions it.
const GRACE: Duration = Duration::from_secs(1);
/// A question about one map is not repeated sooner.
const ASK_PERIOD: Duration = Duration::from_secs(1);
/// A neighbour that has said nothing for so long is not asked.
const SILENCE_MAX: Duration = Duration::from_secs(10);
/// Chunks asked of one holder at a time.
const WINDOW: usize = 8;
/// Neighbours whose beacons are remembered; the longest silent one is forgotten beyond.
const NEIGHBOUR_COUNT_MAX: usize = 64;

/// What others hold, and what has been asked of whom.
#[derive(Debug)]
pub struct Reconciler {
    id: VehicleId,
    next_request: u64,
    neighbours: BTreeMap<VehicleId, Neighbour>,
    open: BTreeMap<RequestId, Purpose>,
    asked_at: BTreeMap<(MapId, Subject), Timestamp>,
    wanted: BTreeMap<MapId, BTreeMap<VehicleId, Ranges>>,
}

#[derive(Debug)]
struct Neighbour {
    heard_at: Timestamp,
    maps: BTreeMap<MapId, Heard>,
}

#[derive(Debug)]
struct Heard {
    entry: HaveEntry,
    differs_since: Option<Timestamp>,
    /// The digest of theirs of which the manifest showed that nothing is missing here.
    settled_digest: Option<u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Subject {
    Manifests,
    Placements,
}

#[derive(Debug, PartialEq, Eq)]
enum Purpose {
    About(MapId, Subject),
    Chunk { holder: VehicleId, chunk: ChunkId },
}

impl Reconciler {
    pub fn new(id: VehicleId) -> Self {
        Self {
            id,
            next_request: 1,
            neighbours: BTreeMap::new(),
            open: BTreeMap::new(),
            asked_at: BTreeMap::new(),
            wanted: BTreeMap::new(),
        }
    }

    pub fn open_request_count(&self) -> usize {
        self.open.len()
    }

    /// A neighbour said what it holds.
    pub fn hear(&mut self, have: Have, now: Timestamp) {
        if have.vehicle == self.id {
            return;
        }
        self.make_room(&have.vehicle);
        let neighbour = self
            .neighbours
            .entry(have.vehicle)
            .or_insert_with(|| Neighbour {
                heard_at: now,
                maps: BTreeMap::new(),
            });
        neighbour.heard_at = now;
        for entry in have.entries {
            // The own map is complete here by definition.
            if entry.map.anchor == self.id {
                continue;
            }
            match neighbour.maps.get_mut(&entry.map) {
                Some(heard) => heard.entry = entry,
                None => {
                    let heard = Heard {
                        entry: entry.clone(),
                        differs_since: None,
                        settled_digest: None,
                    };
                    neighbour.maps.insert(entry.map, heard);
                }
            }
        }
    }

    /// A holder said exactly what it holds of one map.
    pub fn learn(&mut self, manifest: &Manifest, shelf: &Shelf) {
        if manifest.holder == self.id || manifest.map.anchor == self.id {
            return;
        }
        let nothing = Ranges::new();
        let own = shelf.map(&manifest.map).map_or(&nothing, |held| &held.chunks);
        let missing = manifest.held.without(own);
        if missing.is_empty() {
            let neighbour = self.neighbours.get_mut(&manifest.holder);
            if let Some(heard) = neighbour.and_then(|one| one.maps.get_mut(&manifest.map)) {
                heard.settled_digest = Some(manifest.held.digest());
            }
            return;
        }
        let holders = self.wanted.entry(manifest.map.clone()).or_default();
        holders.insert(manifest.holder.clone(), missing);
    }

    /// Whether a chunk that arrived had been asked for.
    pub fn is_pull(&self, request: RequestId) -> bool {
        matches!(self.open.get(&request), Some(Purpose::Chunk { .. }))
    }

    /// No more replies come. A chunk that did not come is not asked of that holder again until
    /// a beacon says that it is still there.
    pub fn request_ended(&mut self, request: RequestId, now: Timestamp) {
        match self.open.remove(&request) {
            Some(Purpose::About(map, subject)) => {
                self.asked_at.insert((map, subject), now);
            }
            Some(Purpose::Chunk { holder, chunk }) => {
                if let Some(holders) = self.wanted.get_mut(&chunk.map) {
                    if let Some(numbers) = holders.get_mut(&holder) {
                        numbers.remove(chunk.number);
                    }
                    holders.retain(|_, numbers| !numbers.is_empty());
                }
                self.wanted.retain(|_, holders| !holders.is_empty());
            }
            None => {}
        }
    }

    /// The questions that are due.
    pub fn ask(&mut self, shelf: &Shelf, now: Timestamp) -> Vec<(RequestId, String)> {
        let mut questions = Vec::new();
        for (map, subject) in self.differences(shelf, now) {
            let selector = match subject {
                Subject::Manifests => Key::Manifest(map.anchor.clone()).to_string(),
                Subject::Placements => format!("{}/**", Key::Placement(map.clone())),
            };
            self.asked_at.insert((map.clone(), subject), now);
            questions.push((self.open(Purpose::About(map, subject)), selector));
        }
        for (holder, chunk) in self.pulls(shelf) {
            let selector = Key::HeldChunk(holder.clone(), chunk.clone()).to_string();
            questions.push((self.open(Purpose::Chunk { holder, chunk }), selector));
        }
        questions
    }

    fn open(&mut self, purpose: Purpose) -> RequestId {
        let request = RequestId(self.next_request);
        self.next_request += 1;
        self.open.insert(request, purpose);
        request
    }

    /// What to ask about: maps of which a neighbour has held something else for a while.
    fn differences(&mut self, shelf: &Shelf, now: Timestamp) -> Vec<(MapId, Subject)> {
        let mut due = Vec::new();
        for neighbour in self.neighbours.values_mut() {
            if now.since(neighbour.heard_at) > SILENCE_MAX {
                continue;
            }
            for (map, heard) in &mut neighbour.maps {
                let subjects = heard.differences(map, shelf);
                if subjects.is_empty() {
                    heard.differs_since = None;
                    continue;
                }
                let since = *heard.differs_since.get_or_insert(now);
                let unknown = shelf.map(map).is_none();
                if unknown || now.since(since) >= GRACE {
                    due.extend(subjects.into_iter().map(|subject| (map.clone(), subject)));
                }
            }
        }
        due.sort();
        due.dedup();
        due.retain(|about| {
            let waited = self.asked_at.get(about).map(|at| now.since(*at));
            let open = Purpose::About(about.0.clone(), about.1);
            waited.is_none_or(|waited| waited >= ASK_PERIOD)
                && !self.open.values().any(|purpose| *purpose == open)
        });
        due
    }

    /// The chunks to pull next: newest first, each from one holder, a window for each holder.
    fn pulls(&mut self, shelf: &Shelf) -> Vec<(VehicleId, ChunkId)> {
        let mut in_flight: BTreeMap<VehicleId, usize> = BTreeMap::new();
        let mut asked: VecDeque<ChunkId> = VecDeque::new();
        for purpose in self.open.values() {
            if let Purpose::Chunk { holder, chunk } = purpose {
                *in_flight.entry(holder.clone()).or_default() += 1;
                asked.push_back(chunk.clone());
            }
        }
        let mut pulls = Vec::new();
        for (map, holders) in &self.wanted {
            let held = shelf.map(map).map(|held| &held.chunks);
            for (holder, numbers) in holders {
                let used = in_flight.entry(holder.clone()).or_default();
                for number in numbers.newest_first() {
                    if *used >= WINDOW {
                        break;
                    }
                    let chunk = chunk_id(map, number);
                    let known = held.is_some_and(|held| held.contains(number));
                    if !known && !asked.contains(&chunk) {
                        *used += 1;
                        asked.push_back(chunk.clone());
                        pulls.push((holder.clone(), chunk));
                    }
                }
            }
        }
        pulls
    }

    fn make_room(&mut self, newcomer: &VehicleId) {
        if self.neighbours.len() < NEIGHBOUR_COUNT_MAX || self.neighbours.contains_key(newcomer) {
            return;
        }
        let silent = self.neighbours.iter().min_by_key(|(_, one)| one.heard_at);
        if let Some(silent) = silent.map(|(id, _)| id.clone()) {
            self.neighbours.remove(&silent);
        }
    }
}

impl Heard {
    fn differences(&self, map: &MapId, shelf: &Shelf) -> Vec<Subject> {
        let theirs = &self.entry;
        let own = shelf.map(map);
        let mut subjects = Vec::new();
        let had_the_same = own.is_some_and(|held| held.has_had(theirs.digest));
        let settled = self.settled_digest == Some(theirs.digest);
        if theirs.count > 0 && !had_the_same && !settled {
            subjects.push(Subject::Manifests);
        }
        let own = own.map(|held| held.entry(map.clone()));
        let (revision, digest) =
            own.map_or((0, 0), |own| (own.placement_revision, own.placement_digest));
        let newer = theirs.placement_revision >= revision && theirs.placement_digest != digest;
        if theirs.placement_revision > 0 && newer {
            subjects.push(Subject::Placements);
        }
        subjects
    }
}

fn chunk_id(map: &MapId, number: ChunkNumber) -> ChunkId {
    ChunkId {
        map: map.clone(),
        number,
    }
}

#[cfg(test)]
mod tests;

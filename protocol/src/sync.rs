//! Have and want: who lacks what, and from whom to pull it.
//!
//! Publishing is the fast path and may lose anything; this is the sure path. Everybody's beacon
//! says what it holds; whoever lacks something pulls it from one chosen holder, a few chunks at a
//! time, newest first. A pure state machine: the caller executes the effects, and memory is
//! bounded whatever neighbours say.

mod beacon;
mod claims;
mod pulls;

use std::collections::BTreeMap;

use geometry::Timestamp;

use crate::{ChunkId, Have, MapId, Ranges, VehicleId};
use beacon::BeaconClock;
use claims::{Claim, Neighbour};
use pulls::Pull;

/// How eagerly a vehicle reconciles.
#[derive(Clone, Debug)]
pub struct SyncSettings {
    /// Between beacons while nothing changes (s).
    pub beacon_interval_s: f64,
    /// Between beacons while things change (s).
    pub beacon_change_interval_s: f64,
    /// Both grow by this share for each neighbour heard, so that a crowd does not fill the air.
    pub beacon_share_per_neighbour: f64,
    /// Chunks asked of one holder at a time: more fill a fast link, fewer spare a slow one.
    pub window_per_holder: usize,
    /// An unanswered pull is given to another holder after this long (s).
    pub pull_timeout_s: f64,
    /// New chunks are left to the fast path for this long before they are pulled (s).
    pub grace_s: f64,
    /// A neighbour that was not heard for longer is forgotten (s).
    pub neighbour_timeout_s: f64,
    /// Questions about ranges or placements are repeated no faster (s).
    pub question_interval_s: f64,
    /// Neighbours beyond this many, the longest unheard first, are forgotten.
    pub neighbour_count_max: usize,
    /// Maps that one neighbour may claim; further ones are ignored.
    pub map_count_max: usize,
    /// Runs of numbers remembered per claim; the oldest are forgotten.
    pub run_count_max: usize,
    /// Higher chunk numbers are not believed.
    pub chunk_number_max: u32,
}

impl Default for SyncSettings {
    fn default() -> Self {
        Self {
            beacon_interval_s: 2.0,
            beacon_change_interval_s: 1.0,
            beacon_share_per_neighbour: 0.05,
            window_per_holder: 8,
            pull_timeout_s: 5.0,
            grace_s: 1.5,
            neighbour_timeout_s: 30.0,
            question_interval_s: 1.0,
            neighbour_count_max: 64,
            map_count_max: 128,
            run_count_max: 1024,
            chunk_number_max: 65_535,
        }
    }
}

/// What happens to the reconciliation.
#[derive(Clone, Debug)]
pub enum SyncEvent {
    /// The own store was opened and holds this.
    Opened {
        /// Which map.
        map: MapId,
        /// Its chunks in the store.
        held: Ranges,
    },
    /// A chunk is safely in the own store: only then may the beacon say so.
    Stored(ChunkId),
    /// A chunk was dropped to make room and is not wanted again.
    Evicted(ChunkId),
    /// The newest placement and pages that are held of a map.
    PlacementHeld {
        /// Which map.
        map: MapId,
        /// The highest revision.
        revision: u32,
        /// The digest over all revisions.
        digest: u64,
    },
    /// A neighbour's beacon came.
    BeaconHeard(Have),
    /// A neighbour's answer to [`SyncEffect::AskRanges`].
    RangesHeard {
        /// Who answered.
        holder: VehicleId,
        /// Which map.
        map: MapId,
        /// What it holds.
        held: Ranges,
    },
    /// A pull ended without a chunk.
    PullFailed {
        /// Who was asked.
        holder: VehicleId,
        /// What for.
        chunk: ChunkId,
    },
    /// Some transport came up: say at once what is held.
    LinkUp,
    /// A neighbour's transport went down.
    LinkDown(VehicleId),
    /// Time passed; a few times a second.
    Tick,
}

/// What the reconciliation wants done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SyncEffect {
    /// Publish this beacon.
    SendBeacon(Have),
    /// Get `vehicle/{holder}/chunk/{chunk}`.
    Pull {
        /// Whom to ask.
        holder: VehicleId,
        /// What for.
        chunk: ChunkId,
    },
    /// Get the holder's manifest of the map, for its `held`.
    AskRanges {
        /// Whom to ask.
        holder: VehicleId,
        /// Which map.
        map: MapId,
    },
    /// Get placement and pages of the map; this neighbour has newer ones.
    AskPlacement {
        /// Who has them.
        holder: VehicleId,
        /// Which map.
        map: MapId,
    },
}

/// The reconciliation of one vehicle.
#[derive(Debug)]
pub struct Sync {
    vehicle: VehicleId,
    settings: SyncSettings,
    maps: BTreeMap<MapId, OwnMap>,
    neighbours: BTreeMap<VehicleId, Neighbour>,
    pulls: BTreeMap<ChunkId, Pull>,
    beacon: BeaconClock,
}

/// What is held of one map, and what is known to exist of it.
#[derive(Debug, Default)]
struct OwnMap {
    held: Ranges,
    unwanted: Ranges,
    placement_revision: u32,
    placement_digest: u64,
    placement_asked: Option<(Timestamp, u64)>,
    /// The highest number heard of, and from which on the fast path may still bring it until when.
    highest_heard: Option<u32>,
    fresh: Option<(u32, Timestamp)>,
}

impl Sync {
    /// A reconciliation that holds nothing and knows nobody.
    pub fn new(vehicle: VehicleId, settings: SyncSettings) -> Self {
        Self {
            beacon: BeaconClock::new(&vehicle),
            vehicle,
            settings,
            maps: BTreeMap::new(),
            neighbours: BTreeMap::new(),
            pulls: BTreeMap::new(),
        }
    }

    /// Takes an event; what it leads to, in order.
    pub fn handle(&mut self, event: SyncEvent, now: Timestamp) -> Vec<SyncEffect> {
        match event {
            SyncEvent::Opened { map, held } => self.own(map).held.unite(&held),
            SyncEvent::Stored(chunk) => self.store(&chunk),
            SyncEvent::Evicted(chunk) => {
                let own = self.own(chunk.map);
                own.held.remove(chunk.number);
                own.unwanted.insert(chunk.number);
                self.beacon.change();
            }
            SyncEvent::PlacementHeld {
                map,
                revision,
                digest,
            } => {
                let own = self.own(map);
                (own.placement_revision, own.placement_digest) = (revision, digest);
                self.beacon.change();
            }
            SyncEvent::BeaconHeard(have) => self.hear(have, now),
            SyncEvent::RangesHeard { holder, map, held } => self.hear_ranges(&holder, &map, held),
            SyncEvent::PullFailed { holder, chunk } => self.fail(&holder, &chunk, now),
            SyncEvent::LinkUp => {
                self.beacon.hurry();
                self.neighbours.values_mut().for_each(Neighbour::forgive);
            }
            SyncEvent::LinkDown(vehicle) => self.forget(&vehicle),
            SyncEvent::Tick => {}
        }
        self.expire(now);
        let mut effects = Vec::new();
        self.ask(now, &mut effects);
        self.pull(now, &mut effects);
        self.send_beacon(now, &mut effects);
        effects
    }

    /// The chunks that are held of a map.
    pub fn held(&self, map: &MapId) -> Option<&Ranges> {
        self.maps.get(map).map(|own| &own.held)
    }

    /// The maps of which something is held or known.
    pub fn maps(&self) -> impl Iterator<Item = &MapId> {
        self.maps.keys()
    }

    /// The neighbours whose beacons were heard lately.
    pub fn neighbours(&self) -> impl Iterator<Item = &VehicleId> {
        self.neighbours.keys()
    }

    /// How many chunks are known to exist and are neither held nor refused.
    pub fn missing_count(&self) -> u64 {
        let mut missing: BTreeMap<&MapId, Ranges> = BTreeMap::new();
        for (map, claim) in self.neighbours.values().flat_map(|one| &one.claims) {
            missing
                .entry(map)
                .or_default()
                .unite(&self.lacking(map, claim));
        }
        missing.values().map(Ranges::count).sum()
    }

    /// How many pulls are under way.
    pub fn pull_count(&self) -> usize {
        self.pulls.len()
    }

    fn own(&mut self, map: MapId) -> &mut OwnMap {
        self.maps.entry(map).or_default()
    }

    fn store(&mut self, chunk: &ChunkId) {
        if let Some(pull) = self.pulls.remove(chunk)
            && let Some(neighbour) = self.neighbours.get_mut(&pull.holder)
        {
            neighbour.forgive();
        }
        let own = self.own(chunk.map.clone());
        if own.held.insert(chunk.number) {
            self.beacon.change();
        }
    }

    /// What a claim has and this vehicle lacks.
    fn lacking(&self, map: &MapId, claim: &Claim) -> Ranges {
        match self.maps.get(map) {
            None => claim.held.clone(),
            Some(own) => claim.held.without(&own.held).without(&own.unwanted),
        }
    }
}

#[cfg(test)]
mod tests;

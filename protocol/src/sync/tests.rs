//! Simulated vehicles over links that fail: everybody ends with everything, hardly anything twice.

use std::collections::{BTreeMap, BTreeSet};

use geometry::Timestamp;
use proptest::prelude::*;

use super::*;
use crate::ranges::mix;
use crate::{ChunkNumber, Epoch, HaveEntry};

const STEP_S: f64 = 0.1;

fn id(idx: usize) -> VehicleId {
    VehicleId::new(&format!("v{idx}")).unwrap()
}

fn map_of(idx: usize) -> MapId {
    let epoch = Epoch {
        counter: 1,
        random: idx as u32,
    };
    MapId {
        anchor: id(idx),
        epoch,
    }
}

fn chunk(map: &MapId, number: u32) -> ChunkId {
    ChunkId {
        map: map.clone(),
        number: ChunkNumber(number),
    }
}

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_seconds(seconds).unwrap()
}

/// What is on its way; it arrives a step later if the link then stands and luck holds.
enum Parcel {
    Beacon(Have),
    Put(ChunkId),
    Question(ChunkId),
    Answer(ChunkId),
    RangesQuestion(MapId),
    Ranges(MapId, Ranges),
}

struct Vehicle {
    sync: Sync,
    store: BTreeSet<ChunkId>,
    doubled_count: usize,
}

struct Team {
    vehicles: Vec<Vehicle>,
    parcels: Vec<(usize, usize, Parcel)>,
    linked: BTreeSet<(usize, usize)>,
    loss_percent: u64,
    chance: u64,
    time_s: f64,
    pulled_count: usize,
}

impl Team {
    fn new(vehicle_count: usize, loss_percent: u64, seed: u64) -> Self {
        let vehicle = |idx| Vehicle {
            sync: Sync::new(id(idx), SyncSettings::default()),
            store: BTreeSet::new(),
            doubled_count: 0,
        };
        Self {
            vehicles: (0..vehicle_count).map(vehicle).collect(),
            parcels: Vec::new(),
            linked: BTreeSet::new(),
            loss_percent,
            chance: seed,
            time_s: 0.0,
            pulled_count: 0,
        }
    }

    fn chance(&mut self, below: u64) -> u64 {
        self.chance = mix(self.chance);
        self.chance % below
    }

    fn link(&mut self, a: usize, b: usize) {
        self.linked.extend([(a, b), (b, a)]);
        self.event(a, SyncEvent::LinkUp);
        self.event(b, SyncEvent::LinkUp);
    }

    fn unlink(&mut self, a: usize, b: usize) {
        self.linked.remove(&(a, b));
        self.linked.remove(&(b, a));
        // Half of the cuts are noticed, the others only lose what is sent.
        if self.chance(2) == 0 {
            self.event(a, SyncEvent::LinkDown(id(b)));
        }
    }

    fn event(&mut self, idx: usize, event: SyncEvent) {
        let effects = self.vehicles[idx].sync.handle(event, at(self.time_s));
        let index_of = |vehicle: &VehicleId| vehicle.as_str()[1..].parse::<usize>().unwrap();
        for effect in effects {
            match effect {
                SyncEffect::SendBeacon(have) => {
                    for other in 0..self.vehicles.len() {
                        self.parcels
                            .push((idx, other, Parcel::Beacon(have.clone())));
                    }
                }
                SyncEffect::Pull { holder, chunk } => {
                    self.pulled_count += 1;
                    self.parcels
                        .push((idx, index_of(&holder), Parcel::Question(chunk)));
                }
                SyncEffect::AskRanges { holder, map } => {
                    self.parcels
                        .push((idx, index_of(&holder), Parcel::RangesQuestion(map)));
                }
                SyncEffect::AskPlacement { .. } => {}
            }
        }
    }

    fn publish(&mut self, anchor: usize, number: u32) {
        let chunk = chunk(&map_of(anchor), number);
        self.receive(anchor, chunk.clone());
        for other in 0..self.vehicles.len() {
            self.parcels
                .push((anchor, other, Parcel::Put(chunk.clone())));
        }
    }

    fn receive(&mut self, idx: usize, chunk: ChunkId) {
        if !self.vehicles[idx].store.insert(chunk.clone()) {
            self.vehicles[idx].doubled_count += 1;
        }
        self.event(idx, SyncEvent::Stored(chunk));
    }

    fn step(&mut self) {
        self.time_s += STEP_S;
        for (from, to, parcel) in std::mem::take(&mut self.parcels) {
            let lost = self.chance(100) < self.loss_percent;
            if from == to || lost || !self.linked.contains(&(from, to)) {
                continue;
            }
            match parcel {
                Parcel::Beacon(have) => self.event(to, SyncEvent::BeaconHeard(have)),
                Parcel::Put(chunk) | Parcel::Answer(chunk) => self.receive(to, chunk),
                Parcel::Question(chunk) if self.vehicles[to].store.contains(&chunk) => {
                    self.parcels.push((to, from, Parcel::Answer(chunk)));
                }
                Parcel::Question(_) => {}
                Parcel::RangesQuestion(map) => {
                    let held = self.vehicles[to]
                        .sync
                        .held(&map)
                        .cloned()
                        .unwrap_or_default();
                    self.parcels.push((to, from, Parcel::Ranges(map, held)));
                }
                Parcel::Ranges(map, held) => {
                    let holder = id(from);
                    self.event(to, SyncEvent::RangesHeard { holder, map, held });
                }
            }
        }
        for idx in 0..self.vehicles.len() {
            self.event(idx, SyncEvent::Tick);
        }
    }

    fn complete(&self, chunk_count: usize) -> bool {
        self.vehicles
            .iter()
            .all(|vehicle| vehicle.store.len() == chunk_count)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Links come and go at random for a minute while two anchors publish; then a line of links
    /// holds, and everybody ends up with everything. Without loss, nothing is pulled twice but
    /// what a cut swallowed.
    #[test]
    fn all_have_all_after_any_outages(seed in any::<u64>(), loss_percent in 0..30_u64) {
        let vehicle_count = 6;
        let mut team = Team::new(vehicle_count, loss_percent, seed);
        let mut published = 0;
        for step in 0..600 {
            if step % 10 == 0 {
                let (a, b) = (team.chance(6) as usize, team.chance(6) as usize);
                if a != b && team.linked.contains(&(a, b)) {
                    team.unlink(a, b);
                } else if a != b {
                    team.link(a, b);
                }
            }
            if step % 7 == 0 {
                team.publish(0, published);
                team.publish(1, published);
                published += 1;
            }
            team.step();
        }
        for idx in 1..vehicle_count {
            team.link(idx - 1, idx);
        }
        let chunk_count = 2 * published as usize;
        let mut settled_s = 0.0;
        while !team.complete(chunk_count) {
            team.step();
            settled_s += STEP_S;
            prop_assert!(settled_s < 240.0, "not complete, seed {seed}");
        }
        let doubled_count: usize = team.vehicles.iter().map(|one| one.doubled_count).sum();
        // A put may overtake a pull, and a late answer one from elsewhere.
        let allowance = 2 * vehicle_count * vehicle_count + chunk_count * vehicle_count / 10;
        prop_assert!(doubled_count <= allowance, "{doubled_count} of {chunk_count} twice");
    }
}

#[test]
fn only_the_missing_set_travels_after_an_outage() {
    let mut team = Team::new(2, 0, 1);
    team.link(0, 1);
    for number in 0..50 {
        team.publish(0, number);
        team.step();
    }
    assert_eq!(team.pulled_count, 0);
    team.unlink(0, 1);
    for number in 50..90 {
        team.publish(0, number);
        team.step();
    }
    team.link(0, 1);
    let healed_at_s = team.time_s;
    while !team.complete(90) {
        team.step();
        assert!(team.time_s - healed_at_s < 5.0);
    }
    assert_eq!(team.pulled_count, 40);
    assert_eq!(team.vehicles[1].doubled_count, 0);
}

#[test]
fn a_map_crosses_a_gap_that_its_anchor_never_bridges() {
    let mut team = Team::new(3, 0, 1);
    for number in 0..20 {
        team.publish(0, number);
    }
    team.link(0, 1);
    (0..80).for_each(|_| team.step());
    team.unlink(0, 1);
    (0..20).for_each(|_| team.step());
    team.link(1, 2);
    (0..80).for_each(|_| team.step());
    assert!(team.complete(20));
}

#[test]
fn the_newest_comes_first_from_one_holder_within_the_window() {
    let mut sync = Sync::new(id(9), SyncSettings::default());
    let map = map_of(0);
    let held = Ranges::run(ChunkNumber(0), ChunkNumber(99));
    let have = |vehicle: usize| Have {
        vehicle: id(vehicle),
        map_count: 1,
        entries: vec![HaveEntry::new(map.clone(), &held, 0, 0)],
    };
    let mut pulls: Vec<(VehicleId, u32)> = Vec::new();
    for vehicle in [0, 1] {
        for effect in sync.handle(SyncEvent::BeaconHeard(have(vehicle)), at(0.0)) {
            if let SyncEffect::Pull { holder, chunk } = effect {
                pulls.push((holder, chunk.number.0));
            }
        }
    }
    let numbers: BTreeSet<u32> = pulls.iter().map(|(_, number)| *number).collect();
    assert_eq!(numbers, (84..100).collect());
    let mut per_holder: BTreeMap<&VehicleId, usize> = BTreeMap::new();
    pulls
        .iter()
        .for_each(|(holder, _)| *per_holder.entry(holder).or_default() += 1);
    assert!(per_holder.values().all(|count| *count == 8));

    // The first holder vanishes: what it was asked for goes to the other.
    let effects = sync.handle(SyncEvent::LinkDown(id(0)), at(1.0));
    assert!(
        effects
            .iter()
            .all(|effect| !matches!(effect, SyncEffect::Pull { .. }))
    );
    let effects = sync.handle(SyncEvent::Stored(chunk(&map, pulls[8].1)), at(1.1));
    let again = SyncEffect::Pull {
        holder: id(1),
        chunk: chunk(&map, 99),
    };
    assert!(effects.contains(&again), "{effects:?}");
}

#[test]
fn a_silent_holder_is_passed_over_and_an_evicted_chunk_is_not_fetched_again() {
    let mut sync = Sync::new(id(9), SyncSettings::default());
    let map = map_of(0);
    sync.handle(SyncEvent::Evicted(chunk(&map, 0)), at(0.0));
    let held = Ranges::run(ChunkNumber(0), ChunkNumber(1));
    let have = Have {
        vehicle: id(0),
        map_count: 1,
        entries: vec![HaveEntry::new(map.clone(), &held, 0, 0)],
    };
    let pulled = |effects: &[SyncEffect]| {
        effects
            .iter()
            .filter(|one| matches!(one, SyncEffect::Pull { .. }))
            .count()
    };
    let first = sync.handle(SyncEvent::BeaconHeard(have.clone()), at(0.0));
    assert_eq!(pulled(&first), 1);
    // Timed out: the holder rests half a second, then is tried again.
    assert_eq!(pulled(&sync.handle(SyncEvent::Tick, at(5.1))), 0);
    assert_eq!(
        pulled(&sync.handle(SyncEvent::BeaconHeard(have), at(5.7))),
        1
    );
    assert_eq!(sync.missing_count(), 1);
}

#[test]
fn memory_stays_bounded_whatever_neighbours_claim() {
    let settings = SyncSettings::default();
    let mut sync = Sync::new(id(0), settings.clone());
    let held: Ranges = (0..40).map(|number| ChunkNumber(2 * number)).collect();
    for vehicle in 1..80 {
        let entries = (0..140).map(|map| HaveEntry::new(map_of(200 * vehicle + map), &held, 3, 4));
        let have = Have {
            vehicle: id(vehicle),
            map_count: 140,
            entries: entries.collect(),
        };
        let now = at(vehicle as f64 * 0.01);
        let effects = sync.handle(SyncEvent::BeaconHeard(have), now);
        assert!(effects.len() < 3 * settings.neighbour_count_max * settings.map_count_max);
    }
    assert!(sync.neighbours.len() <= settings.neighbour_count_max);
    let claims = sync.neighbours.values().map(|one| one.claims.len());
    assert!(claims.max().unwrap() <= settings.map_count_max);
    // When all of them are gone, so is what they claimed.
    sync.handle(SyncEvent::Tick, at(100.0));
    assert!(sync.neighbours.is_empty() && sync.maps.len() <= 2 * settings.map_count_max);
    // A liar with four billion chunks is not believed.
    let held = Ranges::run(ChunkNumber(0), ChunkNumber(u32::MAX));
    let have = Have {
        vehicle: id(1),
        map_count: 1,
        entries: vec![HaveEntry::new(map_of(7), &held, 0, 0)],
    };
    let effects = sync.handle(SyncEvent::BeaconHeard(have), at(101.0));
    assert!(
        effects
            .iter()
            .all(|effect| !matches!(effect, SyncEffect::Pull { .. }))
    );
}

#[test]
fn beacons_are_paced_and_quicken_on_change() {
    let mut sync = Sync::new(id(0), SyncSettings::default());
    let mut sent: Vec<f64> = Vec::new();
    for step in 0..1000 {
        let time_s = f64::from(step) * STEP_S;
        let event = if step % 5 == 0 && step < 500 {
            SyncEvent::Stored(chunk(&map_of(0), step as u32))
        } else {
            SyncEvent::Tick
        };
        let effects = sync.handle(event, at(time_s));
        if effects
            .iter()
            .any(|one| matches!(one, SyncEffect::SendBeacon(_)))
        {
            sent.push(time_s);
        }
    }
    let busy = sent.iter().filter(|time_s| **time_s < 50.0).count();
    let calm = sent.iter().filter(|time_s| **time_s >= 50.0).count();
    assert!(
        (40..=65).contains(&busy) && (19..=31).contains(&calm),
        "{busy} {calm}"
    );
}

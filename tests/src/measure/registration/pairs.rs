//! Two vehicles' own maps of rendered rooms, one found in the other: from how different views,
//! with how little in common, and with nothing in common at all.
//!
//! A seed is a room in which a vehicle 0.3 m above the floor and up to five 1.5 m above it look at
//! one wall, each with its own lens and on its own way, the last of them at another part of it.
//! Every fourth seed also is a building of [`ROOM_COUNT`] rooms of one plan, with the same
//! furniture and posters: see [`World::twin`].

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::{Encounter, EncounterSettings, Likeness, Scene, Standpoint, Surroundings, Visit, World};

use super::RegistrationSettings;
use super::common_view::CommonView;
use super::tables::{self, Judged, Pair};
use super::trial::{localise, register_clouds};
use super::vehicle_map::VehicleMap;

/// Above the floor; the first one's map is the one in which others are sought.
const HEIGHTS_M: [f64; 2] = [0.3, 1.5];
/// Between the directions from which the two see the wall.
const ANGLES_DEG: [[f64; 2]; 4] = [[4.0, 15.0], [15.0, 30.0], [30.0, 45.0], [45.0, 60.0]];
/// The maps of this many other seeds are sought in each one's, in vain.
const STRANGER_COUNT: usize = 7;
/// Rooms of one plan.
const ROOM_COUNT: u64 = 4;
const BUILDING_INTERVAL: u64 = 4;
/// A map that is more out of shape than this is no measure for registration.
const LOG_SCALE_MAX: f64 = 0.015;
const ROTATION_DEG_MAX: f64 = 1.0;
const RESIDUAL_MAX: f64 = 0.02;

/// What one seed came to.
#[derive(Default)]
struct Unit<'a> {
    /// Where maps are kept.
    folder: Option<&'a Path>,
    pairs: Vec<Pair>,
    /// What others are sought in, and what is sought in others'.
    low: Option<VehicleMap>,
    high: Option<VehicleMap>,
    counts: Counts,
}

/// Of the vehicles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub vehicle_count: usize,
    /// Without a map.
    pub unmapped_count: usize,
    /// With a map out of shape.
    pub bent_count: usize,
}

/// Measures over these seeds; `report` sees the tables. Returns whether no wrong alignment was
/// accepted.
pub(super) fn measure(settings: &RegistrationSettings, mut report: impl FnMut(&str)) -> bool {
    let (seeds, thread_count) = (&settings.vehicle_seeds, settings.thread_count);
    let folder = settings.maps.as_deref();
    let units = in_parallel(seeds, thread_count, |seed| {
        (*seed, Unit::run(*seed, folder))
    });
    let mut counts = Counts::default();
    for (_, unit) in &units {
        counts.vehicle_count += unit.counts.vehicle_count;
        counts.unmapped_count += unit.counts.unmapped_count;
        counts.bent_count += unit.counts.bent_count;
    }
    let strangers = in_parallel(&stranger_idxs(units.len()), thread_count, |[low, high]| {
        let ((low_seed, low), (high_seed, high)) = (&units[*low], &units[*high]);
        let (low, high) = (low.low.as_ref()?, high.high.as_ref()?);
        Some(Pair {
            seeds: vec![*low_seed, *high_seed],
            what: format!("seed {high_seed} in {low_seed}"),
            judged: Judged::Strangers,
            localised: localise(low, high, false),
            registered: register_clouds(low, high, false),
        })
    });
    let mut pairs: Vec<Pair> = Vec::new();
    for (_, unit) in units {
        pairs.extend(unit.pairs);
    }
    pairs.extend(strangers.into_iter().flatten());
    if settings.verbose {
        tables::report_each(&pairs, &mut report);
    }
    tables::report(&pairs, &counts, &mut report);
    tables::report_wrong(&pairs, &mut report)
}

/// Which unit's map is sought in which other's.
fn stranger_idxs(unit_count: usize) -> Vec<[usize; 2]> {
    let steps = 1..=STRANGER_COUNT.min(unit_count.saturating_sub(1));
    let with = |low: usize| {
        steps
            .clone()
            .map(move |step| [low, (low + step) % unit_count])
    };
    (0..unit_count).flat_map(with).collect()
}

/// The results in the order of what they are of, on any number of threads.
fn in_parallel<I: Sync, O: Send>(
    list: &[I],
    thread_count: usize,
    run: impl Fn(&I) -> O + Sync,
) -> Vec<O> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(BTreeMap::new());
    std::thread::scope(|scope| {
        for _ in 0..thread_count.max(1) {
            scope.spawn(|| {
                loop {
                    let idx = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = list.get(idx) else {
                        return;
                    };
                    let result = run(item);
                    let mut results = results.lock().expect("no thread panics with the lock");
                    results.insert(idx, result);
                }
            });
        }
    });
    let results = results
        .into_inner()
        .expect("no thread panics with the lock");
    results.into_values().collect()
}

/// A room that vehicles look at.
struct Room {
    world: World,
    scene: Arc<Scene>,
    surroundings: Surroundings,
}

impl Room {
    fn new(world: World) -> Self {
        Self {
            scene: Arc::new(Scene::painted_when_seen(&world)),
            surroundings: Surroundings::new(&world),
            world,
        }
    }
}

impl<'a> Unit<'a> {
    fn run(seed: u64, folder: Option<&'a Path>) -> Self {
        let mut unit = Self {
            folder,
            ..Self::default()
        };
        unit.meet(seed);
        if seed.is_multiple_of(BUILDING_INTERVAL) {
            unit.mistake(seed);
        }
        unit
    }

    /// Vehicles that see one wall of one room.
    fn meet(&mut self, seed: u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7e57_0010);
        let room = Room::new(if rng.random_bool(0.5) {
            World::lab(seed)
        } else {
            World::parlour(seed)
        });
        let mut low: Option<(Encounter, Option<VehicleMap>)> = None;
        let aside_deg = ANGLES_DEG[seed as usize % ANGLES_DEG.len()];
        for (idx, angle_deg) in (1..).zip(ANGLES_DEG.into_iter().chain([aside_deg])) {
            let shift = match rng.random_bool(0.3) {
                _ if idx > ANGLES_DEG.len() as u64 => 0.7..1.1,
                true => 0.3..0.7,
                false => 0.0..0.25,
            };
            let wanted = EncounterSettings {
                heights_m: HEIGHTS_M,
                angle_rad: angle_deg.map(f64::to_radians),
                shift: rng.random_range(shift),
            };
            let (world, surroundings) = (&room.world, &room.surroundings);
            // The first that can be met so nearly alike decides where the other one is.
            let drawn = match &low {
                None => Encounter::draw(world, surroundings, &wanted, &mut rng),
                Some((first, _)) => first.draw_second(world, surroundings, &wanted, &mut rng),
            };
            let Some(encounter) = drawn else {
                continue;
            };
            let [below, above] = encounter.standpoints;
            let (_, low) =
                low.get_or_insert_with(|| (encounter, self.map(&below, &room, seed << 8)));
            let high = self.map(&above, &room, seed << 8 | idx);
            let (Some(low), Some(high)) = (low, high) else {
                continue;
            };
            self.pairs.push(Pair {
                seeds: vec![seed],
                what: format!("seed {seed}, vehicle {idx}"),
                judged: Judged::Common(CommonView::between(&low.truth, &high.truth, surroundings)),
                localised: localise(low, &high, true),
                registered: register_clouds(low, &high, true),
            });
            self.high.get_or_insert(high);
        }
        self.low = low.and_then(|(_, map)| map);
    }

    /// Vehicles that see the same wall of rooms that look alike.
    fn mistake(&mut self, seed: u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7e57_0011);
        let plan = World::parlour(seed ^ 0x7e57);
        let likeness = Likeness {
            furniture: rng.random_range(0.3..0.8),
            contents: rng.random_range(0.0..0.4),
        };
        let settings = EncounterSettings {
            heights_m: HEIGHTS_M,
            angle_rad: [0.0, 0.5],
            shift: rng.random_range(0.0..0.2),
        };
        let surroundings = Surroundings::new(&plan);
        let Some(encounter) = Encounter::draw(&plan, &surroundings, &settings, &mut rng) else {
            return;
        };
        let rooms: Vec<Room> = (0..ROOM_COUNT)
            .map(|copy| Room::new(plan.twin(&likeness, seed << 8 | copy)))
            .collect();
        let maps: Vec<[Option<VehicleMap>; 2]> = (0..ROOM_COUNT)
            .zip(&rooms)
            .map(|(copy, room)| {
                let [low, high] = encounter.standpoints;
                let visit_seed = seed << 8 | 0x80 | copy << 1;
                let low = self.map(&low, room, visit_seed);
                [low, self.map(&high, room, visit_seed | 1)]
            })
            .collect();
        for (low_idx, low) in maps.iter().enumerate() {
            for (high_idx, high) in maps.iter().enumerate() {
                let (Some(low), Some(high)) = (&low[0], &high[1]) else {
                    continue;
                };
                let is_common = low_idx == high_idx;
                let judged = if is_common {
                    Judged::Home
                } else {
                    Judged::Twins
                };
                self.pairs.push(Pair {
                    seeds: vec![seed],
                    what: format!("building {seed}, room {high_idx} in {low_idx}, {likeness:.2?}"),
                    judged,
                    localised: localise(low, high, is_common),
                    registered: register_clouds(low, high, is_common),
                });
            }
        }
    }

    /// What a vehicle maps, unless it is too much out of shape to measure anything by.
    fn map(&mut self, standpoint: &Standpoint, room: &Room, seed: u64) -> Option<VehicleMap> {
        self.counts.vehicle_count += 1;
        let visit = Visit::new(standpoint, seed);
        let file = self
            .folder
            .map(|folder| folder.join(format!("{seed:x}.map")));
        let Some(map) = VehicleMap::find(&visit, file.as_deref(), &room.scene, &room.surroundings)
        else {
            self.counts.unmapped_count += 1;
            return None;
        };
        let bend = &map.truth.bend;
        let is_straight = bend.log_scale < LOG_SCALE_MAX
            && bend.rotation_deg < ROTATION_DEG_MAX
            && bend.residual < RESIDUAL_MAX;
        self.counts.bent_count += usize::from(!is_straight);
        is_straight.then_some(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_map_is_sought_in_those_of_seven_others() {
        let pairs = stranger_idxs(100);
        assert_eq!(pairs.len(), 700);
        assert!(pairs.iter().all(|[low, high]| low != high && *high < 100));
        // Two seeds alone repeat what they came to among many.
        assert_eq!(stranger_idxs(2), [[0, 1], [1, 0]]);
        assert!(stranger_idxs(1).is_empty());
    }

    #[test]
    fn results_keep_the_order_of_what_they_are_of() {
        let list: Vec<u64> = (0..50).collect();
        let squares = in_parallel(&list, 3, |one| one * one);
        assert!(
            squares
                .iter()
                .zip(&list)
                .all(|(square, one)| *square == one * one)
        );
    }
}

//! What neighbours say they hold.

use std::collections::BTreeMap;
use std::time::Duration;

use geometry::Timestamp;

use super::{Sync, SyncEffect};
use crate::{ChunkNumber, Have, HaveEntry, MapId, Ranges, VehicleId};

#[derive(Debug)]
pub(super) struct Neighbour {
    pub(super) heard_at: Timestamp,
    pub(super) claims: BTreeMap<MapId, Claim>,
    /// It failed lately: not asked before this.
    pub(super) resting_until: Option<Timestamp>,
    pub(super) failure_count: u32,
}

#[derive(Debug, Default)]
pub(super) struct Claim {
    /// What it is known to hold; exact if `digest` is that of these.
    pub(super) held: Ranges,
    digest: u64,
    placement_revision: u32,
    placement_digest: u64,
    asked_at: Option<Timestamp>,
    /// The digest for which it was asked, so that the same question is not asked for ever.
    asked_digest: u64,
    ask_count: u32,
}

impl Neighbour {
    pub(super) fn forgive(&mut self) {
        self.resting_until = None;
        self.failure_count = 0;
    }
}

impl Sync {
    pub(super) fn hear(&mut self, have: Have, now: Timestamp) {
        if have.vehicle == self.vehicle {
            return;
        }
        self.make_room_for(&have.vehicle);
        let neighbour = self
            .neighbours
            .entry(have.vehicle.clone())
            .or_insert(Neighbour {
                heard_at: now,
                claims: BTreeMap::new(),
                resting_until: None,
                failure_count: 0,
            });
        neighbour.heard_at = now;
        for entry in have.entries {
            self.take_entry(&have.vehicle, &entry, now);
        }
    }

    fn make_room_for(&mut self, vehicle: &VehicleId) {
        let full = self.neighbours.len() >= self.settings.neighbour_count_max;
        if self.neighbours.contains_key(vehicle) || !full {
            return;
        }
        let oldest = self.neighbours.iter().min_by_key(|(_, one)| one.heard_at);
        if let Some(oldest) = oldest.map(|(id, _)| id.clone()) {
            self.forget(&oldest);
        }
    }

    fn take_entry(&mut self, vehicle: &VehicleId, entry: &HaveEntry, now: Timestamp) {
        let settings = &self.settings;
        let highest = entry.highest.map(|number| number.0);
        if highest.is_some_and(|number| number > settings.chunk_number_max) {
            return;
        }
        let Some(neighbour) = self.neighbours.get_mut(vehicle) else {
            return;
        };
        let known = neighbour.claims.contains_key(&entry.map);
        if !known && neighbour.claims.len() >= settings.map_count_max {
            return;
        }
        let claim = neighbour.claims.entry(entry.map.clone()).or_default();
        claim.placement_revision = entry.placement_revision;
        claim.placement_digest = entry.placement_digest;
        claim.digest = entry.digest;
        // What holds all numbers up to its highest needs no question.
        let all = highest.map_or_else(Ranges::new, |number| {
            Ranges::run(ChunkNumber(0), ChunkNumber(number))
        });
        let own = self.maps.get(&entry.map).map(|own| &own.held);
        if all.digest() == entry.digest {
            claim.held = all;
        } else if let Some(own) = own.filter(|own| own.digest() == entry.digest) {
            claim.held = own.clone();
        }
        self.note_highest(&entry.map, highest, now);
    }

    /// Leaves numbers that are new to the team to the fast path for a while.
    fn note_highest(&mut self, map: &MapId, highest: Option<u32>, now: Timestamp) {
        let grace = Duration::from_secs_f64(self.settings.grace_s);
        let own = self.maps.entry(map.clone()).or_default();
        let Some(highest) = highest else { return };
        match own.highest_heard {
            // The first word of a map: whoever comes late wants all of it at once.
            None => {}
            Some(before) if highest > before => {
                let expired = own.fresh.is_none_or(|(_, until)| now >= until);
                if expired {
                    own.fresh = Some((before + 1, now.after(grace)));
                }
            }
            Some(_) => return,
        }
        own.highest_heard = Some(highest);
    }

    pub(super) fn hear_ranges(&mut self, holder: &VehicleId, map: &MapId, mut held: Ranges) {
        let limit = ChunkNumber(self.settings.chunk_number_max);
        if held.highest() > Some(limit) {
            return;
        }
        held.truncate_runs(self.settings.run_count_max);
        let Some(neighbour) = self.neighbours.get_mut(holder) else {
            return;
        };
        if let Some(claim) = neighbour.claims.get_mut(map) {
            claim.held = held;
        }
    }

    pub(super) fn forget(&mut self, vehicle: &VehicleId) {
        self.neighbours.remove(vehicle);
        self.pulls.retain(|_, pull| pull.holder != *vehicle);
        self.forget_empty_maps();
    }

    pub(super) fn expire(&mut self, now: Timestamp) {
        let limit_s = self.settings.neighbour_timeout_s;
        let silent: Vec<VehicleId> = self
            .neighbours
            .iter()
            .filter(|(_, neighbour)| now - neighbour.heard_at > limit_s)
            .map(|(id, _)| id.clone())
            .collect();
        for vehicle in silent {
            self.forget(&vehicle);
        }
        self.time_out_pulls(now);
    }

    /// Maps of which nothing is held and which nobody claims any more.
    fn forget_empty_maps(&mut self) {
        if self.maps.len() <= 2 * self.settings.map_count_max {
            return;
        }
        let neighbours = &self.neighbours;
        self.maps.retain(|map, own| {
            let held = !own.held.is_empty() || !own.unwanted.is_empty();
            let claimed = || neighbours.values().any(|one| one.claims.contains_key(map));
            held || own.placement_revision > 0 || claimed()
        });
    }

    /// Questions about what beacons only hint at.
    pub(super) fn ask(&mut self, now: Timestamp, effects: &mut Vec<SyncEffect>) {
        let interval_s = self.settings.question_interval_s;
        for (holder, neighbour) in &mut self.neighbours {
            for (map, claim) in &mut neighbour.claims {
                let Some(own) = self.maps.get_mut(map) else {
                    continue;
                };
                let differs = claim.digest != own.held.digest();
                if differs && claim.digest != claim.held.digest() && claim.may_ask(now, interval_s)
                {
                    let (holder, map) = (holder.clone(), map.clone());
                    effects.push(SyncEffect::AskRanges { holder, map });
                }
                let newer = claim.placement_digest != own.placement_digest
                    && claim.placement_revision >= own.placement_revision;
                let asked = own.placement_asked.is_some_and(|(at, digest)| {
                    // The same answer again is unlikely to help: ask less often.
                    let patience = if digest == claim.placement_digest {
                        5.0
                    } else {
                        1.0
                    };
                    now - at < patience * interval_s
                });
                if newer && !asked {
                    own.placement_asked = Some((now, claim.placement_digest));
                    let (holder, map) = (holder.clone(), map.clone());
                    effects.push(SyncEffect::AskPlacement { holder, map });
                }
            }
        }
    }
}

impl Claim {
    /// Whether the question is due; it doubles its distance while the answer does not fit.
    fn may_ask(&mut self, now: Timestamp, interval_s: f64) -> bool {
        if self.asked_digest != self.digest {
            self.ask_count = 0;
        }
        let patience_s = interval_s * f64::from(1_u32 << self.ask_count.min(5));
        if self.asked_at.is_some_and(|at| now - at < patience_s) {
            return false;
        }
        self.asked_at = Some(now);
        self.asked_digest = self.digest;
        self.ask_count += 1;
        true
    }
}

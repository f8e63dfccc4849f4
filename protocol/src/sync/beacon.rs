//! When to say what is held: on change, else now and then, less often in a crowd, never in step.

use geometry::Timestamp;

use super::{Sync, SyncEffect};
use crate::ranges::mix;
use crate::{Have, HaveEntry, VehicleId};

#[derive(Debug)]
pub(super) struct BeaconClock {
    sent_at: Option<Timestamp>,
    changed: bool,
    hurried: bool,
    next_entry_idx: usize,
    /// Makes the jitter of this vehicle's beacons its own.
    seed: u64,
}

impl BeaconClock {
    pub(super) fn new(vehicle: &VehicleId) -> Self {
        let bytes = vehicle.as_str().bytes();
        Self {
            sent_at: None,
            changed: false,
            hurried: false,
            next_entry_idx: 0,
            seed: bytes.fold(0, |seed, byte| mix(seed ^ u64::from(byte))),
        }
    }

    pub(super) fn change(&mut self) {
        self.changed = true;
    }

    pub(super) fn hurry(&mut self) {
        self.hurried = true;
    }

    /// From 0.8 to 1.2.
    fn jitter(&self) -> f64 {
        0.8 + 0.4 * (self.seed >> 11) as f64 / (1_u64 << 53) as f64
    }
}

impl Sync {
    pub(super) fn send_beacon(&mut self, now: Timestamp, effects: &mut Vec<SyncEffect>) {
        let crowd = 1.0 + self.settings.beacon_share_per_neighbour * self.neighbours.len() as f64;
        let interval_s = if self.beacon.changed {
            self.settings.beacon_change_interval_s
        } else {
            self.settings.beacon_interval_s
        };
        let waited_s = self
            .beacon
            .sent_at
            .map_or(f64::INFINITY, |sent_at| now - sent_at);
        // Even a flapping link brings no more than four beacons a second.
        let hurried = self.beacon.hurried && waited_s > 0.25;
        if !hurried && waited_s < interval_s * crowd * self.beacon.jitter() {
            return;
        }
        let entries: Vec<HaveEntry> = self
            .maps
            .iter()
            .filter(|(_, own)| !own.held.is_empty() || own.placement_revision > 0)
            .map(|(map, own)| {
                let (revision, digest) = (own.placement_revision, own.placement_digest);
                HaveEntry::new(map.clone(), &own.held, revision, digest)
            })
            .collect();
        let (have, next_idx) =
            Have::rotate(self.vehicle.clone(), &entries, self.beacon.next_entry_idx);
        self.beacon.next_entry_idx = next_idx;
        self.beacon.seed = mix(self.beacon.seed);
        self.beacon.sent_at = Some(now);
        self.beacon.changed = false;
        self.beacon.hurried = false;
        effects.push(SyncEffect::SendBeacon(have));
    }
}

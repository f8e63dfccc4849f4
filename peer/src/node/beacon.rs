//! When to say what is held.

use std::sync::Arc;
use std::time::Duration;

use geometry::Timestamp;
use protocol::{Have, HaveEntry, VehicleId, encode};

use super::shelf::Shelf;

const PERIOD: Duration = Duration::from_secs(2);
/// Also the shortest time between two beacons.
const PERIOD_ON_CHANGE: Duration = Duration::from_secs(1);

/// The beacon's clock: every 2 s, on change at most once a second, jittered by the vehicle's name
/// so that a team does not speak in chorus.
#[derive(Debug)]
pub struct BeaconTimer {
    sent_at: Option<Timestamp>,
    sent_entries: Vec<HaveEntry>,
    next_entry_idx: usize,
    jitter: Duration,
    hastened: bool,
}

impl BeaconTimer {
    pub fn new(id: &VehicleId) -> Self {
        let sum: u64 = id.as_str().bytes().map(u64::from).sum();
        Self {
            sent_at: None,
            sent_entries: Vec::new(),
            next_entry_idx: 0,
            jitter: Duration::from_millis(sum * 37 % 200),
            hastened: true,
        }
    }

    /// The next beacon goes out at the next opportunity.
    pub fn hasten(&mut self) {
        self.hastened = true;
    }

    /// The beacon's bytes, if it is due.
    pub fn next(
        &mut self,
        id: &VehicleId,
        shelf: &Shelf,
        now: Timestamp,
    ) -> Option<Arc<[u8]>> {
        let waited = self.sent_at.map(|sent_at| now.since(sent_at));
        let due = |period: Duration| waited.is_none_or(|waited| waited >= period + self.jitter);
        if !self.hastened && !due(PERIOD_ON_CHANGE) {
            return None;
        }
        let entries = shelf.entries();
        if !self.hastened && !due(PERIOD) && entries == self.sent_entries {
            return None;
        }
        let (have, next_entry_idx) = Have::rotate(id.clone(), &entries, self.next_entry_idx);
        self.sent_at = Some(now);
        self.sent_entries = entries;
        self.next_entry_idx = next_entry_idx;
        self.hastened = false;
        Some(Arc::from(encode(&have)))
    }
}

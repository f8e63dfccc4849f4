//! Have and want on the wire: the reconciliation's wishes as beacons and requests.

use std::collections::BTreeMap;
use std::sync::Arc;

use geometry::Timestamp;
use protocol::keys::Key;
use protocol::sync::{Sync, SyncEffect, SyncEvent, SyncSettings};
use protocol::{ChunkId, MapId, VehicleId, encode};

use super::{Effect, Kept};
use crate::link::{Class, RequestId};

/// What was asked of others, and what they are told.
#[derive(Debug)]
pub struct Exchange {
    id: VehicleId,
    sync: Sync,
    next_request: u64,
    open: BTreeMap<RequestId, Purpose>,
    beacon: Option<Arc<[u8]>>,
}

#[derive(Debug, PartialEq, Eq)]
enum Purpose {
    Ranges(MapId),
    Placement(MapId),
    Pull { holder: VehicleId, chunk: ChunkId },
}

impl Exchange {
    pub fn new(id: VehicleId) -> Self {
        Self {
            sync: Sync::new(id.clone(), SyncSettings::default()),
            id,
            next_request: 1,
            open: BTreeMap::new(),
            beacon: None,
        }
    }

    /// Tells the reconciliation what happened, and does what it wants.
    pub fn tell(&mut self, event: SyncEvent, now: Timestamp, effects: &mut Vec<Effect>) {
        for wish in self.sync.handle(event, now) {
            match wish {
                SyncEffect::SendBeacon(have) => {
                    let payload: Arc<[u8]> = Arc::from(encode(&have));
                    self.beacon = Some(Arc::clone(&payload));
                    effects.push(Effect::Keep(Kept::Beacon(Arc::clone(&payload))));
                    effects.push(self.publication(payload));
                }
                SyncEffect::Pull { holder, chunk } => {
                    let key = Key::HeldChunk(holder.clone(), chunk.clone());
                    self.ask(Purpose::Pull { holder, chunk }, key.to_string(), effects);
                }
                // All holders answer these, so that one question about a map is enough.
                SyncEffect::AskRanges { map, .. } => {
                    let selector = Key::Manifest(map.anchor.clone()).to_string();
                    self.ask(Purpose::Ranges(map), selector, effects);
                }
                SyncEffect::AskPlacement { map, .. } => {
                    let selector = format!("{}/**", Key::Placement(map.clone()));
                    self.ask(Purpose::Placement(map), selector, effects);
                }
            }
        }
    }

    /// Says the newest beacon again, for somebody who may have missed it.
    pub fn repeat_beacon(&self, effects: &mut Vec<Effect>) {
        if let Some(beacon) = &self.beacon {
            effects.push(self.publication(Arc::clone(beacon)));
        }
    }

    pub fn is_pull(&self, request: RequestId) -> bool {
        matches!(self.open.get(&request), Some(Purpose::Pull { .. }))
    }

    /// No more replies come.
    pub fn end_request(&mut self, request: RequestId, now: Timestamp, effects: &mut Vec<Effect>) {
        if let Some(Purpose::Pull { holder, chunk }) = self.open.remove(&request) {
            let held = self.sync.held(&chunk.map);
            if !held.is_some_and(|held| held.contains(chunk.number)) {
                self.tell(SyncEvent::PullFailed { holder, chunk }, now, effects);
            }
        }
    }

    pub fn open_request_count(&self) -> usize {
        self.open.len()
    }

    fn publication(&self, payload: Arc<[u8]>) -> Effect {
        Effect::Publish {
            class: Class::Notice,
            key: Key::Have(self.id.clone()),
            payload,
        }
    }

    fn ask(&mut self, purpose: Purpose, selector: String, effects: &mut Vec<Effect>) {
        if self.open.values().any(|open| *open == purpose) {
            return;
        }
        let request = RequestId(self.next_request);
        self.next_request += 1;
        self.open.insert(request, purpose);
        effects.push(Effect::Request { request, selector });
    }
}

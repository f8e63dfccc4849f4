//! What arrives from others: parsed at this door, trusted behind it.

use std::sync::Arc;

use geometry::Timestamp;
use protocol::keys::Key;
use protocol::sync::SyncEvent;
use protocol::{
    Chunk, ChunkId, Have, Manifest, MapId, Placement, PlacementPage, Pose, VehicleId, decode,
};

use super::shelf::Taken;
use super::{Effect, Kept, Node, Role};
use crate::link::RequestId;

/// Why a message is not taken.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Key(#[from] protocol::keys::KeyError),
    #[error(transparent)]
    Body(#[from] protocol::DecodeError),
    #[error("the body is of {body}, the key of {key}")]
    Mismatch { body: String, key: String },
    #[error("nobody publishes under this key")]
    Misplaced,
    #[error("somebody else speaks as this vehicle: the same id twice, or a forgery")]
    Impersonation,
}

impl Node {
    pub(super) fn take_message(
        &mut self,
        key: &str,
        payload: &Arc<[u8]>,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) {
        let taken = key
            .parse()
            .map_err(Refusal::from)
            .and_then(|parsed: Key| self.take(parsed, payload, now, effects));
        match taken {
            Ok(()) => {}
            Err(Refusal::Impersonation) => self.count_impersonation(key),
            Err(refusal) => self.count_malformed(key, &refusal),
        }
    }

    pub(super) fn take_reply(
        &mut self,
        request: RequestId,
        key: &str,
        payload: &Arc<[u8]>,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) {
        if self.exchange.is_pull(request) {
            self.counters.chunks_pulled += 1;
        }
        self.take_message(key, payload, now, effects);
    }

    fn take(
        &mut self,
        key: Key,
        payload: &Arc<[u8]>,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) -> Result<(), Refusal> {
        match key {
            Key::Chunk(id) | Key::HeldChunk(_, id) => self.take_chunk(&id, payload, now, effects),
            Key::Manifest(anchor) => {
                let manifest: Manifest = decode(payload)?;
                matches(&manifest.map.anchor, &anchor)?;
                if self.is_own_map(&manifest.map) {
                    return self.unless_own_id(&manifest.holder);
                }
                self.take_manifest(manifest, now, effects);
                Ok(())
            }
            Key::Placement(map) => {
                let placement: Placement = decode(payload)?;
                matches(&placement.map, &map)?;
                if self.is_own_map(&map) {
                    let known = self
                        .shelf
                        .map(&map)
                        .and_then(|held| held.placement.as_ref());
                    return no_news(placement.revision, known.map(|one| one.revision));
                }
                self.take_placement(placement, now, effects);
                Ok(())
            }
            Key::PlacementPage(map, page) => {
                let body: PlacementPage = decode(payload)?;
                matches(body.map(), &map)?;
                matches(&body.page(), &page)?;
                if self.is_own_map(&map) {
                    let known = self.shelf.map(&map).and_then(|held| held.pages.get(&page));
                    return no_news(body.revision(), known.map(PlacementPage::revision));
                }
                self.take_page(body, now, effects);
                Ok(())
            }
            Key::Have(vehicle) => {
                let have: Have = decode(payload)?;
                matches(&have.vehicle, &vehicle)?;
                self.unless_own_id(&vehicle)?;
                self.exchange
                    .tell(SyncEvent::BeaconHeard(have), now, effects);
                Ok(())
            }
            Key::Pose(vehicle) => {
                let pose: Pose = decode(payload)?;
                matches(&pose.vehicle, &vehicle)?;
                self.unless_own_id(&vehicle)
            }
            Key::Alive(_) => Err(Refusal::Misplaced),
        }
    }

    /// Whether this vehicle is the only one with something to say about the map.
    fn is_own_map(&self, map: &MapId) -> bool {
        let own = match &self.role {
            Role::Anchor(role) => role.map(),
            Role::Peer(role) => role.shared_map(),
        };
        own == map
    }

    /// The link does not bring back what this vehicle has said itself.
    fn unless_own_id(&self, vehicle: &VehicleId) -> Result<(), Refusal> {
        if *vehicle == self.settings.id {
            return Err(Refusal::Impersonation);
        }
        Ok(())
    }

    fn take_chunk(
        &mut self,
        id: &ChunkId,
        payload: &Arc<[u8]>,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) -> Result<(), Refusal> {
        let chunk: Chunk = decode(payload)?;
        matches(chunk.id(), id)?;
        if self.is_own_map(&id.map) && !self.shelf.holds_chunk(id, payload) {
            return Err(Refusal::Impersonation);
        }
        match self.shelf.take_chunk(&chunk, payload) {
            Taken::New => {
                self.counters.chunks_received += 1;
                effects.push(Effect::Keep(Kept::Chunk(id.clone(), Arc::clone(payload))));
                self.exchange
                    .tell(SyncEvent::Stored(id.clone()), now, effects);
                if let Role::Peer(role) = &mut self.role {
                    let page = self.shelf.map(&id.map);
                    let page = page.and_then(|held| held.pages.get(&id.number.page()));
                    role.take_chunk(&chunk, page);
                }
            }
            Taken::Known => self.counters.duplicates += 1,
            Taken::Equivocation => self.count_equivocation(&id.map, "chunk"),
            Taken::Full => {}
        }
        Ok(())
    }

    fn take_manifest(&mut self, manifest: Manifest, now: Timestamp, effects: &mut Vec<Effect>) {
        let ranges = SyncEvent::RangesHeard {
            holder: manifest.holder.clone(),
            map: manifest.map.clone(),
            held: manifest.held.clone(),
        };
        self.exchange.tell(ranges, now, effects);
        if self.shelf.take_manifest(manifest.clone()) == Taken::New {
            effects.push(Effect::Keep(Kept::Manifest(manifest)));
        }
    }

    fn take_placement(&mut self, placement: Placement, now: Timestamp, effects: &mut Vec<Effect>) {
        match self.shelf.take_placement(placement.clone()) {
            Taken::New => {
                if let Role::Peer(role) = &mut self.role {
                    role.take_placement(&placement);
                }
                let map = placement.map.clone();
                effects.push(Effect::Keep(Kept::Placement(Box::new(placement))));
                self.tell_placement(map, now, effects);
            }
            Taken::Equivocation => self.count_equivocation(&placement.map, "placement"),
            Taken::Known | Taken::Full => {}
        }
    }

    fn take_page(&mut self, page: PlacementPage, now: Timestamp, effects: &mut Vec<Effect>) {
        match self.shelf.take_page(page.clone()) {
            Taken::New => {
                if let Role::Peer(role) = &mut self.role {
                    role.take_page(&page);
                }
                let map = page.map().clone();
                effects.push(Effect::Keep(Kept::Page(page)));
                self.tell_placement(map, now, effects);
            }
            Taken::Equivocation => self.count_equivocation(page.map(), "placement page"),
            Taken::Known | Taken::Full => {}
        }
    }

    fn tell_placement(&mut self, map: MapId, now: Timestamp, effects: &mut Vec<Effect>) {
        if let Some(held) = self.shelf.map(&map) {
            let event = held.placement_held(map);
            self.exchange.tell(event, now, effects);
        }
    }

    fn count_malformed(&mut self, key: &str, refusal: &Refusal) {
        self.counters.malformed += 1;
        if self.counters.malformed == 1 {
            let key: String = key.chars().take(80).collect();
            tracing::warn!(%refusal, key, "message ignored; further ones are only counted");
        }
    }

    fn count_impersonation(&mut self, key: &str) {
        self.counters.impersonations += 1;
        if self.counters.impersonations == 1 {
            let key: String = key.chars().take(80).collect();
            tracing::warn!(
                key,
                "somebody else speaks as this vehicle: give every vehicle an id of its own, or \
                 look for who forges; further messages are only counted"
            );
        }
    }

    fn count_equivocation(&mut self, map: &MapId, what: &str) {
        self.counters.equivocations += 1;
        if self.counters.equivocations == 1 {
            tracing::warn!(%map, what, "two bodies under one key; the first is kept");
        }
    }
}

/// A revision of the own map that others may have: the newest, or an older one.
fn no_news(revision: u32, known: Option<u32>) -> Result<(), Refusal> {
    if known.is_some_and(|known| revision <= known) {
        return Ok(());
    }
    Err(Refusal::Impersonation)
}

fn matches<T: PartialEq + std::fmt::Debug>(body: &T, key: &T) -> Result<(), Refusal> {
    if body == key {
        return Ok(());
    }
    Err(Refusal::Mismatch {
        body: format!("{body:?}"),
        key: format!("{key:?}"),
    })
}

#[cfg(test)]
mod tests;

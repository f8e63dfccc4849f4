//! Where what an anchor wants said goes: own shelf, store, link and reconciliation.

use std::sync::Arc;

use anchor::Effect as AnchorEffect;
use geometry::Timestamp;
use protocol::keys::Key;
use protocol::sync::SyncEvent;
use protocol::{MapId, encode};

use super::exchange::Exchange;
use super::shelf::Shelf;
use super::{Effect, Kept, NodeCounters};
use crate::link::Class;

/// Where the effects of the role go.
pub struct Outlet<'a> {
    pub shelf: &'a mut Shelf,
    pub exchange: &'a mut Exchange,
    pub counters: &'a mut NodeCounters,
    pub effects: &'a mut Vec<Effect>,
    pub now: Timestamp,
}

impl Outlet<'_> {
    pub fn publish(&mut self, effect: AnchorEffect) {
        match effect {
            AnchorEffect::PublishChunk { chunk, bytes } => {
                let payload: Arc<[u8]> = Arc::from(bytes);
                self.shelf.take_chunk(&chunk, &payload);
                self.counters.chunks_published += 1;
                let id = chunk.id().clone();
                let kept = Kept::Chunk(id.clone(), Arc::clone(&payload));
                self.send(kept, Class::Bulk, Key::Chunk(id.clone()), payload);
                self.exchange
                    .tell(SyncEvent::Stored(id), self.now, self.effects);
            }
            AnchorEffect::PublishPlacement(placement) => {
                self.shelf.take_placement(placement.clone());
                let map = placement.map.clone();
                let payload = Arc::from(encode(&placement));
                let key = Key::Placement(map.clone());
                let kept = Kept::Placement(Box::new(placement));
                self.send(kept, Class::Notice, key, payload);
                self.tell_placement(map);
            }
            AnchorEffect::PublishPage(page) => {
                self.shelf.take_page(page.clone());
                let map = page.map().clone();
                let payload = Arc::from(encode(&page));
                let key = Key::PlacementPage(map.clone(), page.page());
                self.send(Kept::Page(page), Class::Notice, key, payload);
                self.tell_placement(map);
            }
            AnchorEffect::PublishManifest(manifest) => {
                self.shelf.take_manifest(manifest.clone());
                let key = Key::Manifest(manifest.map.anchor.clone());
                let payload = Arc::from(encode(&manifest));
                self.send(Kept::Manifest(manifest), Class::Notice, key, payload);
            }
            AnchorEffect::StateChanged { state, reason } => {
                tracing::info!(%state, reason, "anchor");
            }
            AnchorEffect::RequestKeyframe(_) => {}
        }
    }

    fn tell_placement(&mut self, map: MapId) {
        if let Some(held) = self.shelf.map(&map) {
            let event = held.placement_held(map);
            self.exchange.tell(event, self.now, self.effects);
        }
    }

    fn send(&mut self, kept: Kept, class: Class, key: Key, payload: Arc<[u8]>) {
        self.effects.push(Effect::Keep(kept));
        self.effects.push(Effect::Publish {
            class,
            key,
            payload,
        });
    }
}

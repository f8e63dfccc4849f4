//! Replies of several holders, put together.

use std::collections::{BTreeMap, BTreeSet};

use geodesy::{Datum, enu_from_enu};
use nalgebra::Vector3;
use protocol::keys::Key;
use protocol::{Chunk, ChunkNumber, Manifest, MapId, Placement, PlacementPage, Ranges, decode};

use super::MapSummary;
use crate::link::Reply;

/// Everything that was answered, by map.
#[derive(Default)]
pub struct Collection {
    maps: BTreeMap<MapId, Parts>,
    /// Replies that are no messages of ours.
    pub malformed_count: usize,
}

#[derive(Default)]
struct Parts {
    manifest: Option<Manifest>,
    held: Ranges,
    holders: BTreeSet<String>,
    placement: Option<Placement>,
    pages: BTreeMap<u32, PlacementPage>,
    chunks: BTreeMap<ChunkNumber, Chunk>,
}

impl Collection {
    /// Takes a reply; of several revisions the highest stays.
    pub fn take(&mut self, reply: &Reply) {
        if self.try_take(reply).is_none() {
            self.malformed_count += 1;
        }
    }

    fn try_take(&mut self, reply: &Reply) -> Option<()> {
        match reply.key.parse().ok()? {
            Key::Manifest(_) => {
                let manifest: Manifest = decode(&reply.payload).ok()?;
                let parts = self.maps.entry(manifest.map.clone()).or_default();
                parts.held.unite(&manifest.held);
                parts.holders.insert(manifest.holder.to_string());
                let known = parts.manifest.as_ref().map(|known| known.revision);
                if known.is_none_or(|known| known < manifest.revision) {
                    parts.manifest = Some(manifest);
                }
            }
            Key::Chunk(id) | Key::HeldChunk(_, id) => {
                let chunk: Chunk = decode(&reply.payload).ok()?;
                let parts = self.maps.entry(id.map).or_default();
                parts.chunks.entry(id.number).or_insert(chunk);
            }
            Key::Placement(map) => {
                let placement: Placement = decode(&reply.payload).ok()?;
                let parts = self.maps.entry(map).or_default();
                let known = parts.placement.as_ref().map(|known| known.revision);
                if known.is_none_or(|known| known < placement.revision) {
                    parts.placement = Some(placement);
                }
            }
            Key::PlacementPage(map, page) => {
                let body: PlacementPage = decode(&reply.payload).ok()?;
                let parts = self.maps.entry(map).or_default();
                let known = parts.pages.get(&page).map(PlacementPage::revision);
                if known.is_none_or(|known| known < body.revision()) {
                    parts.pages.insert(page, body);
                }
            }
            Key::Have(_) | Key::Pose(_) | Key::Alive(_) => {}
        }
        Some(())
    }

    pub fn maps(&self) -> Vec<MapId> {
        self.maps.keys().cloned().collect()
    }

    pub fn has_chunks(&self) -> bool {
        self.maps.values().any(|parts| !parts.chunks.is_empty())
    }

    pub fn has_chunks_of(&self, map: &MapId) -> bool {
        self.maps
            .get(map)
            .is_some_and(|parts| !parts.chunks.is_empty())
    }

    /// What there is, and all placed points in the datum of the first map that has one; maps
    /// whose datum does not relate to that are listed and bring no points.
    pub fn summarise(&self) -> (Vec<MapSummary>, Vec<Vector3<f64>>) {
        let mut datum: Option<&Datum> = None;
        let mut points = Vec::new();
        let mut summaries = Vec::new();
        for (map, parts) in &self.maps {
            let own_points = parts.placement.as_ref().map_or_else(Vec::new, |placement| {
                let datum = *datum.get_or_insert(&placement.datum);
                match enu_from_enu(datum, &placement.datum, &[]) {
                    Ok(common_from_enu) => parts
                        .points_in_enu(placement)
                        .map(|point| common_from_enu * point)
                        .collect(),
                    Err(error) => {
                        tracing::warn!(%map, %error, "points left out");
                        Vec::new()
                    }
                }
            });
            summaries.push(parts.summary(map, own_points.len()));
            points.extend(own_points);
        }
        (summaries, points)
    }
}

impl Parts {
    fn points_in_enu(&self, placement: &Placement) -> impl Iterator<Item = Vector3<f64>> + use<'_> {
        let enu_from_map = placement.enu_from_map;
        let placed = self.pages.values().flat_map(PlacementPage::placements);
        placed.flat_map(move |placed| {
            let enu_from_chunk = enu_from_map * placed.map_from_chunk;
            let chunk = self.chunks.get(&placed.number);
            let points = chunk.into_iter().flat_map(Chunk::points);
            points.map(move |point| enu_from_chunk * point.position_in_chunk)
        })
    }

    fn summary(&self, map: &MapId, point_count: usize) -> MapSummary {
        let manifest = self.manifest.as_ref();
        let placement = self.placement.as_ref();
        let reference = placement.map(|placement| placement.reference);
        let reference = reference.or(manifest.map(|manifest| manifest.reference));
        let provenance = placement.map(|placement| &placement.provenance);
        let provenance = provenance.or(manifest.map(|manifest| &manifest.provenance));
        let names = provenance.into_iter().flatten();
        MapSummary {
            anchor: map.anchor.to_string(),
            epoch: map.epoch.to_string(),
            revision: manifest.map(|manifest| manifest.revision),
            datum: manifest.map(|manifest| manifest.datum.to_string()),
            reference: reference.map(|reference| reference.to_string()),
            provenance: names.map(ToString::to_string).collect(),
            // A holder may have chunks that are newer than the newest manifest.
            chunk_count: manifest.map(|manifest| {
                let mut chunks = manifest.chunks.clone();
                chunks.unite(&self.held);
                chunks.count()
            }),
            held_count: manifest.map(|_| self.held.count()),
            holders: self.holders.iter().cloned().collect(),
            bounding_box_m: manifest
                .and_then(|manifest| manifest.bounding_box)
                .map(|area| {
                    let (min, max) = (area.min_m(), area.max_m());
                    [min.x, min.y, min.z, max.x, max.y, max.z]
                }),
            received_count: self.chunks.len(),
            point_count,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use protocol::{Reference, encode};

    use super::*;
    use crate::test_support::{manifest, map, vehicle};

    #[test]
    fn a_registered_map_is_listed_as_what_it_is() {
        let mut registered = manifest(map(), 1);
        registered.map.anchor = vehicle("drone1");
        registered.reference = Reference::Registered;
        registered.provenance = vec![vehicle("ugv1")];
        let mut collection = Collection::default();
        for manifest in [manifest(map(), 1), registered] {
            collection.take(&Reply {
                key: Key::Manifest(manifest.map.anchor.clone()).to_string(),
                payload: Arc::from(encode(&manifest)),
            });
        }
        let (summaries, _) = collection.summarise();
        let listed = summaries.iter().map(|one| {
            let reference = one.reference.as_deref();
            (one.anchor.as_str(), reference, one.provenance.clone())
        });
        let expected = [
            ("drone1", Some("registered"), vec!["ugv1".to_owned()]),
            ("ugv1", Some("fixed"), Vec::new()),
        ];
        assert_eq!(listed.collect::<Vec<_>>(), expected);
    }
}

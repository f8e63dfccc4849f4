//! What anchors publish comes in here: chunks, and where they and their maps stand.

use geometry::{Chunk, Enu, Map, Matrix7, Similarity};

use super::Localizer;
use super::anchor::Anchor;
use super::landmarks::AnchorPlacement;
use super::types::{AnchorIdx, ChunkIdx, ChunkIntake, Landmark, OwnerIdx, Reference};

/// Anchors and epochs at most; more are refused.
const ANCHOR_COUNT_MAX: usize = 256;
impl Localizer {
    /// Adds an anchor's chunk; landmarks with impossible numbers are left out and counted.
    ///
    /// A chunk is used once it and its anchor are placed. Inserting it again replaces it.
    pub fn insert_chunk(
        &mut self,
        anchor: AnchorIdx,
        chunk: ChunkIdx,
        landmarks: Vec<Landmark>,
    ) -> ChunkIntake {
        let offered_count = landmarks.len();
        let missed = self.newest_missed();
        let intake = match self.anchor_mut(anchor) {
            Some(anchor) => {
                let intake = anchor.landmarks.insert_chunk(chunk, landmarks);
                anchor.try_against(chunk, missed);
                intake
            }
            None => ChunkIntake {
                accepted_count: 0,
                refused_count: offered_count,
            },
        };
        if intake.accepted_count == 0 || intake.refused_count > 0 {
            self.refused_input_count += 1;
        }
        intake
    }

    /// States where a chunk stands in its anchor's map.
    pub fn place_chunk(
        &mut self,
        anchor: AnchorIdx,
        chunk: ChunkIdx,
        map_from_chunk: Similarity<Map, Chunk>,
    ) {
        self.place_chunks(anchor, [(chunk, map_from_chunk)]);
    }

    /// States where chunks stand in their anchor's map; those that did not move cost nothing.
    pub fn place_chunks(
        &mut self,
        anchor: AnchorIdx,
        placements: impl IntoIterator<Item = (ChunkIdx, Similarity<Map, Chunk>)>,
    ) {
        let settings = self.settings.clone();
        let missed = self.newest_missed();
        let (mut moved, mut moved_track) = (false, false);
        for (chunk, map_from_chunk) in placements {
            let Some(anchor) = self.anchor_mut(anchor) else {
                self.refused_input_count += 1;
                continue;
            };
            let known = anchor.landmarks.placed(chunk);
            if known == Some(&map_from_chunk.relabel()) {
                continue;
            }
            let is_new = known.is_none();
            if !anchor.landmarks.place_chunk(chunk, &map_from_chunk) {
                self.refused_input_count += 1;
                continue;
            }
            if is_new {
                anchor.try_against(chunk, missed.clone());
            }
            moved = true;
            moved_track |= anchor.track.rests_on(chunk);
        }
        if let Some(anchor) = self.anchors.get_mut(&anchor)
            && moved_track
        {
            anchor.track.refresh(&anchor.landmarks, &settings);
        }
        if moved {
            self.fuse_votes();
        }
    }

    /// States whose map an anchor's is, and how it came to its place; until then every map has an
    /// owner of its own and rests on fixes.
    pub fn set_reference(&mut self, anchor: AnchorIdx, owner: OwnerIdx, reference: Reference) {
        let Some(anchor) = self.anchor_mut(anchor) else {
            return;
        };
        if (anchor.owner, anchor.reference) != (owner, reference) {
            (anchor.owner, anchor.reference) = (owner, reference);
            self.fuse_votes();
        }
    }

    /// States where an anchor's map stands on the Earth; revisions older than the known one are
    /// ignored.
    pub fn place_anchor(
        &mut self,
        anchor: AnchorIdx,
        enu_from_map: Similarity<Enu, Map>,
        covariance: Matrix7,
        revision: u64,
    ) {
        let placement = AnchorPlacement {
            enu_from_map: enu_from_map.relabel(),
            covariance,
            revision,
        };
        let placed = self
            .anchor_mut(anchor)
            .is_some_and(|anchor| anchor.landmarks.place(placement));
        self.refused_input_count += u64::from(!placed);
        self.fuse_votes();
    }

    pub fn remove_chunk(&mut self, anchor: AnchorIdx, chunk: ChunkIdx) {
        let settings = &self.settings;
        if let Some(anchor) = self.anchors.get_mut(&anchor) {
            anchor.landmarks.remove_chunk(chunk);
            if anchor.track.rests_on(chunk) {
                anchor.track.refresh(&anchor.landmarks, settings);
            }
        }
        self.fuse_votes();
    }

    pub fn remove_anchor(&mut self, anchor: AnchorIdx) {
        self.anchors.remove(&anchor);
        self.fuse_votes();
    }

    fn anchor_mut(&mut self, anchor: AnchorIdx) -> Option<&mut Anchor> {
        let full = self.anchors.len() >= ANCHOR_COUNT_MAX && !self.anchors.contains_key(&anchor);
        (!full).then(|| {
            let entry = self.anchors.entry(anchor);
            entry.or_insert_with(|| Anchor::new(OwnerIdx(anchor.0)))
        })
    }
}

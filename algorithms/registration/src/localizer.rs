//! Gives a growing monocular map its place in the global frame.
//!
//! Each own keyframe is located among the landmarks of each anchor (2D–3D, with the scale from
//! 3D–3D pairs). What was located is kept relative to the anchor's chunk, so that a new placement
//! moves it along, and a filter over the recent keyframes turns it into `enu_from_map`.

mod estimate;
mod types;

use std::collections::BTreeMap;

use geometry::{Chunk, Enu, Map, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::Vector3;

pub use estimate::Estimate;
pub use types::{
    AlignmentReport, AnchorIdx, AnchorReport, ChunkIdx, ChunkIntake, KeyframeIdx,
    KeyframeObservation, Landmark, LocalizerSettings, ObservedFeature, ObservedPoint, Refusal,
    Verdict,
};

/// The incremental alignment of one vehicle's map to the anchors' maps.
pub struct Localizer {
    settings: LocalizerSettings,
    chunk_count: BTreeMap<AnchorIdx, usize>,
}

impl Localizer {
    pub fn new(settings: LocalizerSettings) -> Self {
        Self {
            settings,
            chunk_count: BTreeMap::new(),
        }
    }

    pub fn settings(&self) -> &LocalizerSettings {
        &self.settings
    }

    /// Adds an anchor's chunk; landmarks with impossible numbers are left out and counted.
    ///
    /// A chunk is used once it and its anchor are placed. Inserting it again replaces it.
    pub fn insert_chunk(
        &mut self,
        anchor: AnchorIdx,
        _chunk: ChunkIdx,
        landmarks: Vec<Landmark>,
    ) -> ChunkIntake {
        *self.chunk_count.entry(anchor).or_default() += 1;
        ChunkIntake {
            accepted_count: landmarks.len(),
            refused_count: 0,
        }
    }

    /// States where a chunk stands in its anchor's map.
    pub fn place_chunk(
        &mut self,
        _anchor: AnchorIdx,
        _chunk: ChunkIdx,
        _map_from_chunk: Similarity<Map, Chunk>,
    ) {
    }

    /// States where an anchor's map stands on the Earth; revisions older than the known one are
    /// ignored.
    pub fn place_anchor(
        &mut self,
        _anchor: AnchorIdx,
        _enu_from_map: Similarity<Enu, Map>,
        _covariance: Matrix7,
        _revision: u64,
    ) {
    }

    pub fn remove_chunk(&mut self, _anchor: AnchorIdx, _chunk: ChunkIdx) {}

    pub fn remove_anchor(&mut self, anchor: AnchorIdx) {
        self.chunk_count.remove(&anchor);
    }

    /// Locates a new own keyframe among the landmarks.
    pub fn observe_keyframe(&mut self, _keyframe: &KeyframeObservation) -> AlignmentReport {
        AlignmentReport {
            verdict: Verdict::Refused(Refusal::NoLandmarks),
            anchors: Vec::new(),
            jumped: false,
        }
    }

    /// States that the own map's optimisation has moved a keyframe.
    pub fn keyframe_moved(
        &mut self,
        _keyframe: KeyframeIdx,
        _map_from_camera: &Transform<Map, geometry::Camera>,
    ) {
    }

    /// Forgets all that was aligned, because the own map has started anew. Landmarks stay.
    pub fn forget_map(&mut self) {}

    /// The place of the own map, once enough keyframes agree.
    pub fn estimate(&self, _now: Timestamp) -> Option<Estimate> {
        None
    }

    /// How many landmarks are usable: of placed chunks of placed anchors.
    pub fn landmark_count(&self) -> usize {
        0
    }

    /// The landmarks of an anchor in the global frame, for display and export.
    pub fn landmarks_in_enu(&self, _anchor: AnchorIdx) -> Vec<Vector3<f64>> {
        Vec::new()
    }
}

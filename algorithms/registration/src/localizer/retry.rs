//! Keyframes that found no place when they came, tried against chunks that come after them.

use geometry::{Camera, Map, Transform};

use super::Localizer;
use super::anchor::{Anchor, hint};
use super::locate::Hint;
use super::matching::FeatureIndex;
use super::types::{
    AlignmentReport, AnchorIdx, AnchorReport, ChunkIdx, KeyframeIdx, KeyframeObservation,
};

/// Keyframes that are remembered: some 2 MB. The oldest goes first.
const MISSED_COUNT_MAX: usize = 12;
/// Of those, the newest that are tried when chunks come.
const RETRY_COUNT: usize = 4;

/// A keyframe that no anchor with a vote has located.
#[derive(Debug)]
pub(super) struct Missed {
    /// As it was when it came: what it saw fits its pose of then.
    keyframe: KeyframeObservation,
    /// Where it is now.
    map_from_camera: Transform<Map, Camera>,
    /// By how much lengths about it have grown since.
    growth: f64,
}

impl Missed {
    pub fn id(&self) -> KeyframeIdx {
        self.keyframe.id
    }

    pub fn follow(&mut self, keyframe: KeyframeIdx, map_from_camera: &Transform<Map, Camera>) {
        if self.keyframe.id == keyframe {
            self.map_from_camera = *map_from_camera;
        }
    }

    pub fn stretch(&mut self, keyframe: KeyframeIdx, factor: f64) {
        if self.keyframe.id == keyframe {
            self.growth *= factor;
        }
    }

    /// The observation in the own map as it is now.
    fn now(&self) -> KeyframeObservation {
        let camera_from_map = self.keyframe.map_from_camera.inverse();
        let turn = self.map_from_camera.rotation_matrix() * camera_from_map.rotation_matrix();
        let mut now = self.keyframe.clone();
        now.map_from_camera = self.map_from_camera;
        for point in now.features.iter_mut().filter_map(|one| one.point.as_mut()) {
            let in_camera = camera_from_map * point.point_in_map;
            point.point_in_map = self.map_from_camera * (in_camera * self.growth);
            let grown = point.covariance_in_map * self.growth * self.growth;
            point.covariance_in_map = turn * grown * turn.transpose();
        }
        now
    }
}

impl Anchor {
    /// Has these keyframes tried, first of all against this chunk.
    pub(super) fn try_against(&mut self, chunk: ChunkIdx, missed: Vec<KeyframeIdx>) {
        if self.landmarks.placed(chunk).is_none() || missed.is_empty() {
            return;
        }
        if self.retries.is_empty() {
            self.search_cursor = chunk;
        }
        self.retries = missed;
    }
}

impl Localizer {
    /// Tries one keyframe that was not located against chunks that came after it; `None` if none
    /// waits for that. For moments without a new keyframe: it costs about as much as one.
    pub fn retry(&mut self) -> Option<AlignmentReport> {
        loop {
            let usable = |anchor: &&mut Anchor| anchor.is_usable() && !anchor.retries.is_empty();
            let mut waiting = self.anchors.iter_mut().map(|(idx, anchor)| (*idx, anchor));
            let (idx, anchor) = waiting.find(|(_, anchor)| usable(anchor))?;
            let id = anchor.retries.pop()?;
            if anchor.track.holds(id) {
                continue;
            }
            let missed = self.missed.iter().find(|missed| missed.id() == id);
            let Some(keyframe) = missed.map(Missed::now) else {
                continue;
            };
            let report = self.try_again(idx, &keyframe)?;
            if self.is_located_by_fixed(std::slice::from_ref(&report)) {
                self.missed.retain(|missed| missed.id() != id);
            }
            return Some(self.conclude(vec![report]));
        }
    }

    fn try_again(
        &mut self,
        idx: AnchorIdx,
        keyframe: &KeyframeObservation,
    ) -> Option<AnchorReport> {
        let features = FeatureIndex::new(&keyframe.features)?;
        let anchor = self.anchors.get_mut(&idx)?;
        let miss_count = anchor.track.miss_count;
        let hint = match anchor.track.state() {
            Some(_) => hint(anchor, self.fused.as_ref(), keyframe, &self.settings),
            None => Hint::Nowhere {
                cursor: anchor.search_cursor,
            },
        };
        let attempt = (keyframe, &features);
        let report = anchor.try_keyframe(idx, attempt, hint, &self.settings, &mut self.rng);
        // What an earlier keyframe does not see says nothing about the newest.
        anchor.track.miss_count = anchor.track.miss_count.min(miss_count);
        Some(report)
    }

    pub(super) fn remember_missed(&mut self, keyframe: &KeyframeObservation) {
        if self.missed.len() == MISSED_COUNT_MAX {
            self.missed.pop_front();
        }
        self.missed.push_back(Missed {
            keyframe: keyframe.clone(),
            map_from_camera: keyframe.map_from_camera,
            growth: 1.0,
        });
    }

    /// The newest last.
    pub(super) fn newest_missed(&self) -> Vec<KeyframeIdx> {
        let first = self.missed.len().saturating_sub(RETRY_COUNT);
        self.missed.range(first..).map(Missed::id).collect()
    }
}

//! Without a position source: the own map is registered to what the anchors published.

use std::collections::BTreeMap;

use features::Descriptor;
use geodesy::{Datum, enu_from_enu};
use geometry::{Enu, Map, Similarity, Timestamp};
use nalgebra::Vector3;
use protocol::{Chunk, MapId, Placement, PlacementPage};
use registration::localizer::{Refusal, Verdict};
use registration::{
    AnchorIdx, ChunkIdx, Estimate, KeyframeIdx, KeyframeObservation, Landmark, Localizer,
    LocalizerSettings, ObservedFeature, ObservedPoint,
};
use vslam::{FrameReport, Keyframe, KeyframeId, MappingReport, VslamMap};

use crate::files::StampedPose;

use super::handover::Handover;
use super::places::{Place, Places};

/// The incremental alignment of the own map to the anchors' maps, by their names on the wire.
pub struct PeerRole {
    pub(super) localizer: Localizer,
    pub(super) handover: Handover,
    anchors: BTreeMap<MapId, AnchorIdx>,
    /// What this vehicle's ENU is relative to: the datum of the first anchor that was placed.
    datum: Option<Datum>,
    /// The least stated sigma of a fix of any anchor (m).
    fix_sigma_m: Option<f64>,
    own_map: Option<vslam::MapId>,
    map_revision: u64,
    /// [`Keyframe::unit`] of the own keyframes when they were last looked at.
    units: BTreeMap<KeyframeId, f64>,
    last_verdict: Option<Verdict>,
    /// Why the newest single frame was not located, if one was looked at.
    pub(super) frame_verdict: Option<Verdict>,
    datum_refusal: Option<String>,
    chunk_count: usize,
}

impl PeerRole {
    pub fn new(seed: u64) -> Self {
        Self {
            localizer: Localizer::new(LocalizerSettings {
                seed,
                ..LocalizerSettings::default()
            }),
            handover: Handover::default(),
            anchors: BTreeMap::new(),
            datum: None,
            fix_sigma_m: None,
            own_map: None,
            map_revision: 0,
            units: BTreeMap::new(),
            last_verdict: None,
            frame_verdict: None,
            datum_refusal: None,
            chunk_count: 0,
        }
    }

    pub fn take_chunk(&mut self, chunk: &Chunk, page: Option<&PlacementPage>) {
        let anchor = self.anchor_idx(&chunk.id().map);
        let idx = ChunkIdx(u64::from(chunk.id().number.0));
        let camera = chunk.header().camera;
        let landmarks = chunk.points().map(|point| Landmark {
            covariance_in_chunk: point.covariance_in_chunk(&camera),
            point_in_chunk: point.position_in_chunk,
            descriptor: Descriptor::from_bytes(point.descriptor),
        });
        let intake = self
            .localizer
            .insert_chunk(anchor, idx, landmarks.collect());
        if intake.refused_count > 0 {
            tracing::warn!(
                "left out {} of {} points that cannot be: chunk {}",
                intake.refused_count,
                intake.refused_count + intake.accepted_count,
                chunk.id(),
            );
        }
        self.chunk_count += 1;
        let placed = page
            .into_iter()
            .flat_map(PlacementPage::placements)
            .find(|placed| placed.number == chunk.id().number);
        if let Some(placed) = placed {
            self.localizer
                .place_chunk(anchor, idx, placed.map_from_chunk);
        }
        for replaced in &chunk.header().replaces {
            let replaced = ChunkIdx(u64::from(replaced.0));
            self.localizer.remove_chunk(anchor, replaced);
        }
    }

    pub fn take_page(&mut self, page: &PlacementPage) {
        let anchor = self.anchor_idx(page.map());
        for placed in page.placements() {
            let chunk = ChunkIdx(u64::from(placed.number.0));
            self.localizer
                .place_chunk(anchor, chunk, placed.map_from_chunk);
        }
    }

    /// Takes where an anchor's map stands, in this vehicle's own datum.
    pub fn take_placement(&mut self, placement: &Placement) {
        let datum = self.datum.get_or_insert_with(|| placement.datum.clone());
        let own_from_theirs = match enu_from_enu(datum, &placement.datum, &[]) {
            Ok(own_from_theirs) => own_from_theirs,
            Err(error) => {
                self.datum_refusal = Some(format!("{} left out: {error}", placement.map.anchor));
                return;
            }
        };
        let least = self.fix_sigma_m.unwrap_or(f64::INFINITY);
        self.fix_sigma_m = Some(least.min(placement.fix_sigma_m));
        let anchor = self.anchor_idx(&placement.map);
        self.localizer.place_anchor(
            anchor,
            own_from_theirs * placement.enu_from_map,
            placement.covariance,
            u64::from(placement.revision),
        );
    }

    /// Poses are in this map from now on.
    pub fn enter_map(&mut self, map_id: vslam::MapId) {
        if self.own_map.is_some_and(|known| known != map_id) {
            self.localizer.forget_map();
            self.units.clear();
            self.last_verdict = None;
        }
        self.own_map = Some(map_id);
    }

    /// Follows the own map, and registers a new keyframe, unless its frame has no pose of its own
    /// and was only followed by directions.
    pub fn follow_map(&mut self, (report, mapped): (&FrameReport, &MappingReport), map: &VslamMap) {
        let corrected = self.map_revision != mapped.map_revision;
        let new_keyframe = mapped.new_keyframe.and_then(|id| map.keyframe(id));
        if corrected {
            self.map_revision = mapped.map_revision;
            self.follow_stretches(map);
        }
        if corrected || new_keyframe.is_some() {
            self.units = map.keyframes().map(|one| (one.id(), one.unit())).collect();
            let poses = map.keyframes();
            let poses = poses.map(|known| (keyframe_idx(known.id()), known.map_from_camera()));
            self.localizer.keyframes_moved(poses);
        }
        let Some(keyframe) = new_keyframe.filter(|_| report.map_from_camera.is_some()) else {
            return;
        };
        let alignment = self.localizer.observe_keyframe(&observe(keyframe, map));
        self.last_verdict = Some(alignment.verdict);
    }

    /// A loop closure changes the scale of the own map, and with it what alignments said of it.
    fn follow_stretches(&mut self, map: &VslamMap) {
        for keyframe in map.keyframes() {
            if let Some(unit) = self.units.get(&keyframe.id()) {
                let factor = keyframe.unit() / unit;
                let idx = keyframe_idx(keyframe.id());
                self.localizer.keyframe_stretched(idx, factor);
            }
        }
    }

    pub fn estimate(&self, now: Timestamp) -> Option<Estimate> {
        self.localizer.estimate(now)
    }

    pub fn enu_from_map(&self, now: Timestamp) -> Option<Similarity<Enu, Map>> {
        Some(self.localizer.estimate(now)?.enu_from_map)
    }

    /// Where the own map stood at each keyframe that was located.
    pub(super) fn places(&self, map: &VslamMap) -> Places {
        let keyframes = map.keyframes();
        let keyframes = keyframes.map(|one| (keyframe_idx(one.id()), one.map_from_camera()));
        let corrected = self.localizer.corrected_keyframes(&keyframes.collect());
        Places::new(corrected.into_iter().map(|one| Place {
            captured_at: one.captured_at,
            map_from_camera: one.map_from_camera,
            enu_from_map: one.enu_from_map,
            covariance: one.covariance,
            drift_per_way: one.drift_per_way,
        }))
    }

    /// Where the cameras of single frames were, by all that is known now.
    pub fn located_frames(&self) -> impl Iterator<Item = StampedPose<Enu>> {
        let frames = self.localizer.located_frames();
        frames.map(|(captured_at, target_from_camera)| StampedPose {
            captured_at,
            target_from_camera,
        })
    }

    pub fn datum(&self) -> Option<&Datum> {
        self.datum.as_ref()
    }

    pub fn fix_sigma_m(&self) -> Option<f64> {
        self.fix_sigma_m
    }

    /// Why there is no estimate.
    pub fn reason(&self) -> String {
        if let Some(refusal) = &self.datum_refusal {
            return refusal.clone();
        }
        if self.anchors.is_empty() {
            return "no anchor heard yet".to_owned();
        }
        if self.datum.is_none() {
            return "no anchor that was heard knows where it is yet".to_owned();
        }
        if self.chunk_count == 0 {
            return "no chunk received yet".to_owned();
        }
        match self.last_verdict.or(self.frame_verdict) {
            None => "no keyframe since the chunks came".to_owned(),
            Some(Verdict::Refused(Refusal::NoLandmarks)) => "no chunk is placed yet".to_owned(),
            Some(verdict) => format!("no chunk matches: {verdict}"),
        }
    }

    /// The anchors that an estimate rests on, by name.
    pub fn names(&self, anchors: &[AnchorIdx]) -> String {
        let names = self.anchors.iter();
        let names = names.filter(|(_, idx)| anchors.contains(idx));
        let names: Vec<String> = names.map(|(map, _)| map.anchor.to_string()).collect();
        names.join(", ")
    }

    pub fn landmarks_in_enu(&self) -> Vec<Vector3<f64>> {
        let anchors = self.anchors.values();
        anchors
            .flat_map(|anchor| self.localizer.landmarks_in_enu(*anchor))
            .collect()
    }

    fn anchor_idx(&mut self, map: &MapId) -> AnchorIdx {
        let next = AnchorIdx(u32::try_from(self.anchors.len()).unwrap_or(u32::MAX));
        *self.anchors.entry(map.clone()).or_insert(next)
    }
}

fn keyframe_idx(id: KeyframeId) -> KeyframeIdx {
    KeyframeIdx(u64::from(id.0))
}

fn observe(keyframe: &Keyframe, map: &VslamMap) -> KeyframeObservation {
    let features = keyframe.observations().iter().map(|observation| {
        let point = observation.point.and_then(|id| map.point(id));
        let point = point.filter(|point| point.has_range());
        ObservedFeature {
            position: observation.position,
            sigma: observation.sigma,
            descriptor: observation.descriptor,
            point: point.map(|point| ObservedPoint {
                point_in_map: *point.position_in_map(),
                covariance_in_map: *point.covariance_in_map(),
            }),
        }
    });
    KeyframeObservation {
        id: keyframe_idx(keyframe.id()),
        captured_at: keyframe.captured_at(),
        map_from_camera: keyframe.map_from_camera(),
        features: features.collect(),
    }
}

//! Gives a growing monocular map its place in the global frame.
//!
//! Each own keyframe is located among the landmarks of each anchor (2D–3D, with the scale from
//! depths that both maps know). What was located is kept relative to the anchor's chunk, so that
//! a new placement moves it along, and a filter over the recent keyframes turns it into
//! `enu_from_map`. What a keyframe costs does not depend on how large the maps are.

mod anchor;
mod chunk_grid;
mod estimate;
mod fusion;
mod history;
mod image_grid;
mod intake;
mod landmarks;
mod locate;
mod matching;
mod retry;
mod single_frames;
mod testimony;
#[cfg(test)]
mod tests;
mod track;
mod types;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use geometry::{Camera, Map, Similarity, Timestamp, Transform};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use anchor::{Anchor, hint};
use fusion::{Fused, Vote, disagreement, fuse};
use locate::Hint;
use matching::FeatureIndex;
use retry::Missed;
use single_frames::SingleFrames;
use track::Track;

pub use estimate::Estimate;
pub use history::{CorrectedKeyframe, KeyframePoses};
pub use single_frames::{FrameLocation, FrameObservation, NearPose};
pub use types::{
    AlignmentReport, AnchorIdx, AnchorReport, ChunkIdx, ChunkIntake, Contradiction, DriftRates,
    ErrorFloor, KeyframeIdx, KeyframeObservation, Landmark, LocalizerSettings, ObservedFeature,
    ObservedPoint, OwnerIdx, Reference, Refusal, Verdict,
};

/// Anchors that are searched as a whole for one keyframe, in turn; the others wait for the next.
const SEARCHES_PER_KEYFRAME: usize = 2;

/// The incremental alignment of one vehicle's map to the anchors' maps.
///
/// Deterministic: the same calls in the same order give the same estimates.
pub struct Localizer {
    settings: LocalizerSettings,
    anchors: BTreeMap<AnchorIdx, Anchor>,
    fused: Option<Fused>,
    /// The anchors that an estimate in an own map that was left had contradicted.
    distrusted: BTreeSet<AnchorIdx>,
    single_frames: SingleFrames,
    /// The newest own keyframe.
    newest: Option<(KeyframeIdx, Transform<Map, Camera>)>,
    /// Keyframes from before the first alignment, to be located after all.
    early: VecDeque<KeyframeObservation>,
    /// Keyframes that no anchor with a vote has located, to be tried against chunks that come.
    missed: VecDeque<Missed>,
    /// The anchor that is searched first.
    search_turn: AnchorIdx,
    accepted_count: u64,
    jump_count: u64,
    overruled_count: u64,
    refused_input_count: u64,
    rng: ChaCha8Rng,
    /// Frames draw apart, so that keyframes are located alike with and without them.
    frame_rng: ChaCha8Rng,
}

impl Localizer {
    pub fn new(settings: LocalizerSettings) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(settings.seed),
            frame_rng: ChaCha8Rng::seed_from_u64(!settings.seed),
            settings,
            anchors: BTreeMap::new(),
            fused: None,
            distrusted: BTreeSet::new(),
            single_frames: SingleFrames::default(),
            newest: None,
            early: VecDeque::new(),
            missed: VecDeque::new(),
            search_turn: AnchorIdx(0),
            accepted_count: 0,
            jump_count: 0,
            overruled_count: 0,
            refused_input_count: 0,
        }
    }

    pub fn settings(&self) -> &LocalizerSettings {
        &self.settings
    }

    /// Locates a new own keyframe among the landmarks of every anchor.
    pub fn observe_keyframe(&mut self, keyframe: &KeyframeObservation) -> AlignmentReport {
        let usable = keyframe
            .map_from_camera
            .to_matrix()
            .iter()
            .all(|one| one.is_finite());
        let Some(features) = FeatureIndex::new(&keyframe.features).filter(|_| usable) else {
            self.refused_input_count += 1;
            return AlignmentReport::refused(Refusal::BadInput);
        };
        self.newest = Some((keyframe.id, keyframe.map_from_camera));
        let reports = self.locate_everywhere(keyframe, &features);
        if self.fused.is_none() {
            self.remember_early(keyframe);
        }
        if !self.is_located_by_fixed(&reports) {
            self.remember_missed(keyframe);
        }
        self.conclude(reports)
    }

    /// Tries the anchors with a vote, and where none of them knows the place, the others.
    fn locate_everywhere(
        &mut self,
        keyframe: &KeyframeObservation,
        features: &FeatureIndex,
    ) -> Vec<AnchorReport> {
        let mut reports: Vec<AnchorReport> = Vec::new();
        for reference in [Reference::Fixed, Reference::Registered] {
            // Each kind has its own, so that maps out of sight do not starve the other kind.
            let mut search_count = 0;
            if reports.iter().any(|one| one.verdict == Verdict::Accepted) {
                break;
            }
            let after = self.anchors.range(self.search_turn..);
            let before = self.anchors.range(..self.search_turn);
            let in_turn: Vec<AnchorIdx> = after.chain(before).map(|(idx, _)| *idx).collect();
            for idx in in_turn {
                let Some(anchor) = self.anchors.get_mut(&idx) else {
                    continue;
                };
                if anchor.reference != reference || !anchor.is_usable() {
                    continue;
                }
                let hint = hint(anchor, self.fused.as_ref(), keyframe, &self.settings);
                if matches!(hint, Hint::Nowhere { .. }) {
                    if search_count == SEARCHES_PER_KEYFRAME {
                        continue;
                    }
                    search_count += 1;
                    self.search_turn = AnchorIdx(idx.0.saturating_add(1));
                }
                let attempt = (keyframe, features);
                reports.push(anchor.try_keyframe(
                    idx,
                    attempt,
                    hint,
                    &self.settings,
                    &mut self.rng,
                ));
            }
        }
        reports.sort_by_key(|report| report.anchor);
        reports
    }

    /// Lets the anchors vote on what was located.
    fn conclude(&mut self, reports: Vec<AnchorReport>) -> AlignmentReport {
        let verdict = best_verdict(&reports);
        self.accepted_count += u64::from(verdict == Verdict::Accepted);
        let overruled = reports.iter().any(|report| report.overruled);
        let revoked = reports.iter().any(|report| report.revoked);
        self.overruled_count += u64::from(overruled || revoked);
        for report in reports.iter().filter(|report| report.revoked) {
            self.single_frames.leave(report.anchor);
        }
        AlignmentReport {
            verdict,
            anchors: reports,
            jumped: self.fuse_votes(),
            overruled,
            revoked,
        }
    }

    fn is_located_by_fixed(&self, reports: &[AnchorReport]) -> bool {
        reports.iter().any(|report| {
            let anchor = self.anchors.get(&report.anchor);
            report.verdict == Verdict::Accepted
                && anchor.is_some_and(|anchor| anchor.reference == Reference::Fixed)
        })
    }

    /// The keyframes whose moves matter here; there are never many.
    pub fn tied_keyframes(&self) -> BTreeSet<KeyframeIdx> {
        let tracks = self
            .anchors
            .values()
            .flat_map(|anchor| anchor.track.keyframes());
        let missed = self.missed.iter().map(Missed::id);
        let newest = self.newest.iter().map(|(id, _)| *id);
        tracks.chain(missed).chain(newest).collect()
    }

    /// States that the own map's optimisation has moved a keyframe.
    pub fn keyframe_moved(
        &mut self,
        keyframe: KeyframeIdx,
        map_from_camera: &Transform<Map, Camera>,
    ) {
        self.keyframes_moved([(keyframe, *map_from_camera)]);
    }

    /// States where keyframes of the own map are after an optimisation; those that are not in
    /// the window, or did not move, cost nothing.
    pub fn keyframes_moved(
        &mut self,
        keyframes: impl IntoIterator<Item = (KeyframeIdx, Transform<Map, Camera>)>,
    ) {
        let mut moved = false;
        for (keyframe, map_from_camera) in keyframes {
            if !map_from_camera
                .to_matrix()
                .iter()
                .all(|one| one.is_finite())
            {
                self.refused_input_count += 1;
                continue;
            }
            if let Some((newest, pose)) = &mut self.newest
                && *newest == keyframe
            {
                moved |= *pose != map_from_camera;
                *pose = map_from_camera;
            }
            for missed in &mut self.missed {
                missed.follow(keyframe, &map_from_camera);
            }
            for anchor in self.anchors.values_mut() {
                moved |= anchor.track.move_keyframe(keyframe, &map_from_camera);
            }
        }
        if !moved {
            return;
        }
        for anchor in self.anchors.values_mut() {
            anchor.track.refresh(&anchor.landmarks, &self.settings);
        }
        self.fuse_votes();
    }

    /// States that lengths of the own map around a keyframe grew by this factor, as by a loop
    /// closure. Say so before [`Localizer::keyframes_moved`], which brings the estimate up to date.
    pub fn keyframe_stretched(&mut self, keyframe: KeyframeIdx, factor: f64) {
        if !(factor.is_finite() && factor > 0.0) {
            self.refused_input_count += 1;
            return;
        }
        for missed in &mut self.missed {
            missed.stretch(keyframe, factor);
        }
        for anchor in self.anchors.values_mut() {
            anchor.track.stretch_keyframe(keyframe, factor);
        }
    }

    /// Forgets all that was aligned, because the own map has started anew. Landmarks stay.
    pub fn forget_map(&mut self) {
        for anchor in self.anchors.values_mut() {
            anchor.track = Track::default();
            anchor.retries.clear();
        }
        if let Some(fused) = self.fused.take() {
            self.distrusted = fused.left_out.iter().map(|one| one.anchor).collect();
        }
        self.newest = None;
        self.early.clear();
        self.missed.clear();
        self.accepted_count = 0;
    }

    /// The place of the own map, once enough keyframes agree.
    pub fn estimate(&self, now: Timestamp) -> Option<Estimate> {
        let fused = self.fused.as_ref()?;
        let tracks = fused
            .anchors
            .iter()
            .filter_map(|idx| Some(&self.anchors.get(idx)?.track));
        let captured_at = tracks
            .clone()
            .filter_map(|track| Some(track.newest()?.captured_at))
            .max()?;
        let state = tracks.filter_map(Track::state).next()?;
        let map_from_camera = &fused.map_from_camera;
        // S exp(δ) B = S B exp(Ad(B⁻¹) δ).
        let map_from_camera_adjoint = Similarity::from(*map_from_camera).adjoint();
        Some(Estimate {
            enu_from_map: fused.enu_from_camera * map_from_camera.inverse(),
            covariance: map_from_camera_adjoint
                * fused.covariance
                * map_from_camera_adjoint.transpose(),
            captured_at,
            age_s: now.since(captured_at).as_secs_f64(),
            map_from_keyframe: *map_from_camera,
            depth_in_map: state.depth,
            accepted_count: self.accepted_count,
            anchors: fused.anchors.clone(),
            reference: fused.reference,
            left_out: fused.left_out.clone(),
            conflict: fused.conflict,
            drift: self.settings.drift,
        })
    }

    /// How often the estimate changed by more than its uncertainty explained, in all maps so far.
    pub fn jump_count(&self) -> u64 {
        self.jump_count
    }

    /// How often keyframes that agreed with each other replaced a wrong alignment.
    pub fn overruled_count(&self) -> u64 {
        self.overruled_count
    }

    /// How many landmarks are usable: of placed chunks of placed anchors.
    pub fn landmark_count(&self) -> usize {
        let usable = self.anchors.values().filter(|anchor| anchor.is_usable());
        usable.map(|anchor| anchor.landmarks.landmark_count()).sum()
    }

    /// The landmarks of an anchor in the global frame, for display and export.
    pub fn landmarks_in_enu(&self, anchor: AnchorIdx) -> Vec<Vector3<f64>> {
        let Some(landmarks) = self.anchors.get(&anchor).map(|anchor| &anchor.landmarks) else {
            return Vec::new();
        };
        let Some(placement) = landmarks.placement() else {
            return Vec::new();
        };
        let chunks = landmarks.placed_chunks();
        chunks
            .flat_map(|(_, chunk)| chunk.placed())
            .map(|landmark| placement.enu_from_map * landmark.point)
            .collect()
    }

    /// Calls that brought impossible numbers, and were ignored in whole or in part.
    pub fn refused_input_count(&self) -> u64 {
        self.refused_input_count
    }

    /// Lets the anchors vote anew; whether the estimate has jumped.
    fn fuse_votes(&mut self) -> bool {
        let Some((_, map_from_camera)) = self.newest else {
            return false;
        };
        let votes: Vec<Vote> = self
            .anchors
            .iter()
            .filter(|(_, anchor)| anchor.reference != Reference::Circular)
            .filter_map(|(idx, anchor)| {
                let state = anchor.track.state()?;
                let placement = anchor.landmarks.placement()?;
                Some(Vote::new(
                    anchor.voter(*idx),
                    state,
                    placement,
                    &map_from_camera,
                    &self.settings,
                ))
            })
            .collect();
        let before = self.fused.take();
        let trusted = before
            .as_ref()
            .map_or(&[][..], |before| &before.trusted[..]);
        self.fused = fuse(&votes, trusted, &map_from_camera, &self.settings);
        if self.fused.is_some() {
            self.distrusted.clear();
        }
        let jumped = match (&before, &self.fused) {
            (Some(before), Some(after)) => has_jumped(before, after, &self.settings),
            _ => false,
        };
        self.jump_count += u64::from(jumped);
        jumped
    }
}

fn has_jumped(before: &Fused, after: &Fused, settings: &LocalizerSettings) -> bool {
    let way = before.map_from_camera.inverse() * after.map_from_camera;
    let adjoint = Similarity::from(way.inverse()).adjoint();
    let expected = before.enu_from_camera * way;
    let difference = (expected.inverse() * after.enu_from_camera).log();
    let covariance =
        adjoint * before.covariance_of_votes * adjoint.transpose() + after.covariance_of_votes;
    disagreement(&difference, &covariance) > settings.anchor_disagreement_max
}

/// The best of what the anchors say: one that accepts suffices.
fn best_verdict(reports: &[AnchorReport]) -> Verdict {
    let rank = |verdict: &Verdict| match verdict {
        Verdict::Accepted => 2,
        Verdict::Unconfirmed => 1,
        Verdict::Refused(_) => 0,
    };
    let mut best = Verdict::Refused(Refusal::NoLandmarks);
    let mut best_rank = -1;
    for report in reports {
        if rank(&report.verdict) > best_rank {
            best = report.verdict;
            best_rank = rank(&report.verdict);
        }
    }
    best
}

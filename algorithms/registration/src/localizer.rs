//! Gives a growing monocular map its place in the global frame.
//!
//! Each own keyframe is located among the landmarks of each anchor (2D–3D, with the scale from
//! depths that both maps know). What was located is kept relative to the anchor's chunk, so that
//! a new placement moves it along, and a filter over the recent keyframes turns it into
//! `enu_from_map`.

mod estimate;
mod fusion;
mod history;
mod landmarks;
mod locate;
mod matching;
mod single_frames;
mod testimony;
#[cfg(test)]
mod tests;
mod track;
mod types;

use std::collections::{BTreeMap, VecDeque};

use geometry::{Camera, Chunk, Enu, Map, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use fusion::{Fused, Vote, disagreement, fuse};
use landmarks::{AnchorLandmarks, AnchorMap, AnchorPlacement};
use locate::{Attempt, Effort, Hint, Located};
use matching::FeatureIndex;
use single_frames::SingleFrames;
use track::{Admission, Entry, Track};

pub use estimate::Estimate;
pub use history::{CorrectedKeyframe, KeyframePoses};
pub use single_frames::{FrameLocation, FrameObservation, NearPose};
pub use types::{
    AlignmentReport, AnchorIdx, AnchorReport, ChunkIdx, ChunkIntake, DriftRates, ErrorFloor,
    KeyframeIdx, KeyframeObservation, Landmark, LocalizerSettings, ObservedFeature, ObservedPoint,
    Refusal, Verdict,
};

/// Anchors and epochs at most; more are refused.
const ANCHOR_COUNT_MAX: usize = 64;
/// After this many keyframes in a row that were not located near the prediction, all landmarks
/// are searched, every second keyframe.
const MISSES_BEFORE_SEARCH: usize = 3;
/// An anchor that was never matched is searched in every so many keyframes, once others say where
/// the camera is; in between it is looked at where they say.
const SEARCH_INTERVAL: usize = 4;

/// The incremental alignment of one vehicle's map to the anchors' maps.
///
/// Deterministic: the same calls in the same order give the same estimates.
pub struct Localizer {
    settings: LocalizerSettings,
    anchors: BTreeMap<AnchorIdx, Anchor>,
    fused: Option<Fused>,
    single_frames: SingleFrames,
    /// The newest own keyframe.
    newest: Option<(KeyframeIdx, Transform<Map, Camera>)>,
    /// Keyframes from before the first alignment, to be located after all.
    early: VecDeque<KeyframeObservation>,
    accepted_count: u64,
    jump_count: u64,
    refused_input_count: u64,
    rng: ChaCha8Rng,
    /// Frames draw apart, so that keyframes are located alike with and without them.
    frame_rng: ChaCha8Rng,
}

#[derive(Default)]
struct Anchor {
    landmarks: AnchorLandmarks,
    track: Track,
    search_cursor: usize,
}

impl Localizer {
    pub fn new(settings: LocalizerSettings) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(settings.seed),
            frame_rng: ChaCha8Rng::seed_from_u64(!settings.seed),
            settings,
            anchors: BTreeMap::new(),
            fused: None,
            single_frames: SingleFrames::default(),
            newest: None,
            early: VecDeque::new(),
            accepted_count: 0,
            jump_count: 0,
            refused_input_count: 0,
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
        chunk: ChunkIdx,
        landmarks: Vec<Landmark>,
    ) -> ChunkIntake {
        let offered_count = landmarks.len();
        let intake = match self.anchor_mut(anchor) {
            Some(anchor) => anchor.landmarks.insert_chunk(chunk, landmarks),
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
        let known = self
            .anchors
            .get(&anchor)
            .and_then(|anchor| anchor.landmarks.placed(chunk));
        if known == Some(&map_from_chunk.relabel()) {
            return;
        }
        let settings = self.settings.clone();
        let placed = self.anchor_mut(anchor).is_some_and(|anchor| {
            let placed = anchor.landmarks.place_chunk(chunk, &map_from_chunk);
            if anchor.track.rests_on(chunk) {
                anchor.track.refresh(&anchor.landmarks, &settings);
            }
            placed
        });
        self.refused_input_count += u64::from(!placed);
        self.fuse_votes();
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
        let mut reports = Vec::new();
        let fused = self.fused.as_ref();
        for (idx, anchor) in &mut self.anchors {
            if anchor.landmarks.placement().is_none() || anchor.landmarks.landmark_count() == 0 {
                continue;
            }
            let attempt = Attempt {
                observed: &keyframe.features,
                features: &features,
                map_from_camera: Some(keyframe.map_from_camera),
                anchor: &anchor.landmarks,
                settings: &self.settings,
            };
            let mut hint = hint(anchor, fused, keyframe, &self.settings);
            let mut effort = Effort::default();
            let located = attempt.locate(&mut hint, &mut effort, &mut self.rng);
            if let Hint::Nowhere { cursor } = hint {
                anchor.search_cursor = cursor;
            }
            let verdict = anchor.admit(located, (keyframe, &features), &self.settings);
            reports.push(AnchorReport {
                anchor: *idx,
                verdict,
                candidate_count: effort.candidate_count,
                match_count: effort.match_count,
                inlier_count: effort.inlier_count,
                evenness: anchor.track.evenness,
            });
        }
        if self.fused.is_none() {
            self.remember_early(keyframe);
        }
        let verdict = best_verdict(&reports);
        self.accepted_count += u64::from(verdict == Verdict::Accepted);
        AlignmentReport {
            verdict,
            anchors: reports,
            jumped: self.fuse_votes(),
        }
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
        for anchor in self.anchors.values_mut() {
            anchor.track.stretch_keyframe(keyframe, factor);
        }
    }

    /// Forgets all that was aligned, because the own map has started anew. Landmarks stay.
    pub fn forget_map(&mut self) {
        for anchor in self.anchors.values_mut() {
            anchor.track = Track::default();
        }
        self.fused = None;
        self.newest = None;
        self.early.clear();
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
            jump_count: self.jump_count,
            anchors: fused.anchors.clone(),
            inconsistent_anchors: fused.inconsistent_anchors.clone(),
            conflict: fused.conflict,
            drift: self.settings.drift,
        })
    }

    /// How many landmarks are usable: of placed chunks of placed anchors.
    pub fn landmark_count(&self) -> usize {
        let placed = self.anchors.values().map(|anchor| &anchor.landmarks);
        placed
            .filter(|landmarks| landmarks.placement().is_some())
            .map(AnchorLandmarks::landmark_count)
            .sum()
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

    fn anchor_mut(&mut self, anchor: AnchorIdx) -> Option<&mut Anchor> {
        let full = self.anchors.len() >= ANCHOR_COUNT_MAX && !self.anchors.contains_key(&anchor);
        (!full).then(|| self.anchors.entry(anchor).or_default())
    }

    /// Lets the anchors vote anew; whether the estimate has jumped.
    fn fuse_votes(&mut self) -> bool {
        let Some((_, map_from_camera)) = self.newest else {
            return false;
        };
        let votes: Vec<Vote> = self
            .anchors
            .iter()
            .filter_map(|(idx, anchor)| {
                let state = anchor.track.state()?;
                let placement = anchor.landmarks.placement()?;
                Some(Vote::new(
                    *idx,
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
            .map_or(&[][..], |before| &before.anchors[..]);
        self.fused = fuse(&votes, trusted, &map_from_camera, &self.settings);
        let jumped = match (&before, &self.fused) {
            (Some(before), Some(after)) => has_jumped(before, after, &self.settings),
            _ => false,
        };
        self.jump_count += u64::from(jumped);
        jumped
    }
}

impl Anchor {
    /// Hands a located keyframe to the track.
    fn admit(
        &mut self,
        located: Result<Located, Refusal>,
        (keyframe, features): (&KeyframeObservation, &FeatureIndex),
        settings: &LocalizerSettings,
    ) -> Verdict {
        let located = match located {
            Ok(located) => located,
            Err(refusal) => {
                self.track.miss_count += 1;
                return Verdict::Refused(refusal);
            }
        };
        if !located.scale_known && self.track.state().is_none() {
            return Verdict::Refused(Refusal::NoScale);
        }
        let entry = Entry {
            keyframe: keyframe.id,
            captured_at: keyframe.captured_at,
            map_from_camera: keyframe.map_from_camera,
            located,
            witnesses: Vec::new(),
        };
        match self.track.admit(entry, features, &self.landmarks, settings) {
            Admission::Agrees | Admission::Founds => Verdict::Accepted,
            Admission::Waits => Verdict::Unconfirmed,
        }
    }
}

/// Where an anchor's landmarks are expected: by its own track, else by what the others say.
/// Now and then nothing is expected, so that a wrong track, or a wrong anchor, is found out.
fn hint(
    anchor: &Anchor,
    fused: Option<&Fused>,
    keyframe: &KeyframeObservation,
    settings: &LocalizerSettings,
) -> Hint {
    let nowhere = Hint::Nowhere {
        cursor: anchor.search_cursor,
    };
    let miss_count = anchor.track.miss_count;
    let pose_of = |anchor_from_camera: Similarity<AnchorMap, Camera>| {
        anchor_from_camera.rigid_part().inverse()
    };
    let Some(state) = anchor.track.state() else {
        let (Some(fused), Some(placement)) = (fused, anchor.landmarks.placement()) else {
            return nowhere;
        };
        if miss_count.is_multiple_of(SEARCH_INTERVAL) {
            return nowhere;
        }
        let way = fused.map_from_camera.inverse() * keyframe.map_from_camera;
        let enu_from_camera = fused.enu_from_camera * way;
        return Hint::Predicted {
            camera_from_anchor: pose_of(placement.enu_from_map.inverse() * enu_from_camera),
            radius: settings.predicted_radius_max,
        };
    };
    if miss_count >= MISSES_BEFORE_SEARCH && miss_count.is_multiple_of(2) {
        return nowhere;
    }
    let state = state.predicted(&keyframe.map_from_camera, &settings.drift);
    let covariance = state.scaled_covariance();
    let variance = |first: usize| (0..3).map(move |axis| covariance[(first + axis, first + axis)]);
    let rotation_sigma = variance(0).fold(0.0, f64::max).sqrt();
    let translation_sigma = variance(3).fold(0.0, f64::max).sqrt() / state.depth;
    let radius = settings.predicted_radius_min + 3.0 * (rotation_sigma + translation_sigma);
    Hint::Predicted {
        camera_from_anchor: pose_of(state.anchor_from_camera),
        radius: radius.min(settings.predicted_radius_max),
    }
}

fn has_jumped(before: &Fused, after: &Fused, settings: &LocalizerSettings) -> bool {
    let way = before.map_from_camera.inverse() * after.map_from_camera;
    let adjoint = Similarity::from(way.inverse()).adjoint();
    let expected = before.enu_from_camera * way;
    let difference = (expected.inverse() * after.enu_from_camera).log();
    let covariance = adjoint * before.covariance * adjoint.transpose() + after.covariance;
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

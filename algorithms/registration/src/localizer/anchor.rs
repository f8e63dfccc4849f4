//! One anchor: its landmarks, and the track of the own map among them.

use geometry::{Camera, Similarity};
use rand_chacha::ChaCha8Rng;

use super::fusion::{Fused, Voter};
use super::landmarks::{AnchorLandmarks, AnchorMap};
use super::locate::{Attempt, Effort, Hint, Located};
use super::matching::FeatureIndex;
use super::track::{Admission, Entry, Track};
use super::types::{
    AnchorIdx, AnchorReport, ChunkIdx, KeyframeIdx, KeyframeObservation, LocalizerSettings,
    OwnerIdx, Reference, Refusal, Verdict,
};

/// After this many keyframes in a row that were not located near the prediction, all landmarks
/// are searched, every second keyframe.
const MISSES_BEFORE_SEARCH: usize = 3;
/// An anchor that was never matched is searched in every so many keyframes, once others say where
/// the camera is; in between it is looked at where they say.
const SEARCH_INTERVAL: usize = 4;
pub(super) struct Anchor {
    pub owner: OwnerIdx,
    pub reference: Reference,
    pub landmarks: AnchorLandmarks,
    pub track: Track,
    pub search_cursor: ChunkIdx,
    /// Keyframes that are still to be tried against what came, the newest last.
    pub retries: Vec<KeyframeIdx>,
}

impl Anchor {
    pub fn new(owner: OwnerIdx) -> Self {
        Self {
            owner,
            reference: Reference::default(),
            landmarks: AnchorLandmarks::default(),
            track: Track::default(),
            search_cursor: ChunkIdx(0),
            retries: Vec::new(),
        }
    }

    pub fn voter(&self, idx: AnchorIdx) -> Voter {
        (idx, self.owner, self.reference)
    }

    pub fn is_usable(&self) -> bool {
        self.reference != Reference::Circular
            && self.landmarks.placement().is_some()
            && self.landmarks.landmark_count() > 0
    }

    /// Locates a keyframe where the hint says, and hands it to the track.
    pub fn try_keyframe(
        &mut self,
        idx: AnchorIdx,
        (keyframe, features): (&KeyframeObservation, &FeatureIndex),
        mut hint: Hint,
        settings: &LocalizerSettings,
        rng: &mut ChaCha8Rng,
    ) -> AnchorReport {
        let attempt = Attempt {
            observed: &keyframe.features,
            features,
            map_from_camera: Some(keyframe.map_from_camera),
            anchor: &self.landmarks,
            settings,
        };
        let mut effort = Effort::default();
        let located = attempt.locate(&mut hint, &mut effort, rng);
        if let Hint::Nowhere { cursor } = hint {
            self.search_cursor = cursor;
        }
        let had_track = self.track.state().is_some();
        let (verdict, admission) = self.admit(located, (keyframe, features), settings);
        AnchorReport {
            anchor: idx,
            verdict,
            overruled: had_track && admission == Some(Admission::Founds),
            revoked: admission == Some(Admission::Revokes),
            chunk_count: effort.chunk_count,
            candidate_count: effort.candidate_count,
            match_count: effort.match_count,
            inlier_count: effort.inlier_count,
            likeness: self.track.likeness,
        }
    }

    /// Hands a located keyframe to the track.
    fn admit(
        &mut self,
        located: Result<Located, Refusal>,
        (keyframe, features): (&KeyframeObservation, &FeatureIndex),
        settings: &LocalizerSettings,
    ) -> (Verdict, Option<Admission>) {
        let located = match located {
            Ok(located) => located,
            Err(refusal) => {
                self.track.miss_count += 1;
                return (Verdict::Refused(refusal), None);
            }
        };
        if !located.scale_known && self.track.state().is_none() {
            return (Verdict::Refused(Refusal::NoScale), None);
        }
        let entry = Entry {
            keyframe: keyframe.id,
            captured_at: keyframe.captured_at,
            map_from_camera: keyframe.map_from_camera,
            located,
            testimony: None,
        };
        let admission = self
            .track
            .admit(entry, (keyframe, features), &self.landmarks, settings);
        let verdict = match admission {
            Admission::Agrees | Admission::Founds => Verdict::Accepted,
            Admission::Waits => Verdict::Unconfirmed,
            Admission::Doubts => Verdict::Refused(Refusal::FewWitnesses),
            Admission::Denies | Admission::Revokes => Verdict::Refused(Refusal::Contradicted),
        };
        (verdict, Some(admission))
    }
}

/// Where an anchor's landmarks are expected: by its own track, else by what the others say.
/// Now and then nothing is expected, so that a wrong track, or a wrong anchor, is found out.
pub(super) fn hint(
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

//! The places of past keyframes after all corrections, by what came before and after them.
//!
//! A Rauch–Tung–Striebel smoother over the same steps as the filter of [`super::track`], along the
//! own map as it is now and the anchor's chunks as they are placed now.

use std::collections::{BTreeMap, VecDeque};

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Timestamp, Transform};
use rand_chacha::ChaCha8Rng;

use super::Localizer;
use super::anchor::Anchor;
use super::fusion::{Vote, past_place};
use super::landmarks::AnchorLandmarks;
use super::locate::{Attempt, Effort, Hint, Located};
use super::matching::FeatureIndex;
use super::track::{Entry, State, Step, drift_covariance, first_state};
use super::types::{AnchorIdx, KeyframeIdx, KeyframeObservation, LocalizerSettings};

/// Keyframes from before the first alignment that are remembered: some 10 MB.
const EARLY_COUNT_MAX: usize = 64;

/// Where a keyframe of the own map stands by the best knowledge for its time.
#[derive(Clone, Copy, Debug)]
pub struct CorrectedKeyframe {
    pub keyframe: KeyframeIdx,
    pub captured_at: Timestamp,
    pub map_from_camera: Transform<Map, Camera>,
    /// Holds near this keyframe.
    pub enu_from_map: Similarity<Enu, Map>,
    /// Over `[ω; ν; ln s]` in the camera's axes and the map's unit.
    pub covariance: Matrix7,
    /// What drift adds to it on each unit of the way to another camera.
    pub drift_per_way: Matrix7,
}

/// Where the keyframes of the own map stand.
pub type KeyframePoses = BTreeMap<KeyframeIdx, Transform<Map, Camera>>;

/// Keyframes in the order of time.
type KeyframeTime = (Timestamp, KeyframeIdx);

impl Localizer {
    /// The keyframes that were located, in the order of time.
    ///
    /// - `keyframes`: where those that still exist stand in the own map now; others are left out.
    pub fn corrected_keyframes(&self, keyframes: &KeyframePoses) -> Vec<CorrectedKeyframe> {
        self.corrected(keyframes, true)
    }

    /// The same without those from before the first alignment, which would have to be located.
    pub fn placed_keyframes(&self, keyframes: &KeyframePoses) -> Vec<CorrectedKeyframe> {
        self.corrected(keyframes, false)
    }

    fn corrected(&self, keyframes: &KeyframePoses, with_early: bool) -> Vec<CorrectedKeyframe> {
        if self.fused.is_none() {
            return Vec::new();
        }
        let mut votes: BTreeMap<KeyframeTime, Vec<(Vote, f64)>> = BTreeMap::new();
        for idx in self.believed_anchors() {
            for (time, vote) in self.past_votes(idx, keyframes, with_early) {
                votes.entry(time).or_default().push(vote);
            }
        }
        let corrected = votes
            .into_iter()
            .filter_map(|((captured_at, keyframe), list)| {
                let map_from_camera = keyframes.get(&keyframe)?;
                let votes: Vec<Vote> = list.iter().map(|(vote, _)| *vote).collect();
                let (enu_from_camera, covariance) = past_place(&votes)?;
                let (_, depth) = list.first()?;
                Some(CorrectedKeyframe {
                    keyframe,
                    captured_at,
                    map_from_camera: *map_from_camera,
                    enu_from_map: enu_from_camera * map_from_camera.inverse(),
                    covariance,
                    drift_per_way: drift_covariance(&self.settings.drift, *depth, 1.0),
                })
            });
        corrected.collect()
    }

    /// All that can be used and do not contradict the estimate.
    pub(super) fn believed_anchors(&self) -> Vec<AnchorIdx> {
        let fused = self.fused.as_ref();
        let left_out = fused.map_or(&[][..], |fused| &fused.left_out[..]);
        let is_left_out = |idx: &AnchorIdx| {
            self.distrusted.contains(idx) || left_out.iter().any(|one| one.anchor == *idx)
        };
        let usable = self.anchors.iter().filter(|(_, anchor)| anchor.is_usable());
        let believed = usable.map(|(idx, _)| *idx);
        believed.filter(|idx| !is_left_out(idx)).collect()
    }

    /// Anchors that some place of the own map, now or in hindsight, may rest on.
    pub fn aligned_anchors(&self) -> Vec<AnchorIdx> {
        let is_aligned = |idx: &AnchorIdx| {
            let anchor = self.anchors.get(idx);
            anchor.is_some_and(|anchor| anchor.track.newest().is_some())
        };
        self.believed_anchors()
            .into_iter()
            .filter(is_aligned)
            .collect()
    }

    pub(super) fn remember_early(&mut self, keyframe: &KeyframeObservation) {
        if self.early.len() == EARLY_COUNT_MAX {
            self.early.pop_front();
        }
        self.early.push_back(keyframe.clone());
    }

    /// The entries of an anchor's track along the own map as it is now, the oldest first; what
    /// came before the first of them is located among the landmarks that came since.
    fn entries_now(
        &self,
        anchor: &Anchor,
        keyframes: &KeyframePoses,
        with_early: bool,
    ) -> VecDeque<Entry> {
        let mut entries: VecDeque<Entry> = anchor
            .track
            .history()
            .filter_map(|entry| {
                let map_from_camera = *keyframes.get(&entry.keyframe)?;
                Some(Entry {
                    map_from_camera,
                    ..entry.clone()
                })
            })
            .collect();
        if !with_early {
            return entries;
        }
        let oldest = smooth(&entries, &anchor.landmarks, &self.settings);
        let Some(mut state) = oldest.first().map(|(_, state)| *state) else {
            return entries;
        };
        // Looking back must not change what is drawn in flight.
        let mut rng = self.rng.clone();
        let first = entries.front().map(|entry| entry.keyframe);
        let earlier = self.early.iter().rev();
        for keyframe in earlier.filter(|keyframe| Some(keyframe.id) < first) {
            let Some(map_from_camera) = keyframes.get(&keyframe.id) else {
                continue;
            };
            let expected = state.predicted(map_from_camera, &self.settings.drift);
            let located = anchor.locate_near(&expected, keyframe, &self.settings, &mut rng);
            let Some(located) = located.filter(|located| located.scale_known) else {
                continue;
            };
            let entry = Entry {
                keyframe: keyframe.id,
                captured_at: keyframe.captured_at,
                map_from_camera: *map_from_camera,
                located,
                testimony: None,
            };
            let step = Step::new(&state, &entry, &anchor.landmarks, &self.settings);
            if let Some(step) = step
                && step.disagreement < self.settings.disagreement_max
            {
                state = step.updated;
                entries.push_front(entry);
            }
        }
        entries
    }

    /// What an anchor says about each keyframe, and the depth of the scene there.
    fn past_votes(
        &self,
        idx: AnchorIdx,
        keyframes: &KeyframePoses,
        with_early: bool,
    ) -> Vec<(KeyframeTime, (Vote, f64))> {
        let anchor = self.anchors.get(&idx);
        let placed = anchor.and_then(|anchor| Some((anchor, anchor.landmarks.placement()?)));
        let Some((anchor, placement)) = placed else {
            return Vec::new();
        };
        let entries = self.entries_now(anchor, keyframes, with_early);
        let smoothed = smooth(&entries, &anchor.landmarks, &self.settings);
        let vote = |(time, state): (KeyframeTime, State)| {
            let pose = &state.map_from_camera;
            let voter = anchor.voter(idx);
            let vote = Vote::new(voter, &state, placement, pose, &self.settings);
            (time, (vote, state.depth))
        };
        smoothed.into_iter().map(vote).collect()
    }
}

impl Anchor {
    fn locate_near(
        &self,
        expected: &State,
        keyframe: &KeyframeObservation,
        settings: &LocalizerSettings,
        rng: &mut ChaCha8Rng,
    ) -> Option<Located> {
        let features = FeatureIndex::new(&keyframe.features)?;
        let attempt = Attempt {
            observed: &keyframe.features,
            features: &features,
            map_from_camera: Some(keyframe.map_from_camera),
            anchor: &self.landmarks,
            settings,
        };
        let mut hint = Hint::Predicted {
            camera_from_anchor: expected.anchor_from_camera.rigid_part().inverse(),
            radius: settings.predicted_radius_max,
        };
        let located = attempt.locate(&mut hint, &mut Effort::default(), rng);
        located.ok()
    }
}

/// The states at the entries that give one, each from all of them.
fn smooth(
    entries: &VecDeque<Entry>,
    anchor: &AnchorLandmarks,
    settings: &LocalizerSettings,
) -> Vec<(KeyframeTime, State)> {
    // Where the filter was after each keyframe, and where it had expected to be.
    let mut passed: Vec<(KeyframeTime, State)> = Vec::new();
    let mut expected: Vec<State> = Vec::new();
    for entry in entries {
        let step = match passed.last() {
            None => first_state(entry, anchor, settings).map(|first| (first, first)),
            Some((_, before)) => Step::new(before, entry, anchor, settings)
                .map(|step| (step.predicted, step.updated)),
        };
        if let Some((predicted, updated)) = step {
            passed.push(((entry.captured_at, entry.keyframe), updated));
            expected.push(predicted);
        }
    }
    for idx in (1..passed.len()).rev() {
        let after = passed[idx].1;
        let (_, state) = &mut passed[idx - 1];
        if let Some(smoothed) = smoothed(state, &expected[idx], &after) {
            *state = smoothed;
        }
    }
    passed
}

/// `x ⊞ G log(x̂'⁻¹ x')` with `G = P Fᵀ P̂'⁻¹`, where the next state was expected at `x̂'` and is
/// smoothed to `x'`.
fn smoothed(state: &State, expected: &State, after: &State) -> Option<State> {
    let way = state.map_from_camera.inverse() * after.map_from_camera;
    let transition = Similarity::from(way.inverse()).adjoint();
    let inverse: Matrix7 = expected.covariance.cholesky()?.inverse();
    let gain = state.covariance * transition.transpose() * inverse;
    let correction = (expected.anchor_from_camera.inverse() * after.anchor_from_camera).log();
    let covariance =
        state.covariance + gain * (after.covariance - expected.covariance) * gain.transpose();
    Some(State {
        anchor_from_camera: state.anchor_from_camera.perturbed(&(gain * correction)),
        covariance: (covariance + covariance.transpose()) * 0.5,
        ..*state
    })
}

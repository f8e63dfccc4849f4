//! A camera without a map of its own, located frame by frame.
//!
//! The first place is believed when frames that were searched for one by one agree on it and show
//! what should be in view from there; from then on each frame is looked for near the last one.

use std::collections::{BTreeMap, VecDeque};

use geometry::{Camera, Chunk, Enu, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::{Matrix6, Vector6};

use super::Localizer;
use super::anchor::Anchor;
use super::estimate::in_global_axes;
use super::landmarks::{AnchorLandmarks, AnchorMap};
use super::locate::{Attempt, Effort, Hint, Located};
use super::matching::{FeatureIndex, coverage, match_predicted};
use super::types::{
    AnchorIdx, ChunkIdx, LocalizerSettings, ObservedFeature, Reference, Refusal, Verdict,
};

/// All landmarks are searched at most every so often: a search costs about 20 ms.
const SEARCH_INTERVAL_S: f64 = 0.19;
/// Anchors that are asked for one frame whether it is where something else says; the others wait
/// for the next.
const NEAR_ANCHORS_PER_FRAME: usize = 2;
/// Frames that were searched for and agree, and their inliers together, before the first place.
const FIRST_FRAME_COUNT: usize = 3;
const FIRST_INLIER_COUNT: usize = 75;
/// A located frame waits so long for others to agree.
const WAITING_S: f64 = 2.0;
/// So long a place is looked for near where it was last; then it is one of those that agree.
const FOLLOWED_S: f64 = 0.5;
/// A camera moves at most so fast: radians, and shares of the scene's depth, a second.
const TURN_RATE_MAX_RAD_PER_S: f64 = 3.0;
const WAY_RATE_MAX_PER_S: f64 = 1.5;
/// The share of the cells with expected landmarks in which some must be matched, and how many.
const CONFIRMED_SHARE_MIN: f64 = 0.55;
const CONFIRMED_COUNT_MIN: usize = 6;
/// So much of a predicted motion is taken to be wrong, and so much more may come in a second.
const MOTION_DOUBT: f64 = 0.5;
const MOTION_DOUBT_PER_S: f64 = 0.5;
/// Believed frames that are remembered: half an hour at 20 Hz.
const PAST_COUNT_MAX: usize = 36_000;

/// A frame of a camera whose pose in the own map is not known.
#[derive(Clone, Debug)]
pub struct FrameObservation {
    pub captured_at: Timestamp,
    /// Points of the own map in them are not looked at.
    pub features: Vec<ObservedFeature>,
}

/// Where a camera was a moment ago.
#[derive(Clone, Copy, Debug)]
pub struct NearPose {
    pub captured_at: Timestamp,
    pub enu_from_camera: Transform<Enu, Camera>,
}

/// Where a single frame's camera is.
#[derive(Clone, Copy, Debug)]
pub struct FrameLocation {
    pub enu_from_camera: Transform<Enu, Camera>,
    /// `[ω; p]`, the rotation vector (rad) and the position (m) in the axes of the global frame,
    /// with the error of the anchor's georeference.
    pub covariance: Matrix6<f64>,
    /// Median depth of the scene (m).
    pub depth_m: f64,
    pub anchor: AnchorIdx,
    pub inlier_count: usize,
}

/// What is known from frame to frame.
#[derive(Default)]
pub(super) struct SingleFrames {
    followed: Option<Followed>,
    /// Places that wait for others to agree.
    waiting: VecDeque<Place>,
    searched_at: Option<Timestamp>,
    /// What came of it.
    searched: Option<Verdict>,
    /// Which anchor is searched next, and in each where to go on.
    turn: usize,
    /// Which anchor is asked next for a frame that is near where something else says.
    near_turn: usize,
    cursors: BTreeMap<AnchorIdx, ChunkIdx>,
    /// Frames that were believed, the oldest first.
    past: VecDeque<PastFrame>,
}

/// A believed frame, kept relative to a chunk so that new placements move it along.
struct PastFrame {
    captured_at: Timestamp,
    anchor: AnchorIdx,
    chunk: ChunkIdx,
    chunk_from_camera: Similarity<Chunk, Camera>,
}

/// A located frame.
#[derive(Clone, Copy)]
struct Place {
    captured_at: Timestamp,
    anchor: AnchorIdx,
    anchor_from_camera: Transform<AnchorMap, Camera>,
    /// Of the scene, in the anchor's unit.
    depth: f64,
    inlier_count: usize,
}

#[derive(Clone, Copy)]
struct Followed {
    place: Place,
    /// `[ω; ν]` a second in the camera's axes.
    rate: Vector6<f64>,
}

impl Localizer {
    /// Locates the camera of a single frame among the landmarks, without the own map; the verdict
    /// says why it is not located.
    ///
    /// - `near`: where the camera was a moment ago, if something else than single frames says so.
    ///
    /// Frames come in the order of time. Cost: near a known place that of a keyframe or two,
    /// otherwise that of a search at most five times a second.
    pub fn observe_frame(
        &mut self,
        frame: &FrameObservation,
        near: Option<&NearPose>,
    ) -> Result<FrameLocation, Verdict> {
        if self.landmark_count() == 0 {
            return Err(Verdict::Refused(Refusal::NoLandmarks));
        }
        let Some(features) = FeatureIndex::new(&frame.features) else {
            return Err(Verdict::Refused(Refusal::BadInput));
        };
        let image = Image { frame, features };
        let usable = self.usable_anchors();
        self.single_frames.forget_old(frame.captured_at, &usable);
        if self.single_frames.followed.is_some() {
            return self.follow_frame(&image).map_err(Verdict::Refused);
        }
        if let Some(near) = near
            && let Some(location) = self.find_frame_near(&image, near)
        {
            return Ok(location);
        }
        self.search_frame(&image)
    }

    fn follow_frame(&mut self, image: &Image) -> Result<FrameLocation, Refusal> {
        let followed = self.single_frames.followed;
        let followed = followed.expect("the caller has looked");
        let (anchor_from_camera, radius) =
            followed.predicted(image.frame.captured_at, &self.settings);
        let idx = followed.place.anchor;
        let (place, located) = self.locate_frame(image, idx, &anchor_from_camera, radius)?;
        if !place.is_reachable_from(&followed.place) {
            return Err(Refusal::NoConsensus);
        }
        self.believe_frame(place, &located)
    }

    fn find_frame_near(&mut self, image: &Image, near: &NearPose) -> Option<FrameLocation> {
        let radius = self.settings.predicted_radius_max;
        let anchors = self.usable_anchors();
        let first = self.single_frames.near_turn % anchors.len().max(1);
        let in_turn = anchors[first..].iter().chain(&anchors[..first]);
        for idx in in_turn.take(NEAR_ANCHORS_PER_FRAME).copied() {
            self.single_frames.near_turn += 1;
            let placement = self.anchors.get(&idx)?.landmarks.placement()?;
            let anchor_from_enu = placement.enu_from_map.inverse();
            let anchor_from_camera = anchor_from_enu.transform_pose(&near.enu_from_camera);
            let Ok((place, located)) = self.locate_frame(image, idx, &anchor_from_camera, radius)
            else {
                continue;
            };
            let before = Place {
                captured_at: near.captured_at,
                anchor_from_camera,
                ..place
            };
            let anchor = self.anchors.get(&idx)?;
            let covered = image.check_coverage(&place, &anchor.landmarks, &self.settings);
            if covered.is_ok() && place.is_reachable_from(&before) {
                return self.believe_frame(place, &located).ok();
            }
        }
        None
    }

    fn search_frame(&mut self, image: &Image) -> Result<FrameLocation, Verdict> {
        let now = image.frame.captured_at;
        let searched_at = self.single_frames.searched_at;
        if searched_at.is_some_and(|earlier| now - earlier < SEARCH_INTERVAL_S) {
            return Err(self.single_frames.searched.unwrap_or(Verdict::Unconfirmed));
        }
        self.single_frames.searched_at = Some(now);
        let searched = self.search_next_anchor(image);
        self.single_frames.searched = searched.err();
        // Where there is something to confirm, the same anchor is asked again.
        let refused = matches!(searched, Err(Verdict::Refused(_)));
        self.single_frames.turn += usize::from(refused);
        searched
    }

    fn search_next_anchor(&mut self, image: &Image) -> Result<FrameLocation, Verdict> {
        let anchors = self.usable_anchors();
        let idx = anchors
            .get(self.single_frames.turn % anchors.len().max(1))
            .copied()
            .ok_or(Verdict::Refused(Refusal::NoLandmarks))?;
        let found = self.search_anchor(image, idx);
        let (place, located) = found.map_err(Verdict::Refused)?;
        if !self.single_frames.confirm(&place) {
            return Err(Verdict::Unconfirmed);
        }
        self.believe_frame(place, &located)
            .map_err(Verdict::Refused)
    }

    fn search_anchor(
        &mut self,
        image: &Image,
        idx: AnchorIdx,
    ) -> Result<(Place, Located), Refusal> {
        let anchor = self.anchors.get(&idx).ok_or(Refusal::NoLandmarks)?;
        let attempt = image.attempt(anchor, &self.settings);
        let cursor = self.single_frames.cursors.entry(idx);
        let cursor = cursor.or_insert(ChunkIdx(0));
        let mut hint = Hint::Nowhere { cursor: *cursor };
        let located = attempt.locate(&mut hint, &mut Effort::default(), &mut self.frame_rng);
        if let Hint::Nowhere { cursor: next } = hint {
            *cursor = next;
        }
        let located = located?;
        let place = Place::new(&located, image, idx, &anchor.landmarks)?;
        image.check_coverage(&place, &anchor.landmarks, &self.settings)?;
        Ok((place, located))
    }

    fn locate_frame(
        &mut self,
        image: &Image,
        idx: AnchorIdx,
        anchor_from_camera: &Transform<AnchorMap, Camera>,
        radius: f64,
    ) -> Result<(Place, Located), Refusal> {
        let anchor = self.anchors.get(&idx).ok_or(Refusal::NoLandmarks)?;
        let attempt = image.attempt(anchor, &self.settings);
        let mut hint = Hint::Predicted {
            camera_from_anchor: anchor_from_camera.inverse(),
            radius,
        };
        let located = attempt.locate(&mut hint, &mut Effort::default(), &mut self.frame_rng)?;
        let place = Place::new(&located, image, idx, &anchor.landmarks)?;
        Ok((place, located))
    }

    /// Follows the camera from here on.
    fn believe_frame(&mut self, place: Place, located: &Located) -> Result<FrameLocation, Refusal> {
        let location = self.place_frame(located, place.anchor)?;
        let frames = &mut self.single_frames;
        frames.past.push_back(PastFrame {
            captured_at: place.captured_at,
            anchor: place.anchor,
            chunk: located.chunk,
            chunk_from_camera: located.chunk_from_camera,
        });
        if frames.past.len() > PAST_COUNT_MAX {
            frames.past.pop_front();
        }
        frames.follow(place);
        frames.near_turn = 0;
        Ok(location)
    }

    /// Where the cameras of single frames were, by what is known now of their anchors.
    pub fn located_frames(&self) -> impl Iterator<Item = (Timestamp, Transform<Enu, Camera>)> {
        let usable = self.believed_anchors();
        let frames = self.single_frames.past.iter();
        let frames = frames.filter(move |frame| usable.contains(&frame.anchor));
        frames.filter_map(|frame| {
            let landmarks = &self.anchors.get(&frame.anchor)?.landmarks;
            let map_from_chunk = landmarks.map_from_chunk(frame.chunk)?;
            let anchor_from_camera = (*map_from_chunk * frame.chunk_from_camera).rigid_part();
            let enu_from_map = landmarks.placement()?.enu_from_map;
            Some((
                frame.captured_at,
                enu_from_map.transform_pose(&anchor_from_camera),
            ))
        })
    }

    /// What is located, on the Earth; the error of the anchor's georeference enters here.
    fn place_frame(&self, located: &Located, idx: AnchorIdx) -> Result<FrameLocation, Refusal> {
        let anchor = self.anchors.get(&idx).ok_or(Refusal::NoLandmarks)?;
        let landmarks = &anchor.landmarks;
        let placement = landmarks.placement().ok_or(Refusal::NoLandmarks)?;
        let map_from_chunk = landmarks
            .map_from_chunk(located.chunk)
            .ok_or(Refusal::NoLandmarks)?;
        let anchor_from_camera = (*map_from_chunk * located.chunk_from_camera).rigid_part();
        let mut unit = Vector6::repeat(1.0);
        unit.fixed_rows_mut::<3>(3).fill(map_from_chunk.scale());
        let pose_covariance = located.covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let mut covariance = pose_covariance.component_mul(&(unit * unit.transpose()));
        let depth = located.depth * map_from_chunk.scale();
        for floor in [
            &self.settings.keyframe_floor,
            &self.settings.alignment_floor,
        ] {
            covariance += floor.covariance(depth).fixed_view::<6, 6>(0, 0);
        }
        covariance += pose_part(&anchor_from_camera, &placement.covariance);
        let enu_from_camera = placement.enu_from_map.transform_pose(&anchor_from_camera);
        let unit_m = placement.enu_from_map.scale();
        Ok(FrameLocation {
            enu_from_camera,
            covariance: in_global_axes(&covariance, &enu_from_camera, unit_m),
            depth_m: depth * unit_m,
            anchor: idx,
            inlier_count: located.inlier_count,
        })
    }

    /// Anchors that are placed, have landmarks, and are not contradicted by others; those with
    /// fixes of their own first.
    fn usable_anchors(&self) -> Vec<AnchorIdx> {
        let mut usable = self.believed_anchors();
        usable.sort_by_key(|idx| {
            let reference = self.anchors.get(idx).map(|anchor| anchor.reference);
            (reference != Some(Reference::Fixed), *idx)
        });
        usable
    }
}

/// The part of a map's own covariance that moves a camera in it, `[ω; ν]` in the camera's axes.
fn pose_part(
    map_from_camera: &Transform<AnchorMap, Camera>,
    map_covariance: &Matrix7,
) -> Matrix6<f64> {
    // S exp(δ) B = S B exp(Ad(B⁻¹) δ).
    let camera_from_map = Similarity::from(map_from_camera.inverse()).adjoint();
    let covariance = camera_from_map * map_covariance * camera_from_map.transpose();
    covariance.fixed_view::<6, 6>(0, 0).into_owned()
}

/// A frame laid out for matching.
struct Image<'a> {
    frame: &'a FrameObservation,
    features: FeatureIndex,
}

impl Image<'_> {
    fn attempt<'b>(&'b self, anchor: &'b Anchor, settings: &'b LocalizerSettings) -> Attempt<'b> {
        Attempt {
            observed: &self.frame.features,
            features: &self.features,
            map_from_camera: None,
            anchor: &anchor.landmarks,
            settings,
        }
    }

    /// Refuses a place that only looks alike: a poster that hangs twice is seen, and nothing of
    /// what hangs around it.
    fn check_coverage(
        &self,
        place: &Place,
        anchor: &AnchorLandmarks,
        settings: &LocalizerSettings,
    ) -> Result<(), Refusal> {
        let pose = place.anchor_from_camera.inverse();
        let radius = settings.refine_radius;
        let matches = match_predicted(&self.features, anchor, &pose, radius, settings).list;
        let coverage = coverage(&self.features, anchor, &pose, &matches, settings);
        let share = coverage.confirmed_count as f64 / coverage.expected_count.max(1) as f64;
        if share < CONFIRMED_SHARE_MIN || coverage.confirmed_count < CONFIRMED_COUNT_MIN {
            return Err(Refusal::Contradicted);
        }
        Ok(())
    }
}

impl Place {
    fn new(
        located: &Located,
        image: &Image,
        anchor: AnchorIdx,
        landmarks: &AnchorLandmarks,
    ) -> Result<Self, Refusal> {
        let map_from_chunk = landmarks
            .map_from_chunk(located.chunk)
            .ok_or(Refusal::NoLandmarks)?;
        Ok(Self {
            captured_at: image.frame.captured_at,
            anchor,
            anchor_from_camera: (*map_from_chunk * located.chunk_from_camera).rigid_part(),
            depth: located.depth * map_from_chunk.scale(),
            inlier_count: located.inlier_count,
        })
    }

    /// Whether a camera can have come here from an earlier place.
    fn is_reachable_from(&self, earlier: &Self) -> bool {
        let elapsed_s = (self.captured_at - earlier.captured_at).abs();
        let way = earlier.anchor_from_camera.inverse() * self.anchor_from_camera;
        let way_max = self.depth * (0.05 + WAY_RATE_MAX_PER_S * elapsed_s);
        self.anchor == earlier.anchor
            && way.rotation().angle() < 0.05 + TURN_RATE_MAX_RAD_PER_S * elapsed_s
            && way.translation().norm() < way_max
    }
}

impl SingleFrames {
    /// Forgets what says nothing any more at this time, or rests on other anchors than these. A
    /// place that is no longer followed is one of those that wait, for as long as those do.
    fn forget_old(&mut self, now: Timestamp, usable: &[AnchorIdx]) {
        self.followed = self
            .followed
            .filter(|followed| usable.contains(&followed.place.anchor));
        if let Some(followed) = &self.followed
            && now - followed.place.captured_at >= FOLLOWED_S
        {
            self.waiting.push_back(followed.place);
            self.followed = None;
        }
        self.waiting
            .retain(|place| now - place.captured_at < WAITING_S && usable.contains(&place.anchor));
    }

    fn follow(&mut self, place: Place) {
        let before = self.followed.map(|followed| followed.place);
        let before = before.or(self.waiting.back().copied());
        // Not one of another anchor's map, nor a wrong one that waited.
        let before = before.filter(|before| place.is_reachable_from(before));
        let rate = before.map_or(Vector6::zeros(), |before| {
            let way = before.anchor_from_camera.inverse() * place.anchor_from_camera;
            way.log() / (place.captured_at - before.captured_at).max(1e-3)
        });
        self.followed = Some(Followed { place, rate });
        self.waiting.clear();
    }

    /// Forgets where the camera was in an anchor's map, as it turned out to be of another place.
    pub fn leave(&mut self, anchor: AnchorIdx) {
        self.followed = self.followed.filter(|one| one.place.anchor != anchor);
        self.waiting.retain(|place| place.anchor != anchor);
    }

    /// Whether enough places agree with the newest; those that do not are forgotten.
    fn confirm(&mut self, place: &Place) -> bool {
        self.waiting.retain(|other| place.is_reachable_from(other));
        let inlier_counts = self.waiting.iter().chain([place]);
        let inlier_count: usize = inlier_counts.map(|one| one.inlier_count).sum();
        let frame_count = self.waiting.len() + 1;
        let confirmed = frame_count >= FIRST_FRAME_COUNT && inlier_count >= FIRST_INLIER_COUNT;
        if !confirmed {
            self.waiting.push_back(*place);
        }
        confirmed
    }
}

impl Followed {
    /// Where the camera should be, and how far from where it should be a landmark may appear, on
    /// the ideal plane.
    fn predicted(
        &self,
        now: Timestamp,
        settings: &LocalizerSettings,
    ) -> (Transform<AnchorMap, Camera>, f64) {
        let elapsed_s = now - self.place.captured_at;
        let moved = self.rate * elapsed_s;
        let turn = moved.fixed_rows::<3>(0).norm();
        let way = moved.fixed_rows::<3>(3).norm() / self.place.depth;
        let doubt = MOTION_DOUBT * (turn + way) + MOTION_DOUBT_PER_S * elapsed_s;
        (
            self.place.anchor_from_camera.perturbed(&moved),
            (settings.predicted_radius_min + doubt).min(settings.predicted_radius_max),
        )
    }
}

#[cfg(test)]
mod tests;

//! A map of an earlier session: the camera is looked for in it before anything is begun anew.

use camera::CameraModel;
use geometry::Timestamp;

use super::follow::PATIENCE_S;
use super::{Mode, Outcome, Vslam};
use crate::frame::Frame;
use crate::tracking::{INLIERS_MIN, Tracked, TrackedFrame};
use crate::{KeyframeId, LostReason, TrackingState, VslamMap, VslamSettings};

impl Vslam {
    /// Goes on in a map that the same camera made earlier, as [`VslamMap::from_parts`] brings it
    /// back.
    ///
    /// The camera is looked for in all of it. It keeps its id and its frame of reference, and is
    /// kept when the camera is not found there for long and another map is begun beside it.
    pub fn continuing(camera: CameraModel, settings: VslamSettings, mut map: VslamMap) -> Self {
        let keyframes: Vec<KeyframeId> = map.keyframes().map(crate::Keyframe::id).collect();
        for id in keyframes {
            if let Some(keyframe) = map.keyframe_mut(id) {
                keyframe.frame_idx = None;
            }
        }
        let mut slam = Self::new(camera, settings);
        slam.map_count = map.id().0.saturating_add(1);
        map.set_continued();
        slam.places.insert_all(&map);
        slam.mapper.resume();
        slam.map = map;
        slam.mode = Mode::Recalling { since: None };
        slam
    }

    pub(super) fn recall(&mut self, mut frame: Frame, since: Option<Timestamp>) -> Outcome {
        let since = since.unwrap_or(frame.captured_at);
        self.mode = Mode::Recalling { since: Some(since) };
        let forgotten = self.backfill.remember(&frame);
        if let Some(forgotten) = forgotten {
            self.waiting.remember(&forgotten);
        }
        let index = (&self.optics, &self.places);
        let map = &mut self.map;
        let located = self
            .relocaliser
            .locate(index, map, &mut frame, &mut self.rng);
        if let Some(tracked) = located
            && let Some(start) = self.tracked_frame(&frame, &tracked)
        {
            self.backfill.begin(start.clone());
            self.follow_from(start);
            return self.accept(frame, tracked);
        }
        if frame.captured_at - since > PATIENCE_S {
            self.restart();
        }
        let reason = if frame.observations.len() < INLIERS_MIN {
            LostReason::FewKeypoints
        } else {
            LostReason::UnknownPlace
        };
        Outcome::without_pose(TrackingState::Lost { reason })
    }

    fn tracked_frame(&self, frame: &Frame, tracked: &Tracked) -> Option<TrackedFrame> {
        let place = self
            .map
            .place(tracked.reference, &tracked.camera_from_map)?;
        Some(TrackedFrame {
            captured_at: frame.captured_at,
            place,
            observations: frame.observations.clone(),
        })
    }

    /// All maps, the one that frames are tracked in first.
    pub(super) fn maps(&self) -> impl Iterator<Item = &VslamMap> {
        std::iter::once(&self.map).chain(&self.earlier)
    }
}

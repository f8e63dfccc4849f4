//! Where the camera is, frame by frame, in a map that is taken as exact.

mod keyframe_decision;
mod local_map;
mod match_points;
mod predict;
mod refine;

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::Matrix6;
use rand_chacha::ChaCha8Rng;

pub(crate) use keyframe_decision::{KeyframeClock, wants_keyframe};
pub(crate) use local_map::{LocalMap, match_local_map};
pub(crate) use predict::Motion;
pub(crate) use refine::{Whereabouts, refine};

use crate::frame::Frame;
use crate::held::PLACED_MIN;
use crate::map::Place;
use crate::optics::Optics;
use crate::relocalise::locate_near;
use crate::{KeyframeId, LostReason, PointId, VslamMap};

/// Fewer keypoints that agree with the map are no pose.
pub(crate) const INLIERS_MIN: usize = 25;
/// Fewer keypoints that agree with the last frame's points are no start for the local map.
const FIRST_INLIERS_MIN: usize = 12;

/// A pose by few keypoints is a coincidence if the frame misses most of what it should show there.
const FOUND_SHARE_MIN: f64 = 0.2;
const CERTAIN_INLIERS: usize = 50;

/// A frame whose pose is known, and what the next one needs of it.
#[derive(Clone, Debug)]
pub(crate) struct TrackedFrame {
    pub(crate) captured_at: Timestamp,
    pub(crate) place: Place,
    pub(crate) points: Vec<TrackedPoint>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct TrackedPoint {
    pub(crate) id: PointId,
    pub(crate) level: u8,
    pub(crate) angle_rad: f32,
}

/// The pose of a frame in the local map.
#[derive(Clone, Debug)]
pub(crate) struct Tracked {
    pub(crate) camera_from_map: Transform<Camera, Map>,
    /// Unknown for the frame with which a map starts.
    pub(crate) covariance: Option<Matrix6<f64>>,
    pub(crate) inlier_count: usize,
    /// Those of which the map knows the range: they tell where it is.
    pub(crate) ranged_count: usize,
    /// The keyframe that shares most points with the frame.
    pub(crate) reference: KeyframeId,
}

impl Tracked {
    /// Whether it was measured where the camera is. If not, only how it is turned is known, and
    /// its place was carried on from the frames before.
    pub(crate) fn is_placed(&self) -> bool {
        self.ranged_count >= PLACED_MIN
    }
}

/// The points that these observations show.
pub(crate) fn tracked_points(observations: &[crate::Observation]) -> Vec<TrackedPoint> {
    observations
        .iter()
        .filter_map(|one| {
            Some(TrackedPoint {
                id: one.point?,
                level: one.level,
                angle_rad: one.angle_rad,
            })
        })
        .collect()
}

/// Finds the pose of a frame that follows a tracked one.
pub(crate) fn track(
    optics: &Optics,
    map: &mut VslamMap,
    motion: &Motion,
    frame: &mut Frame,
    rng: &mut ChaCha8Rng,
) -> Result<Tracked, LostReason> {
    if frame.observations.len() < INLIERS_MIN {
        return Err(LostReason::FewKeypoints);
    }
    let whereabouts = motion.whereabouts(map, frame.captured_at);
    let first = track_by_motion(optics, map, (motion, whereabouts.as_ref()), frame)
        .or_else(|| locate_near(map, motion.last.place.keyframe, frame, rng))
        .ok_or(LostReason::FewInliers)?;
    let tracked = track_local_map(optics, map, frame, &first, whereabouts.as_ref())?;
    if !tracked.is_placed() && motion.is_adrift(frame.captured_at) {
        return Err(LostReason::OnlyDirections);
    }
    Ok(tracked)
}

/// The pose from the points of the last frame, searched where constant velocity expects them.
fn track_by_motion(
    optics: &Optics,
    map: &VslamMap,
    (motion, whereabouts): (&Motion, Option<&Whereabouts>),
    frame: &mut Frame,
) -> Option<Transform<Camera, Map>> {
    let predicted = motion.predict(map, frame.captured_at)?;
    for window_px in [15.0, 30.0] {
        frame.forget_points();
        match_points::match_last_frame(
            optics,
            map,
            &motion.last.points,
            (&predicted, window_px),
            frame,
        );
        if let Some(fit) = refine(map, &predicted, frame, FIRST_INLIERS_MIN, whereabouts) {
            return Some(fit.camera_from_map);
        }
    }
    frame.forget_points();
    None
}

/// Grows a first pose by all points that should be in view.
pub(crate) fn track_local_map(
    optics: &Optics,
    map: &mut VslamMap,
    frame: &mut Frame,
    first: &Transform<Camera, Map>,
    whereabouts: Option<&Whereabouts>,
) -> Result<Tracked, LostReason> {
    let local = LocalMap::around(map, frame).ok_or(LostReason::FewInliers)?;
    let expected_count = match_local_map(optics, map, &local, first, frame);
    let fit = refine(map, first, frame, INLIERS_MIN, whereabouts).ok_or(LostReason::FewInliers)?;
    let seen = frame
        .observations
        .iter()
        .filter_map(|one| map.point(one.point?));
    let seen_count = seen.filter(|point| point.has_range()).count();
    let doubtful = (seen_count as f64) < FOUND_SHARE_MIN * expected_count as f64;
    if doubtful && fit.inlier_count < CERTAIN_INLIERS {
        return Err(LostReason::FewInliers);
    }
    for point in frame.observations.iter().filter_map(|one| one.point) {
        if let Some(point) = map.point_mut(point) {
            point.found_count += 1;
        }
    }
    let reference = map
        .seen_by(frame.observations.iter().filter_map(|one| one.point))
        .first()
        .map_or(local.reference, |one| one.keyframe);
    Ok(Tracked {
        camera_from_map: fit.camera_from_map,
        covariance: Some(fit.covariance),
        inlier_count: fit.inlier_count,
        ranged_count: seen_count,
        reference,
    })
}

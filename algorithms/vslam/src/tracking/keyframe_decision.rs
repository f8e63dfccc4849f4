//! When a frame becomes a keyframe.

use geometry::Timestamp;

use super::Tracked;
use crate::frame::Frame;
use crate::held::Held;
use crate::optics::Optics;
use crate::{Keyframe, VslamMap};

/// At the latest after this time, if the camera moved.
const INTERVAL_MAX_S: f64 = 1.0;
/// Fewer inliers than this share of what the reference keyframe sees call for a keyframe.
const SHARE_MIN: f64 = 0.8;
/// Fewer than this share, or than this many inliers, call for one wherever the camera is.
const SHARE_URGENT: f64 = 0.5;
const INLIERS_URGENT: usize = 60;
/// So do inliers that are fewer than this share of the keypoints, if the camera moved.
const KEYPOINTS_MIN: f64 = 0.12;
/// And a map that holds less than this share of the image: in a turn what is new must be seen
/// twice before it is all there is.
const HELD_SHARE_MIN: f64 = 0.6;
/// A camera that moved less than this share of the depth since a recent keyframe sees no parallax.
const MOTION_MIN: f64 = 0.02;
/// A turn by one radian counts as much motion as this share of the depth.
const MOTION_PER_RADIAN: f64 = 0.3;
/// Recent keyframes from which the camera must have moved.
const RECENT_KEYFRAMES: usize = 3;

/// What happened since the last keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeyframeClock {
    pub(crate) last_keyframe_at: Timestamp,
}

/// Whether the map should grow by this frame.
pub(crate) fn wants_keyframe(
    (optics, map): (&Optics, &VslamMap),
    clock: &KeyframeClock,
    frame: &Frame,
    tracked: &Tracked,
) -> bool {
    let Some(reference) = map.keyframe(tracked.reference) else {
        return true;
    };
    let share = tracked.ranged_count as f64 / expected_count(map, reference).max(1) as f64;
    if share < SHARE_URGENT || tracked.inlier_count < INLIERS_URGENT {
        return true;
    }
    let overdue = frame.captured_at - clock.last_keyframe_at >= INTERVAL_MAX_S;
    let thin = (tracked.inlier_count as f64) < KEYPOINTS_MIN * frame.observations.len() as f64;
    let turning = Held::by(optics, map, &frame.observations).share() < HELD_SHARE_MIN;
    (share < SHARE_MIN || overdue || thin || turning) && motion(map, tracked) > MOTION_MIN
}

/// Points of the reference keyframe that have proved themselves.
fn expected_count(map: &VslamMap, reference: &Keyframe) -> usize {
    let views_min = if map.keyframe_count() <= 2 { 2 } else { 3 };
    reference
        .points()
        .filter_map(|point| map.point(point))
        .filter(|point| point.has_range() && point.view_count() >= views_min)
        .count()
}

/// How far the camera is from the nearest of the newest keyframes, in depths of what it sees.
fn motion(map: &VslamMap, tracked: &Tracked) -> f64 {
    let depth = map.median_depth(tracked.reference).unwrap_or(1.0);
    map.keyframes()
        .rev()
        .take(RECENT_KEYFRAMES)
        .map(|keyframe| {
            let camera_from_keyframe = tracked.camera_from_map * keyframe.map_from_camera();
            let turn_rad = camera_from_keyframe.rotation().angle();
            camera_from_keyframe.translation().norm() / depth + MOTION_PER_RADIAN * turn_rad
        })
        .fold(f64::INFINITY, f64::min)
}

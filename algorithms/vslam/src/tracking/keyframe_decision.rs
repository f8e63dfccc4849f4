//! When a frame becomes a keyframe.

use geometry::Timestamp;

use super::Tracked;
use crate::VslamMap;
use crate::frame::Frame;

/// At the latest after this time, if the camera moved.
const INTERVAL_MAX_S: f64 = 1.0;
/// Fewer inliers than this share of what the reference keyframe sees call for a keyframe.
const SHARE_MIN: f64 = 0.8;

/// What happened since the last keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeyframeClock {
    pub(crate) last_keyframe_at: Timestamp,
}

/// Whether the map should grow by this frame.
pub(crate) fn wants_keyframe(
    map: &VslamMap,
    clock: &KeyframeClock,
    frame: &Frame,
    tracked: &Tracked,
) -> bool {
    let Some(reference) = map.keyframe(tracked.reference) else {
        return true;
    };
    let views_min = if map.keyframe_count() <= 2 { 2 } else { 3 };
    let reference_count = reference
        .points()
        .filter_map(|point| map.point(point))
        .filter(|point| point.view_count() >= views_min)
        .count();
    let elapsed_s = frame.captured_at - clock.last_keyframe_at;
    let weak = (tracked.inlier_count as f64) < SHARE_MIN * reference_count as f64;
    weak || elapsed_s >= INTERVAL_MAX_S
}

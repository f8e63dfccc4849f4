//! Removes new points that did not prove themselves.

use crate::{KeyframeId, PointId, VslamMap};

/// A point must be found in this share of the frames that should see it.
const FOUND_SHARE_MIN: f64 = 0.25;
/// Keyframes after which a point must have a third view.
const PROBATION_KEYFRAMES: u32 = 2;

/// Looks at the points on probation, as of the newest keyframe; those that pass leave the list.
pub(crate) fn cull(map: &mut VslamMap, recent: &mut Vec<PointId>, newest: KeyframeId) {
    let mut still_recent = Vec::with_capacity(recent.len());
    for &id in recent.iter() {
        let Some(point) = map.point(id) else {
            continue;
        };
        let age = newest.0.saturating_sub(point.made_at.0);
        let found_share = f64::from(point.found_count) / f64::from(point.visible_count.max(1));
        let unproven = age >= PROBATION_KEYFRAMES && point.views.len() <= 2;
        if found_share < FOUND_SHARE_MIN || unproven {
            map.remove_point(id);
        } else if age <= PROBATION_KEYFRAMES {
            still_recent.push(id);
        }
    }
    *recent = still_recent;
}

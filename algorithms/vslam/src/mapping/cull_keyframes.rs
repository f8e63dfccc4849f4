//! Removes keyframes that say nothing that others do not say.

use crate::{Keyframe, KeyframeId, MapPoint, VslamMap};

/// A keyframe goes if this share of its points is seen by three others at least as finely.
const REDUNDANT_SHARE: f64 = 0.9;
/// Other keyframes that must see a point.
const OTHER_VIEWS_MIN: usize = 3;
/// The newest keyframes are kept: the next frames hold on to them.
const NEWEST_KEPT: u32 = 2;
/// With fewer points of known range than this, those of expected range count too.
const RANGED_MIN: usize = 20;
/// Keyframes looked at per insertion.
const CANDIDATES_MAX: usize = 30;

/// Culls redundant keyframes near the newest one.
pub(crate) fn cull(map: &mut VslamMap, newest: KeyframeId) {
    let candidates = map.covisible(newest);
    for candidate in candidates.into_iter().take(CANDIDATES_MAX) {
        let id = candidate.keyframe;
        let young = id.0 + NEWEST_KEPT > newest.0;
        let redundant = map.keyframe(id).is_some_and(|one| is_redundant(map, one));
        if !young && redundant {
            map.remove_keyframe(id);
        }
    }
}

fn is_redundant(map: &VslamMap, keyframe: &Keyframe) -> bool {
    let ranged_count = keyframe
        .points()
        .filter(|point| map.point(*point).is_some_and(MapPoint::has_range))
        .count();
    let all_count = ranged_count < RANGED_MIN;
    let mut point_count = 0;
    let mut redundant_count = 0;
    for observation in &keyframe.observations {
        let Some(point) = observation.point.and_then(|point| map.point(point)) else {
            continue;
        };
        if !all_count && !point.has_range() {
            continue;
        }
        point_count += 1;
        if point.views.len() <= OTHER_VIEWS_MIN {
            continue;
        }
        let as_fine = point
            .views
            .iter()
            .filter(|view| view.keyframe != keyframe.id)
            .filter_map(|view| {
                let other = map.keyframe(view.keyframe)?;
                Some(other.observations[view.observation_idx as usize].level)
            })
            .filter(|level| *level <= observation.level + 1)
            .take(OTHER_VIEWS_MIN)
            .count();
        if as_fine >= OTHER_VIEWS_MIN {
            redundant_count += 1;
        }
    }
    f64::from(redundant_count) > REDUNDANT_SHARE * f64::from(point_count)
}

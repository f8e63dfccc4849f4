//! The part of the map that a frame should see.

use geometry::{Camera, Map, Transform};

use crate::frame::{Frame, Viewpoint};
use crate::optics::{Optics, level_scale};
use crate::search::{Gate, Wanted, find};
use crate::{KeyframeId, MapPoint, Observation, PointId, VslamMap};

/// Keyframes that see the frame's points, at most.
const KEYFRAMES_MAX: usize = 20;
/// Those and their neighbours, at most.
const KEYFRAMES_WITH_NEIGHBOURS_MAX: usize = 40;
/// A point is looked for up to this angle from where it was seen before.
const VIEWING_COSINE_MIN: f64 = 0.5;
/// The window grows by this many standard deviations of an uncertain range.
const BLURS: f64 = 2.0;
const GATE: Gate = Gate {
    distance_max: 80,
    ratio_max: 0.8,
};

/// Keyframes and points near a frame.
#[derive(Clone, Debug)]
pub(crate) struct LocalMap {
    /// The keyframe that sees most of the frame's points.
    pub(crate) reference: KeyframeId,
    /// Those of known range first: they take the keypoints that they fit.
    pub(crate) points: Vec<PointId>,
}

impl LocalMap {
    /// What lies near the points that the frame shows; `None` if it shows none.
    pub(crate) fn around(map: &VslamMap, frame: &Frame) -> Option<Self> {
        let seeing = map.seen_by(frame.observations.iter().filter_map(|one| one.point));
        let reference = seeing.first()?.keyframe;
        let mut keyframes: Vec<KeyframeId> = seeing
            .iter()
            .take(KEYFRAMES_MAX)
            .map(|one| one.keyframe)
            .collect();
        for idx in 0..keyframes.len() {
            let Some(keyframe) = map.keyframe(keyframes[idx]) else {
                continue;
            };
            let is_new = |id: &KeyframeId| !keyframes.contains(id) && map.keyframe(*id).is_some();
            let neighbour = keyframe.neighbours.iter().copied().find(is_new);
            let parent = keyframe
                .parent
                .filter(is_new)
                .filter(|id| Some(*id) != neighbour);
            keyframes.extend(neighbour);
            keyframes.extend(parent);
            if keyframes.len() >= KEYFRAMES_WITH_NEIGHBOURS_MAX {
                break;
            }
        }
        let mut points = map.points_of(&keyframes);
        points.sort_by_key(|point| map.point(*point).is_some_and(|point| !point.has_range()));
        Some(Self { reference, points })
    }
}

/// Names, in `frame`, the points of the local map that it shows at this pose; returns how many of
/// known range it should show.
pub(crate) fn match_local_map(
    optics: &Optics,
    map: &mut VslamMap,
    local: &LocalMap,
    camera_from_map: &Transform<Camera, Map>,
    frame: &mut Frame,
) -> usize {
    let viewpoint = Viewpoint::new(*camera_from_map);
    let mut expected_count = 0;
    let mut matched: Vec<PointId> = frame
        .observations
        .iter()
        .filter_map(|one| one.point)
        .collect();
    matched.sort_unstable();
    for &id in &local.points {
        let already = matched.binary_search(&id).is_ok();
        let Some(point) = map.point_mut(id) else {
            continue;
        };
        if already {
            point.visible_count += 1;
            expected_count += usize::from(point.has_range());
            continue;
        }
        let Some(wanted) = expect(optics, &viewpoint, point) else {
            continue;
        };
        expected_count += usize::from(point.has_range());
        let free = |observation: &Observation| observation.point.is_none();
        let found = find(&wanted, (&frame.grid, &frame.observations), GATE, free);
        if let Some(found) = found {
            frame.observations[found.observation_idx].point = Some(id);
        }
        point.visible_count += 1;
    }
    expected_count
}

/// Where and how a point should appear; `None` where it should not.
fn expect<'a>(optics: &Optics, viewpoint: &Viewpoint, point: &'a MapPoint) -> Option<Wanted<'a>> {
    let point_in_camera = viewpoint.transform(&point.position_in_map);
    let position = optics.project(&point_in_camera)?;
    let ray = point.position_in_map - viewpoint.centre_in_map;
    let distance = ray.norm();
    let viewing_cosine = ray.dot(&point.viewing_direction) / distance;
    if !point.in_distance_range(optics, distance) || viewing_cosine < VIEWING_COSINE_MIN {
        return None;
    }
    let window_px = if viewing_cosine > 0.998 { 4.0 } else { 6.0 };
    let level = point.predicted_level(optics, distance);
    let blur = point.blur(viewpoint, &point_in_camera).norm();
    Some(Wanted {
        position,
        radius: window_px * optics.window * level_scale(level) + BLURS * blur,
        levels: level.saturating_sub(1)..=level + 1,
        descriptor: &point.descriptor,
    })
}

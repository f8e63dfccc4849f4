//! Finds the points of the last frame in this one.

use geometry::{Camera, Map, Transform};

use crate::frame::{Frame, Viewpoint};
use crate::optics::{Optics, level_scale};
use crate::search::{Gate, Wanted, consistent_turns, find};
use crate::{Observation, VslamMap};

const GATE: Gate = Gate {
    distance_max: 80,
    ratio_max: 1.0,
};

/// Names, in `frame`, the points that lie where the predicted pose puts them, within a window that
/// grows with the level of the pyramid.
pub(crate) fn match_last_frame(
    optics: &Optics,
    map: &VslamMap,
    last: &[Observation],
    (predicted, window_px): (&Transform<Camera, Map>, f64),
    frame: &mut Frame,
) {
    let viewpoint = Viewpoint::new(*predicted);
    let mut matched = Vec::with_capacity(last.len());
    let mut turns_rad = Vec::with_capacity(last.len());
    for tracked in last {
        let Some(point) = tracked.point.and_then(|id| map.point(id)) else {
            continue;
        };
        let point_in_camera = viewpoint.transform(&point.position_in_map);
        let Some(position) = optics.project(&point_in_camera) else {
            continue;
        };
        let blur = point.blur(&viewpoint, &point_in_camera).norm();
        let wanted = Wanted {
            position,
            radius: window_px * optics.window * level_scale(tracked.level) + 2.0 * blur,
            levels: tracked.level.saturating_sub(1)..=tracked.level + 1,
            descriptor: &point.descriptor,
        };
        let free = |observation: &Observation| observation.point.is_none();
        if let Some(found) = find(&wanted, (&frame.grid, &frame.observations), GATE, free) {
            let observation = &mut frame.observations[found.observation_idx];
            observation.point = tracked.point;
            turns_rad.push(observation.angle_rad - tracked.angle_rad);
            matched.push(found.observation_idx);
        }
    }
    for (idx, consistent) in matched.into_iter().zip(consistent_turns(&turns_rad)) {
        if !consistent {
            frame.observations[idx].point = None;
        }
    }
}

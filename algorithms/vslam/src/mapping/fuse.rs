//! Makes one point of two, where neighbours see the same thing under two names.

use crate::frame::Viewpoint;
use crate::optics::{Optics, level_scale};
use crate::{KeyframeId, PointId, View, VslamMap};

/// Descriptors of one point differ by at most this many bits.
const DISTANCE_MAX: u32 = 60;
/// Window around the projection, pixels of the point's level.
const WINDOW_PX: f64 = 3.0;
/// Neighbours of each neighbour that take part.
const SECOND_NEIGHBOURS: usize = 4;
/// Squared, whitened distance between projection and keypoint (χ², two degrees of freedom).
const CHI_SQUARED_MAX: f64 = 5.99;
const VIEWING_COSINE_MIN: f64 = 0.5;

/// Projects the keyframe's points into its neighbours, and theirs into it.
pub(crate) fn fuse_with_neighbours(optics: &Optics, map: &mut VslamMap, id: KeyframeId) {
    let targets = targets(map, id);
    let own = map.points_of(&[id]);
    for &target in &targets {
        fuse(optics, map, &own, target);
    }
    let theirs = map.points_of(&targets);
    fuse(optics, map, &theirs, id);
}

/// The neighbours and some of their neighbours.
fn targets(map: &VslamMap, id: KeyframeId) -> Vec<KeyframeId> {
    let neighbours_of = |id: KeyframeId| {
        let keyframe = map.keyframe(id);
        keyframe.map_or(&[][..], |keyframe| keyframe.neighbours.as_slice())
    };
    let mut targets: Vec<KeyframeId> = neighbours_of(id).to_vec();
    for idx in 0..targets.len() {
        for &second in neighbours_of(targets[idx]).iter().take(SECOND_NEIGHBOURS) {
            if second != id && !targets.contains(&second) {
                targets.push(second);
            }
        }
    }
    targets.retain(|target| map.keyframe(*target).is_some());
    targets
}

/// What a keyframe's observation means for a point that projects onto it.
struct Landing {
    point: PointId,
    observation_idx: usize,
    occupant: Option<PointId>,
}

/// Adds views of the points in a keyframe, or merges them with the points it has there.
pub(crate) fn fuse(optics: &Optics, map: &mut VslamMap, points: &[PointId], target: KeyframeId) {
    let landings: Vec<Landing> = points
        .iter()
        .filter_map(|&point| land(optics, map, point, target))
        .collect();
    for landing in landings {
        match landing.occupant {
            None => map.link(
                landing.point,
                View {
                    keyframe: target,
                    observation_idx: landing.observation_idx as u32,
                },
            ),
            Some(occupant) => merge(map, landing.point, occupant),
        }
    }
}

/// The one stays whose range is known, or that has more views.
fn merge(map: &mut VslamMap, one: PointId, other: PointId) {
    let worth = |id| {
        map.point(id)
            .map(|point| (point.has_range(), point.views.len()))
    };
    let (Some(ones), Some(others)) = (worth(one), worth(other)) else {
        return;
    };
    let (kept, dropped) = if ones > others {
        (one, other)
    } else {
        (other, one)
    };
    map.merge_points(kept, dropped);
    map.refresh_point(kept);
}

fn land(optics: &Optics, map: &VslamMap, id: PointId, target: KeyframeId) -> Option<Landing> {
    let keyframe = map.keyframe(target)?;
    let point = map.point(id)?;
    if point.observation_idx(target).is_some() || !point.has_range() {
        return None;
    }
    let viewpoint = Viewpoint::new(keyframe.camera_from_map);
    let position = optics.project(&viewpoint.transform(&point.position_in_map))?;
    let ray = point.position_in_map - viewpoint.centre_in_map;
    let distance = ray.norm();
    let viewing_cosine = ray.dot(&point.viewing_direction) / distance;
    if !point.in_distance_range(optics, distance) || viewing_cosine < VIEWING_COSINE_MIN {
        return None;
    }
    let level = point.predicted_level(optics, distance);
    let radius = WINDOW_PX * optics.window * level_scale(level);
    let levels = level.saturating_sub(1)..=level + 1;
    let (mut best, mut best_idx) = (DISTANCE_MAX + 1, None);
    keyframe
        .grid
        .visit_near(&position, radius, levels, |entry| {
            let observation = &keyframe.observations[entry.observation_idx as usize];
            let error = (entry.position - position).norm_squared();
            if error > CHI_SQUARED_MAX * observation.sigma * observation.sigma {
                return;
            }
            let distance = point.descriptor.distance(&observation.descriptor);
            if distance < best {
                (best, best_idx) = (distance, Some(entry.observation_idx as usize));
            }
        });
    let observation_idx = best_idx?;
    Some(Landing {
        point: id,
        observation_idx,
        occupant: keyframe.observations[observation_idx].point,
    })
}

//! New points between a keyframe and its neighbours.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::held::is_placed;
use crate::map::NewPoint;
use crate::optics::{LEVEL_FACTOR, Optics, level_scale};
use crate::triangulation::{Sighting, TriangulationSettings, triangulate};
use crate::{Keyframe, KeyframeId, Observation, PointId, View, VslamMap};

/// Descriptors of one new point differ by at most this many bits. More lets in pairs that agree
/// with the epipolar geometry by chance, and whatever is wrong with it feeds on these.
const DISTANCE_MAX: u32 = 45;
/// The best candidate must beat the others by this factor.
const RATIO_MAX: f32 = 0.9;
/// Neighbours nearer than this share of the depth they see offer no parallax.
const BASELINE_SHARE_MIN: f64 = 0.02;
/// Keyframes with which new points are sought.
const PARTNERS_MAX: usize = 12;
/// A partner shares at least this many points.
const SHARED_MIN: u32 = 15;
/// Distance to the epipolar line, in standard deviations, squared (χ², one degree of freedom).
const LINE_CHI_SQUARED_MAX: f64 = 3.84;
/// How far the ratio of distances may be from that of the pyramid levels.
const SCALE_MISMATCH_MAX: f64 = LEVEL_FACTOR * 1.5;

/// Adds points that the keyframe and one of its neighbours see; returns them.
pub(crate) fn triangulate_new(optics: &Optics, map: &mut VslamMap, id: KeyframeId) -> Vec<PointId> {
    let mut new_points = Vec::new();
    let Some(depths) = DepthRange::of(map, id) else {
        return new_points;
    };
    let placed = |id| map.keyframe(id).is_some_and(|one| is_placed(map, one));
    if !placed(id) {
        return new_points;
    }
    let partners: Vec<KeyframeId> = partners(map, id, depths.median)
        .into_iter()
        .filter(|partner| placed(*partner))
        .collect();
    for neighbour in partners {
        let (Some(first), Some(second)) = (map.keyframe(id), map.keyframe(neighbour)) else {
            continue;
        };
        let found = match_pair((optics, map), (first, second), &depths);
        for (point, views) in found {
            let freed = free_views(map, &views);
            let id = map.add_point(point, views);
            for view in freed {
                map.link(id, view);
            }
            map.refresh_point(id);
            new_points.push(id);
        }
    }
    new_points
}

/// Removes the points of unknown range that these views show; returns their other views.
fn free_views(map: &mut VslamMap, views: &[View]) -> Vec<View> {
    let mut freed = Vec::new();
    for view in views {
        let keyframe = map.keyframe(view.keyframe);
        let shown = keyframe.and_then(|one| one.observations[view.observation_idx as usize].point);
        let Some(id) = shown else {
            continue;
        };
        freed.extend(
            map.point(id)
                .map(|point| point.views.clone())
                .unwrap_or_default(),
        );
        map.remove_point(id);
    }
    freed.retain(|view| !views.contains(view));
    freed
}

/// Whether an observation waits for a point of known range.
fn waits(map: &VslamMap, observation: &Observation) -> bool {
    let point = observation.point.and_then(|point| map.point(point));
    point.is_none_or(|point| !point.has_range())
}

/// The keyframes that share most of the view from far enough away, the farthest first: a point's
/// first pair of views should have much parallax.
fn partners(map: &VslamMap, id: KeyframeId, depth_median: f64) -> Vec<KeyframeId> {
    let centre = |id| map.keyframe(id).map(Keyframe::centre_in_map);
    let Some(own) = centre(id) else {
        return Vec::new();
    };
    let mut partners: Vec<(f64, KeyframeId)> = map
        .covisible(id)
        .into_iter()
        .filter(|one| one.shared_count >= SHARED_MIN)
        .filter_map(|one| Some(((centre(one.keyframe)? - own).norm(), one.keyframe)))
        .filter(|(baseline, _)| *baseline >= BASELINE_SHARE_MIN * depth_median)
        .take(PARTNERS_MAX)
        .collect();
    partners.sort_by(|a, b| b.0.total_cmp(&a.0));
    partners.into_iter().map(|(_, partner)| partner).collect()
}

/// How far away a keyframe's points are.
struct DepthRange {
    nearest: f64,
    median: f64,
}

impl DepthRange {
    fn of(map: &VslamMap, id: KeyframeId) -> Option<Self> {
        let depths = map.sorted_depths(id);
        Some(Self {
            nearest: 0.3 * depths.get(depths.len() / 20)?,
            median: *depths.get(depths.len() / 2)?,
        })
    }
}

/// The motion between two keyframes and what it does to lines of sight.
struct Epipolar {
    second_from_first: Transform<Camera, Camera>,
    rotation: Matrix3<f64>,
    essential: Matrix3<f64>,
    epipole: Option<Vector2<f64>>,
}

impl Epipolar {
    fn new(first: &Keyframe, second: &Keyframe) -> Self {
        let second_from_first = second.camera_from_map * first.camera_from_map.inverse();
        let rotation = second_from_first.rotation_matrix();
        let centre = *second_from_first.translation();
        Self {
            essential: centre.cross_matrix() * rotation,
            epipole: (centre.z.abs() > 1e-9).then(|| centre.xy() / centre.z),
            second_from_first,
            rotation,
        }
    }

    /// Where the second camera shows this line of sight, from a depth to infinity.
    fn segment(&self, ray: &Vector3<f64>, nearest: f64) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let depth_min = 0.02 * nearest;
        let far = self.rotation * ray;
        let near = far * nearest + self.second_from_first.translation();
        // Parts behind the second camera are cut off.
        let far = if far.z > 1e-3 {
            far
        } else {
            let last = (near.z - depth_min) / (1e-3 - far.z);
            if near.z <= depth_min || last <= 0.0 {
                return None;
            }
            near + far * last
        };
        let near = if near.z > depth_min {
            near
        } else {
            near + far * ((depth_min - near.z) / far.z)
        };
        Some((near.xy() / near.z, far.xy() / far.z))
    }
}

/// Triangulates all good pairs of observations without a point.
fn match_pair(
    (optics, map): (&Optics, &VslamMap),
    (first, second): (&Keyframe, &Keyframe),
    depths: &DepthRange,
) -> Vec<(NewPoint, Vec<View>)> {
    let epipolar = Epipolar::new(first, second);
    let mut taken = vec![false; second.observations.len()];
    let mut found = Vec::new();
    for (idx, one) in first.observations.iter().enumerate() {
        if !waits(map, one) {
            continue;
        }
        let Some(other_idx) = best_on_line((optics, map), &epipolar, (one, second), depths, &taken)
        else {
            continue;
        };
        let other = &second.observations[other_idx];
        let Some(point) = triangulate_pair((first, one), (second, other)) else {
            continue;
        };
        taken[other_idx] = true;
        let view = |keyframe: &Keyframe, idx: usize| View {
            keyframe: keyframe.id,
            observation_idx: idx as u32,
        };
        found.push((point, vec![view(first, idx), view(second, other_idx)]));
    }
    found
}

fn best_on_line(
    (optics, map): (&Optics, &VslamMap),
    epipolar: &Epipolar,
    (one, second): (&Observation, &Keyframe),
    depths: &DepthRange,
    taken: &[bool],
) -> Option<usize> {
    let ray = one.position.push(1.0);
    let (near, far) = epipolar.segment(&ray, depths.nearest)?;
    let line = epipolar.essential * ray;
    let line_norm_squared = line.xy().norm_squared();
    let margin = 2.0 * one.sigma;
    let (mut best, mut best_idx, mut second_best) = (DISTANCE_MAX + 1, None, u32::MAX);
    let (from, to) = clip(optics, &near, &far)?;
    second.grid.visit_segment(&from, &to, margin, |entry| {
        let idx = entry.observation_idx as usize;
        if taken[idx] || entry.level.abs_diff(one.level) > 3 {
            return;
        }
        let error = line.dot(&entry.position.push(1.0));
        let other = &second.observations[idx];
        let variance = other.sigma * other.sigma;
        if error * error > LINE_CHI_SQUARED_MAX * variance * line_norm_squared {
            return;
        }
        // Beside the epipole every line passes: there is no parallax to tell depths apart.
        let beside = epipolar.epipole.is_some_and(|epipole| {
            let radius = 10.0 * optics.window * level_scale(entry.level).sqrt();
            (epipole - entry.position).norm_squared() < radius * radius
        });
        if beside || !waits(map, other) {
            return;
        }
        let distance = one.descriptor.distance(&other.descriptor);
        if distance < best {
            second_best = best;
            (best, best_idx) = (distance, Some(idx));
        } else {
            second_best = second_best.min(distance);
        }
    });
    best_idx.filter(|_| best as f32 <= RATIO_MAX * second_best as f32)
}

/// The part of a segment inside the visible part of the plane.
fn clip(
    optics: &Optics,
    from: &Vector2<f64>,
    to: &Vector2<f64>,
) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let along = to - from;
    let (mut begin, mut end) = (0.0_f64, 1.0_f64);
    for axis in 0..2 {
        let (low, high) = (optics.plane_min[axis], optics.plane_max[axis]);
        if along[axis].abs() < 1e-12 {
            if from[axis] < low || from[axis] > high {
                return None;
            }
            continue;
        }
        let (a, b) = (
            (low - from[axis]) / along[axis],
            (high - from[axis]) / along[axis],
        );
        begin = begin.max(a.min(b));
        end = end.min(a.max(b));
    }
    (begin <= end).then(|| (from + along * begin, from + along * end))
}

fn triangulate_pair(
    (first, one): (&Keyframe, &Observation),
    (second, other): (&Keyframe, &Observation),
) -> Option<NewPoint> {
    let sighting = |keyframe: &Keyframe, observation: &Observation| Sighting {
        camera_from_map: keyframe.camera_from_map,
        position: observation.position,
        sigma: observation.sigma,
    };
    let sigma = one.sigma.hypot(other.sigma);
    let settings = TriangulationSettings {
        parallax_rad_min: parallax_rad_min(sigma),
        ..TriangulationSettings::default()
    };
    let sightings = [sighting(first, one), sighting(second, other)];
    let point = triangulate(&sightings, &settings).ok()?;
    // A point seen from twice as far lies on a finer level by the same factor.
    let distance = |keyframe: &Keyframe| (point.point_in_map - keyframe.centre_in_map()).norm();
    let distances = distance(second) / distance(first);
    let scales = level_scale(one.level) / level_scale(other.level);
    let mismatch = distances / scales;
    let plausible = mismatch < SCALE_MISMATCH_MAX && mismatch > 1.0 / SCALE_MISMATCH_MAX;
    plausible.then_some(NewPoint {
        position_in_map: point.point_in_map,
        covariance_in_map: point.covariance_in_map,
        parallax_rad: point.parallax_rad,
        expected_range: None,
    })
}

/// The least angle between two rays that tells a range, by the noise of the angle.
pub(crate) fn parallax_rad_min(sigma: f64) -> f64 {
    PARALLAX_RAD_MIN.max(PARALLAX_SIGMAS_MIN * sigma)
}

/// Rays must meet at this angle at least: 1°.
pub(super) const PARALLAX_RAD_MIN: f64 = 0.0175;
/// And at this many standard deviations of the angle. If noise decided which points pass, all that
/// do would be too near, and with each keyframe the map would shrink.
const PARALLAX_SIGMAS_MIN: f64 = 5.0;

//! Points of which only the direction is known.
//!
//! A camera that turns sees new things without parallax: no two rays say how far away they are.
//! Left out, they would leave it lost at the end of the turn. So a point is made at the range
//! that its surroundings suggest, with its uncertainty (deferred triangulation, after Herrera
//! et al. 2014): it holds the camera's rotation until motion tells the range.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, Vector3};

use crate::bundle::{RangePrior, range_residual};
use crate::map::{ExpectedRange, NewPoint};
use crate::optics::{Optics, level_scale};
use crate::search::{Gate, Wanted, consistent_turns, find};
use crate::triangulation::{Sighting, accumulate, parallax_rad};
use crate::{Keyframe, KeyframeId, MapPoint, Observation, PointId, View, VslamMap};

/// Keyframes with which directions are sought, the ones that share most first.
const PARTNERS_MAX: usize = 3;
const GATE: Gate = Gate {
    distance_max: 45,
    ratio_max: 0.8,
};
/// Window around where the expected range puts a keypoint, pixels of its level.
const WINDOW_PX: f64 = 4.0;
/// The inverse range of what is new, in inverse median ranges of what is known nearby.
const INVERSE_RANGE_MEAN: f64 = 0.8;
const INVERSE_RANGE_SIGMA: f64 = 0.5;
/// Squared, whitened residual of either view (χ², two degrees of freedom).
const CHI_SQUARED_MAX: f64 = 5.99;
const ITERATION_COUNT: usize = 4;

/// Adds points that the keyframe and one of those nearest to it see, without regard to parallax;
/// returns them.
pub(crate) fn add_directions(optics: &Optics, map: &mut VslamMap, id: KeyframeId) -> Vec<PointId> {
    let depths = map.sorted_depths(id);
    let Some(depth_median) = depths.get(depths.len() / 2).filter(|depth| **depth > 0.0) else {
        return Vec::new();
    };
    let expected = ExpectedRange {
        inverse_range: INVERSE_RANGE_MEAN / depth_median,
        sigma: INVERSE_RANGE_SIGMA / depth_median,
    };
    let Some(keyframe) = map.keyframe(id) else {
        return Vec::new();
    };
    if Held::by(optics, map, keyframe).suffices(optics, keyframe) {
        return Vec::new();
    }
    let partners = map.covisible(id).into_iter().take(PARTNERS_MAX);
    let mut added = Vec::new();
    for partner in partners.map(|one| one.keyframe) {
        let (Some(first), Some(second)) = (map.keyframe(id), map.keyframe(partner)) else {
            continue;
        };
        let held = Held::by(optics, map, first);
        let found = match_pair((optics, &held), (first, second), expected);
        added.extend(
            found
                .into_iter()
                .map(|(point, views)| map.add_point(point, views)),
        );
    }
    added
}

/// Drops the expectation once the views tell the range.
pub(crate) fn release_range(
    map: &mut VslamMap,
    id: PointId,
    parallax_rad_min: impl Fn(f64) -> f64,
) {
    let Some(point) = map.point(id).filter(|point| !point.has_range()) else {
        return;
    };
    let sightings: Vec<Sighting> = point
        .views
        .iter()
        .filter_map(|view| {
            let keyframe = map.keyframe(view.keyframe)?;
            Some(sighting(
                keyframe,
                &keyframe.observations[view.observation_idx as usize],
            ))
        })
        .collect();
    let sigma = sightings.iter().map(|one| one.sigma).fold(0.0, f64::max);
    let parallax_rad = parallax_rad(&sightings, &point.position_in_map);
    if parallax_rad < parallax_rad_min(sigma * std::f64::consts::SQRT_2) {
        return;
    }
    if let Some(point) = map.point_mut(id) {
        point.expected_range = None;
        point.parallax_rad = parallax_rad;
    }
}

/// Which parts of a keyframe's image points of known range hold.
struct Held {
    cells: [bool; CELLS_ALONG * CELLS_ALONG],
    point_count: usize,
}

/// Where points of known range hold so many of the keypoints, and so much of the image, no others
/// are needed.
const HELD_KEYPOINTS_MIN: f64 = 0.2;
const HELD_CELLS_MIN: f64 = 0.7;

/// Cells along either side of the image.
const CELLS_ALONG: usize = 8;

impl Held {
    fn by(optics: &Optics, map: &VslamMap, keyframe: &Keyframe) -> Self {
        let mut held = Self {
            cells: [false; CELLS_ALONG * CELLS_ALONG],
            point_count: 0,
        };
        for observation in &keyframe.observations {
            let point = observation.point.and_then(|point| map.point(point));
            if point.is_some_and(MapPoint::has_range) {
                held.cells[Self::cell(optics, observation)] = true;
                held.point_count += 1;
            }
        }
        held
    }

    fn suffices(&self, optics: &Optics, keyframe: &Keyframe) -> bool {
        let mut textured = [false; CELLS_ALONG * CELLS_ALONG];
        for observation in &keyframe.observations {
            textured[Self::cell(optics, observation)] = true;
        }
        let count = |cells: &[bool]| cells.iter().filter(|cell| **cell).count() as f64;
        let keypoint_count = keyframe.observations.len() as f64;
        self.point_count as f64 >= HELD_KEYPOINTS_MIN * keypoint_count
            && count(&self.cells) >= HELD_CELLS_MIN * count(&textured)
    }

    fn holds(&self, optics: &Optics, observation: &Observation) -> bool {
        self.cells[Self::cell(optics, observation)]
    }

    fn cell(optics: &Optics, observation: &Observation) -> usize {
        let size = [optics.camera.width(), optics.camera.height()];
        let along = [0, 1].map(|axis| {
            let share = observation.position_px[axis] / size[axis] as f64;
            // A cast from float saturates: negative becomes 0.
            ((share * CELLS_ALONG as f64) as usize).min(CELLS_ALONG - 1)
        });
        along[1] * CELLS_ALONG + along[0]
    }
}

fn match_pair(
    (optics, held): (&Optics, &Held),
    (first, second): (&Keyframe, &Keyframe),
    expected: ExpectedRange,
) -> Vec<(NewPoint, Vec<View>)> {
    let second_from_first = second.camera_from_map * first.camera_from_map.inverse();
    let mut taken = vec![false; second.observations.len()];
    let mut pairs = Vec::new();
    for (idx, one) in first.observations.iter().enumerate() {
        if one.point.is_some() || held.holds(optics, one) {
            continue;
        }
        let Some((position, spread)) = appearance(optics, &second_from_first, one, expected) else {
            continue;
        };
        let wanted = Wanted {
            position,
            radius: WINDOW_PX * optics.window * level_scale(one.level) + spread,
            levels: one.level.saturating_sub(1)..=one.level + 1,
            descriptor: &one.descriptor,
        };
        let target = (&second.grid, second.observations.as_slice());
        let free = |other: &Observation| other.point.is_none();
        let Some(found) = find(&wanted, target, GATE, free) else {
            continue;
        };
        if !std::mem::replace(&mut taken[found.observation_idx], true) {
            pairs.push((idx, found.observation_idx));
        }
    }
    let turn = |&(one, other): &(usize, usize)| {
        second.observations[other].angle_rad - first.observations[one].angle_rad
    };
    let turns_rad: Vec<f32> = pairs.iter().map(turn).collect();
    let consistent = consistent_turns(&turns_rad);
    let pairs = pairs.into_iter().zip(consistent);
    pairs
        .filter(|(_, consistent)| *consistent)
        .filter_map(|(pair, _)| make_point((first, second), pair, expected))
        .collect()
}

/// Where the second camera should show what the first sees, and how far the uncertain range may
/// move that.
fn appearance(
    optics: &Optics,
    second_from_first: &Transform<Camera, Camera>,
    one: &Observation,
    expected: ExpectedRange,
) -> Option<(nalgebra::Vector2<f64>, f64)> {
    let ray = one.position.push(1.0).normalize();
    // At an inverse range of zero this is the direction alone.
    let at = |inverse_range: f64| {
        let scaled = second_from_first.rotation() * ray
            + second_from_first.translation() * inverse_range.max(0.0);
        optics.project(&scaled)
    };
    let position = at(expected.inverse_range)?;
    let far = at(expected.inverse_range - 2.0 * expected.sigma)?;
    let near = at(expected.inverse_range + 2.0 * expected.sigma)?;
    let spread = (far - position).norm().max((near - position).norm());
    Some((position, spread))
}

fn sighting(keyframe: &Keyframe, observation: &Observation) -> Sighting {
    Sighting {
        camera_from_map: keyframe.camera_from_map,
        position: observation.position,
        sigma: observation.sigma,
    }
}

/// The most likely point by both views and the expectation.
fn make_point(
    (first, second): (&Keyframe, &Keyframe),
    (one, other): (usize, usize),
    expected: ExpectedRange,
) -> Option<(NewPoint, Vec<View>)> {
    let sightings = [
        sighting(first, &first.observations[one]),
        sighting(second, &second.observations[other]),
    ];
    let prior = RangePrior {
        point_idx: 0,
        centre_in_map: first.centre_in_map(),
        inverse_range: expected.inverse_range,
        sigma: expected.sigma,
    };
    let ray = first.observations[one].position.push(1.0).normalize();
    let mut point = first.map_from_camera() * (ray / expected.inverse_range);
    for _ in 0..ITERATION_COUNT {
        point += normal_step(&sightings, &prior, &point)?.0;
    }
    let (_, worst) = normal_step(&sightings, &prior, &point)?;
    let range = (point - prior.centre_in_map).norm();
    let sane = range * expected.inverse_range < 20.0 && range * expected.inverse_range > 0.05;
    let new = NewPoint {
        position_in_map: point,
        covariance_in_map: covariance(&prior, &point),
        parallax_rad: parallax_rad(&sightings, &point),
        expected_range: Some(expected),
    };
    let view = |keyframe: &Keyframe, idx: usize| View {
        keyframe: keyframe.id,
        observation_idx: idx as u32,
    };
    let views = vec![view(first, one), view(second, other)];
    (sane && worst <= CHI_SQUARED_MAX).then_some((new, views))
}

/// A Gauss–Newton step, and the worst squared residual of a view.
fn normal_step(
    sightings: &[Sighting],
    prior: &RangePrior,
    point: &Vector3<f64>,
) -> Option<(Vector3<f64>, f64)> {
    let normal = accumulate(sightings, point)?;
    let (residual, d_residual_d_point) = range_residual(prior, point);
    let hessian = normal.hessian + d_residual_d_point * d_residual_d_point.transpose();
    let gradient = normal.gradient + d_residual_d_point * residual;
    Some((hessian.cholesky()?.solve(&-gradient), normal.worst))
}

/// What a prior leaves uncertain along the ray. Views near each other seem to tell more, but the
/// poses that make it so were found by the same points.
pub(crate) fn covariance(prior: &RangePrior, point_in_map: &Vector3<f64>) -> Matrix3<f64> {
    let ray = point_in_map - prior.centre_in_map;
    let d_point_d_inverse_range = ray * ray.norm();
    d_point_d_inverse_range * d_point_d_inverse_range.transpose() * prior.sigma.powi(2)
}

/// The prior of a point in a bundle adjustment, measured from the keyframe that saw it first.
pub(crate) fn range_prior(map: &VslamMap, id: PointId, point_idx: usize) -> Option<RangePrior> {
    let point = map.point(id)?;
    let expected = point.expected_range?;
    let first = map.keyframe(point.views.first()?.keyframe)?;
    Some(RangePrior {
        point_idx,
        centre_in_map: first.centre_in_map(),
        inverse_range: expected.inverse_range,
        sigma: expected.sigma,
    })
}

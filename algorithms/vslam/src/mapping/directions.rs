//! Points of which only the direction is known.
//!
//! A camera that turns sees new things without parallax: no two rays say how far away they are.
//! Left out, they would leave it lost at the end of the turn. So a point is made at the range
//! that its surroundings suggest, with its uncertainty (deferred triangulation, after Herrera
//! et al. 2014): it holds the camera's rotation until motion tells the range.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, Vector3};

use crate::held::Held;
use crate::map::{ExpectedRange, NewPoint};
use crate::optics::{Optics, level_scale};
use crate::search::{Gate, Wanted, consistent_turns, find};
use crate::triangulation::{Sighting, accumulate, parallax_rad};
use crate::{Keyframe, KeyframeId, Observation, PointId, View, VslamMap};

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
/// An inverse range far beyond what was expected is no such point.
const RATIOS: std::ops::Range<f64> = 0.05..20.0;

/// Adds points that the keyframe and one of those nearest to it see, without regard to parallax;
/// returns them.
pub(crate) fn add_directions(optics: &Optics, map: &mut VslamMap, id: KeyframeId) -> Vec<PointId> {
    let Some(depth_median) = map.median_depth(id).filter(|depth| *depth > 0.0) else {
        return Vec::new();
    };
    let expected = ExpectedRange {
        inverse_range: INVERSE_RANGE_MEAN / depth_median,
        sigma: INVERSE_RANGE_SIGMA / depth_median,
    };
    let Some(keyframe) = map.keyframe(id) else {
        return Vec::new();
    };
    if Held::by(optics, map, &keyframe.observations).suffices() {
        return Vec::new();
    }
    let partners = map.covisible(id).into_iter().take(PARTNERS_MAX);
    let mut added = Vec::new();
    for partner in partners.map(|one| one.keyframe) {
        let (Some(first), Some(second)) = (map.keyframe(id), map.keyframe(partner)) else {
            continue;
        };
        let held = Held::by(optics, map, &first.observations);
        let found = match_pair((optics, &held), (first, second), expected);
        added.extend(
            found
                .into_iter()
                .map(|(point, views)| map.add_point(point, views)),
        );
    }
    added
}

/// Lets directions follow the keyframes that saw them first; `keyframes` are those that moved.
///
/// They get a range only where two views pass the same tests as those of any new point.
pub(crate) fn settle_directions(map: &mut VslamMap, keyframes: &[KeyframeId]) {
    for id in map.points_of(keyframes) {
        if let Some(expected) = map.point(id).and_then(|point| point.expected_range) {
            follow_first_view(map, id, expected);
            map.refresh_point(id);
        }
    }
}

fn follow_first_view(map: &mut VslamMap, id: PointId, expected: ExpectedRange) {
    let first = map
        .point(id)
        .and_then(|point| point.views().first().copied());
    let seen = first.and_then(|view| {
        let keyframe = map.keyframe(view.keyframe)?;
        Some(Guess::new(
            keyframe,
            &keyframe.observations[view.observation_idx as usize],
            expected,
        ))
    });
    if let (Some(guess), Some(point)) = (seen, map.point_mut(id)) {
        point.position_in_map = guess.point_in_map();
        point.covariance_in_map = guess.covariance(&point.position_in_map);
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

/// A ray, and what is expected of how far it goes.
#[derive(Clone, Copy, Debug)]
struct Guess {
    centre_in_map: Vector3<f64>,
    ray_in_map: Vector3<f64>,
    expected: ExpectedRange,
}

impl Guess {
    fn new(keyframe: &Keyframe, observation: &Observation, expected: ExpectedRange) -> Self {
        let ray = observation.position.push(1.0).normalize();
        Self {
            centre_in_map: keyframe.centre_in_map(),
            ray_in_map: keyframe.map_from_camera().rotation() * ray,
            expected,
        }
    }

    fn point_in_map(&self) -> Vector3<f64> {
        self.centre_in_map + self.ray_in_map / self.expected.inverse_range
    }

    /// The whitened residual of the inverse range, and its derivative by the point.
    fn residual(&self, point_in_map: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let ray = point_in_map - self.centre_in_map;
        // At its very centre a point has no range; there it counts as very near.
        let inverse_range = 1.0 / ray.norm().max(1e-9);
        let residual = (inverse_range - self.expected.inverse_range) / self.expected.sigma;
        (
            residual,
            ray * (-inverse_range.powi(3) / self.expected.sigma),
        )
    }

    /// What is uncertain along the ray. Views near each other seem to tell more, but the poses
    /// that make it so were found by the same points.
    fn covariance(&self, point_in_map: &Vector3<f64>) -> Matrix3<f64> {
        let ray = point_in_map - self.centre_in_map;
        let d_point_d_inverse_range = ray * ray.norm();
        let variance = self.expected.sigma * self.expected.sigma;
        d_point_d_inverse_range * d_point_d_inverse_range.transpose() * variance
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
    let guess = Guess::new(first, &first.observations[one], expected);
    let mut point = guess.point_in_map();
    for _ in 0..ITERATION_COUNT {
        point += normal_step(&sightings, &guess, &point)?.0;
    }
    let (_, worst) = normal_step(&sightings, &guess, &point)?;
    let inverse_range = 1.0 / (point - guess.centre_in_map).norm();
    let ratio = inverse_range / expected.inverse_range;
    let new = NewPoint {
        position_in_map: point,
        covariance_in_map: guess.covariance(&point),
        parallax_rad: parallax_rad(&sightings, &point),
        expected_range: Some(ExpectedRange {
            inverse_range,
            ..expected
        }),
    };
    let view = |keyframe: &Keyframe, idx: usize| View {
        keyframe: keyframe.id,
        observation_idx: idx as u32,
    };
    let views = vec![view(first, one), view(second, other)];
    (RATIOS.contains(&ratio) && worst <= CHI_SQUARED_MAX).then_some((new, views))
}

/// A Gauss–Newton step, and the worst squared residual of a view.
fn normal_step(
    sightings: &[Sighting],
    guess: &Guess,
    point: &Vector3<f64>,
) -> Option<(Vector3<f64>, f64)> {
    let normal = accumulate(sightings, point)?;
    let (residual, d_residual_d_point) = guess.residual(point);
    let hessian = normal.hessian + d_residual_d_point * d_residual_d_point.transpose();
    let gradient = normal.gradient + d_residual_d_point * residual;
    Some((hessian.cholesky()?.solve(&-gradient), normal.worst))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn range_derivative_matches_differences() {
        let guess = Guess {
            centre_in_map: Vector3::new(0.4, -0.1, 0.2),
            ray_in_map: Vector3::z(),
            expected: ExpectedRange {
                inverse_range: 0.5,
                sigma: 0.1,
            },
        };
        let point = Vector3::new(1.0, 0.7, 3.0);
        let (_, ours) = guess.residual(&point);
        let step = 1e-6;
        for axis in 0..3 {
            let mut delta = Vector3::zeros();
            delta[axis] = step;
            let difference =
                guess.residual(&(point + delta)).0 - guess.residual(&(point - delta)).0;
            assert!((difference / (2.0 * step) - ours[axis]).abs() < 1e-6);
        }
    }
}

//! The most likely pose near a start, and its covariance.

use nalgebra::{Matrix6, Vector2, Vector3, Vector6};

use super::{CHI_SQUARED_2_P95, PointObservation, PoseRefusal, RefinedPose, residual_squared};
use crate::{Camera, RobustKernel, Transform};

/// How long to refine, and what to leave out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineSettings {
    /// A squared, whitened residual above this is an outlier.
    pub chi_squared_max: f64,
    /// Rounds of optimisation at most, each followed by a new classification of all observations;
    /// the last is plain least squares over the inliers. A start that is off by many sigmas needs
    /// four.
    pub round_count: usize,
    /// Steps in each round at most.
    pub iteration_count: usize,
    /// A pose that explains fewer observations is refused; at least three.
    pub inlier_count_min: usize,
    /// Where the camera should be, for observations that hardly say.
    pub position_prior: Option<PositionPrior>,
}

/// What is known beforehand of where a camera is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionPrior {
    /// Its centre, in the frame of the points.
    pub centre_in_world: Vector3<f64>,
    /// Standard deviation of each coordinate.
    pub sigma: f64,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self {
            chi_squared_max: CHI_SQUARED_2_P95,
            round_count: 4,
            iteration_count: 8,
            inlier_count_min: 6,
            position_prior: None,
        }
    }
}

/// The pose nearest to `start` that fits its observations best.
///
/// Levenberg–Marquardt with Huber's kernel; after each round every observation is classified
/// anew, so that one lost early may come back. Allocates the inlier flags and nothing else.
pub fn refine_absolute_pose<World>(
    start: &Transform<Camera, World>,
    observations: &[PointObservation],
    settings: &RefineSettings,
) -> Result<RefinedPose<World>, PoseRefusal> {
    let required = settings.inlier_count_min.max(3);
    if observations.len() < required {
        return Err(PoseRefusal::TooFewObservations {
            found: observations.len(),
            required,
        });
    }
    let huber = RobustKernel::Huber {
        threshold: settings.chi_squared_max.sqrt(),
    };
    let mut pose = *start;
    // The first round sees everything in front of the camera: the start may be far off.
    let mut inliers = vec![true; observations.len()];
    let mut inlier_count = classify(&pose, observations, f64::INFINITY, &mut inliers).count;
    for round in 0..settings.round_count {
        let last = round + 1 == settings.round_count;
        let kernel = if last { RobustKernel::None } else { huber };
        if inlier_count < required {
            break;
        }
        pose = optimise(pose, observations, &inliers, kernel, settings)
            .ok_or(PoseRefusal::Degenerate)?;
        let classes = classify(&pose, observations, settings.chi_squared_max, &mut inliers);
        inlier_count = classes.count;
    }
    if inlier_count < required {
        return Err(PoseRefusal::TooFewInliers {
            found: inlier_count,
            required,
        });
    }
    conclude(pose, observations, inliers, inlier_count, settings)
}

fn conclude<World>(
    camera_from_world: Transform<Camera, World>,
    observations: &[PointObservation],
    inliers: Vec<bool>,
    inlier_count: usize,
    settings: &RefineSettings,
) -> Result<RefinedPose<World>, PoseRefusal> {
    let normal = accumulate(
        &camera_from_world,
        observations,
        &inliers,
        RobustKernel::None,
        settings,
    );
    let variance_factor = variance_factor(normal.cost, inlier_count, settings.chi_squared_max);
    let covariance = normal.hessian.cholesky().ok_or(PoseRefusal::Degenerate)?;
    Ok(RefinedPose {
        camera_from_world,
        world_from_camera_covariance: covariance.inverse() * variance_factor,
        inliers,
        inlier_count,
        variance_factor,
    })
}

/// How many observations count as prior knowledge that the sigmas are right.
const VARIANCE_PRIOR_COUNT: f64 = 10.0;

/// The variance of the inliers relative to what their sigmas promise, drawn towards one where
/// there are few of them.
fn variance_factor(cost: f64, inlier_count: usize, chi_squared_max: f64) -> f64 {
    // Cutting the χ² distribution at `c` leaves the mean 2 − c e^{−c/2} / (1 − e^{−c/2}).
    let tail = (-0.5 * chi_squared_max).exp();
    let mean = 2.0 - chi_squared_max * tail / (1.0 - tail);
    let expected = mean * (inlier_count as f64 - 3.0).max(0.0);
    let prior = 2.0 * VARIANCE_PRIOR_COUNT;
    (prior + cost) / (prior + expected)
}

struct Classes {
    count: usize,
}

fn classify<World>(
    pose: &Transform<Camera, World>,
    observations: &[PointObservation],
    chi_squared_max: f64,
    inliers: &mut [bool],
) -> Classes {
    let mut count = 0;
    for (inlier, observation) in inliers.iter_mut().zip(observations) {
        *inlier =
            residual_squared(pose, observation).is_some_and(|squared| squared <= chi_squared_max);
        count += usize::from(*inlier);
    }
    Classes { count }
}

/// Levenberg–Marquardt over the inliers, or `None` if they leave a direction free.
fn optimise<World>(
    start: Transform<Camera, World>,
    observations: &[PointObservation],
    inliers: &[bool],
    kernel: RobustKernel,
    settings: &RefineSettings,
) -> Option<Transform<Camera, World>> {
    let mut pose = start;
    let mut normal = accumulate(&pose, observations, inliers, kernel, settings);
    let mut damping = 1e-6;
    for _ in 0..settings.iteration_count {
        let mut damped = normal.hessian;
        for axis in 0..6 {
            damped[(axis, axis)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&-normal.gradient);
        let moved = moved(&pose, &step);
        let moved_normal = accumulate(&moved, observations, inliers, kernel, settings);
        if moved_normal.cost > normal.cost || moved_normal.cost.is_nan() {
            damping *= 100.0;
            continue;
        }
        // A gain of ε² in the cost moves the pose by at most ε standard deviations.
        let gain = normal.cost - moved_normal.cost;
        pose = moved;
        normal = moved_normal;
        damping *= 0.1;
        if gain < 1e-4 {
            break;
        }
    }
    Some(pose)
}

/// `camera_from_world` after `world_from_camera * exp(step)`.
fn moved<World>(pose: &Transform<Camera, World>, step: &Vector6<f64>) -> Transform<Camera, World> {
    Transform::<Camera, Camera>::exp(&-step) * *pose
}

pub(super) struct NormalEquations {
    hessian: Matrix6<f64>,
    pub(super) gradient: Vector6<f64>,
    pub(super) cost: f64,
}

/// Sums `Jᵀ w J`, `Jᵀ w r` and the robust cost over the inliers, in order.
pub(super) fn accumulate<World>(
    pose: &Transform<Camera, World>,
    observations: &[PointObservation],
    inliers: &[bool],
    kernel: RobustKernel,
    settings: &RefineSettings,
) -> NormalEquations {
    let rotation = pose.rotation_matrix();
    let mut normal = NormalEquations {
        hessian: Matrix6::zeros(),
        gradient: Vector6::zeros(),
        cost: 0.0,
    };
    for (observation, _) in observations
        .iter()
        .zip(inliers)
        .filter(|(_, inlier)| **inlier)
    {
        let point_in_camera = rotation * observation.point_in_world + pose.translation();
        if point_in_camera.z <= 0.0 {
            // As expensive as a very bad residual: a step must not push points behind.
            normal.cost += kernel.cost(1e6);
            continue;
        }
        let inverse_depth = 1.0 / point_in_camera.z;
        let predicted = point_in_camera.xy() * inverse_depth;
        let whitener = observation.whitener();
        let residual = whitener * (predicted - observation.position);
        let squared = residual.norm_squared();
        normal.cost += kernel.cost(squared);
        let weight = kernel.weight(squared);
        let [first, second] = d_position_d_pose(&predicted, inverse_depth);
        for (axis, residual) in residual.iter().enumerate() {
            let row = first * whitener[(axis, 0)] + second * whitener[(axis, 1)];
            normal.gradient += row * (weight * residual);
            add_outer_product_lower(&mut normal.hessian, &row, weight);
        }
    }
    if let Some(prior) = &settings.position_prior {
        normal.add_prior(pose, prior);
    }
    normal.hessian.fill_upper_triangle_with_lower_triangle();
    normal
}

impl NormalEquations {
    fn add_prior<World>(&mut self, pose: &Transform<Camera, World>, prior: &PositionPrior) {
        // The error along the camera's axes, of which ν is the derivative's identity.
        let error = -(*pose * prior.centre_in_world) / prior.sigma;
        self.cost += error.norm_squared();
        for axis in 0..3 {
            self.gradient[3 + axis] += error[axis] / prior.sigma;
            self.hessian[(3 + axis, 3 + axis)] += 1.0 / (prior.sigma * prior.sigma);
        }
    }
}

fn add_outer_product_lower(hessian: &mut Matrix6<f64>, row: &Vector6<f64>, weight: f64) {
    for column in 0..6 {
        let factor = row[column] * weight;
        for line in column..6 {
            hessian[(line, column)] += row[line] * factor;
        }
    }
}

/// The rows of the derivative of `position`, which is `(x/z, y/z)`, by the `[ω; ν]` of
/// `world_from_camera * exp([ω; ν])`.
pub fn d_position_d_pose(position: &Vector2<f64>, inverse_depth: f64) -> [Vector6<f64>; 2] {
    let (u, v, w) = (position.x, position.y, inverse_depth);
    [
        Vector6::new(u * v, -(1.0 + u * u), v, -w, 0.0, u * w),
        Vector6::new(1.0 + v * v, -u * v, -u, 0.0, -w, v * w),
    ]
}

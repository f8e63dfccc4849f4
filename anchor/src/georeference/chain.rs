//! The map as a chain of similarities, one per keyframe, that drift relates and fixes hold.
//!
//! Neighbouring keyframes stand to each other as the map says, up to the drift of a monocular map
//! (a random walk of rotation, translation and ln s along the path, about the scene that the
//! camera looks at). The normal equations are block-tridiagonal, so a solution and all marginal
//! covariances cost a pass each.

use std::collections::BTreeMap;

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Tangent7, so3};
use nalgebra::{Matrix3, SMatrix, Vector3};
use vslam::KeyframeId;

use super::Depths;
use super::association::Tie;
use crate::settings::DriftModel;
use crate::{GeoreferenceSettings, KeyframePose};

mod tridiagonal;

use tridiagonal::Tridiagonal;

type Matrix3x7 = SMatrix<f64, 3, 7>;
type RowVector7 = SMatrix<f64, 1, 7>;

const ITERATION_COUNT_MAX: usize = 12;
/// Median and 99 % of χ² with three degrees of freedom.
const CHI2_MEDIAN: f64 = 2.366;
const CHI2_GATE: f64 = 11.34;
/// Residuals of this many fixes whose median is too large by this factor contradict the model: in
/// forty fixes the median errs by 18 %, in a hundred by 11 %.
const TELLING_FIX_COUNT: usize = 40;
const EXCESS_MAX: f64 = 1.25;
const DRIFT_FACTOR_MAX: f64 = 16.0;
const DRIFT_FACTOR_MIN: f64 = 0.5;
/// An attitude sensor's vertical (rad).
const UP_SIGMA_RAD: f64 = 0.03;
/// What is known before any fix: nothing much.
const PRIOR_ROTATION_RAD: f64 = 2.0;
const PRIOR_LOG_SCALE: f64 = 2.0;
const PRIOR_POSITION_SHARE: f64 = 1e4;

/// Where every keyframe stands.
#[derive(Debug)]
pub(super) struct Solution {
    pub(super) nodes: Vec<Node>,
    /// Whitened, squared residual of each tie, in their order.
    pub(super) residuals_squared: Vec<f64>,
    pub(super) drift_factor: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub(super) keyframe: KeyframeId,
    pub(super) enu_from_camera: Similarity<Enu, Camera>,
    pub(super) covariance: Matrix7,
}

/// The best places of all keyframes from a first guess of the whole; `None` if it diverges.
///
/// The drift model is widened until it explains the fixes, if it does not at first; a map that
/// drifts less than the model says has it narrowed, to no less than half, as far as the fixes
/// speak for that.
pub(super) fn solve(
    ties: &[&Tie],
    keyframes: &BTreeMap<KeyframeId, KeyframePose>,
    depths: &Depths,
    start: &Similarity<Enu, Map>,
    settings: &GeoreferenceSettings,
) -> Option<Solution> {
    let mut problem = Problem::new(ties, keyframes, depths, start, settings);
    loop {
        let mut solution = problem.minimise()?;
        let excess = median(&solution.residuals_squared) / CHI2_MEDIAN;
        let bends = problem.total_excess() > EXCESS_MAX * excess.max(1.0)
            || (excess > EXCESS_MAX && problem.residuals_are_correlated());
        if bends && ties.len() >= TELLING_FIX_COUNT && problem.drift_factor < DRIFT_FACTOR_MAX {
            problem.drift_factor *= 2.0;
            continue;
        }
        if problem.drift_factor <= 1.0 && ties.len() >= TELLING_FIX_COUNT {
            solution = problem.narrowed(solution)?;
        }
        // Noise beyond what the fixes state of themselves.
        for node in &mut solution.nodes {
            node.covariance *= excess.max(1.0);
        }
        return Some(solution);
    }
}

struct Problem<'a> {
    ties: &'a [&'a Tie],
    /// Index of each tie's node.
    node_of_tie: Vec<usize>,
    keyframes: Vec<&'a KeyframePose>,
    /// Of the scene at each keyframe, in the unit of the map.
    depths: Vec<f64>,
    drift: DriftModel,
    drift_factor: f64,
    antenna_in_camera: Vector3<f64>,
    forward_in_camera: Vector3<f64>,
    start: Vec<Similarity<Enu, Camera>>,
    places: Vec<Similarity<Enu, Camera>>,
    information: Vec<Matrix3<f64>>,
}

impl<'a> Problem<'a> {
    fn new(
        ties: &'a [&'a Tie],
        keyframes: &'a BTreeMap<KeyframeId, KeyframePose>,
        depths: &Depths,
        start: &Similarity<Enu, Map>,
        settings: &GeoreferenceSettings,
    ) -> Self {
        let first = ties.iter().map(|tie| tie.keyframe).min();
        let keyframes: Vec<&KeyframePose> = keyframes
            .values()
            .filter(|keyframe| Some(keyframe.id) >= first)
            .collect();
        let node_of = |tie: &&Tie| keyframes.partition_point(|one| one.id < tie.keyframe);
        let places: Vec<_> = keyframes
            .iter()
            .map(|keyframe| *start * keyframe.map_from_camera)
            .collect();
        let camera_from_body = settings.body_from_camera.inverse();
        let information = |tie: &&Tie| tie.fix.covariance.try_inverse().unwrap_or_default();
        Self {
            node_of_tie: ties.iter().map(node_of).collect(),
            information: ties.iter().map(information).collect(),
            antenna_in_camera: camera_from_body * settings.antenna_in_body,
            forward_in_camera: camera_from_body.rotation() * Vector3::x(),
            drift: settings.drift,
            drift_factor: 1.0,
            start: places.clone(),
            places,
            depths: keyframes
                .iter()
                .map(|keyframe| depths.near(keyframe.id, start.scale()))
                .collect(),
            keyframes,
            ties,
        }
    }

    fn minimise(&mut self) -> Option<Solution> {
        for _ in 0..ITERATION_COUNT_MAX {
            let mut system = self.linearise();
            let steps = system.solve()?;
            let mut largest = 0.0_f64;
            for (place, step) in self.places.iter_mut().zip(&steps) {
                let turn = step.fixed_rows::<3>(0).norm().max(step[6].abs());
                let moved = step.fixed_rows::<3>(3).norm() * place.scale();
                largest = largest.max(turn).max(moved / 10.0);
                // A step beyond half a radian is outside of what the derivatives describe.
                let clip = (0.5 / turn.max(1e-12)).min(1.0);
                *place = place.perturbed(&(step * clip));
            }
            if !largest.is_finite() {
                return None;
            }
            if largest < 1e-5 {
                break;
            }
        }
        let covariances = self.linearise().marginals()?;
        let nodes = self.keyframes.iter().zip(&self.places).zip(covariances);
        Some(Solution {
            nodes: nodes
                .map(|((keyframe, place), covariance)| Node {
                    keyframe: keyframe.id,
                    enu_from_camera: *place,
                    covariance,
                })
                .collect(),
            residuals_squared: self.residuals_squared(),
            drift_factor: self.drift_factor,
        })
    }

    /// The solution under the most likely drift that is not above the model's. Its covariances are
    /// the means over all those drifts, each weighted by how likely it is, since a few fixes do
    /// not tell one from another.
    fn narrowed(&mut self, solution: Solution) -> Option<Solution> {
        let mut candidates = vec![(self.surprise()?, solution)];
        while self.drift_factor > DRIFT_FACTOR_MIN {
            self.drift_factor *= 0.5;
            let narrower = self.minimise()?;
            candidates.push((self.surprise()?, narrower));
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
        let least = candidates.first()?.0;
        let mut weight_sum = 0.0;
        let mut covariances = vec![Matrix7::zeros(); self.places.len()];
        for (surprise, candidate) in &candidates {
            let weight = (0.5 * (least - surprise)).exp();
            weight_sum += weight;
            for (sum, node) in covariances.iter_mut().zip(&candidate.nodes) {
                *sum += node.covariance * weight;
            }
        }
        let (_, mut best) = candidates.swap_remove(0);
        for (node, sum) in best.nodes.iter_mut().zip(covariances) {
            node.covariance = sum / weight_sum;
        }
        Some(best)
    }

    /// Minus twice the logarithm of the drift factor's posterior, up to a constant: the marginal
    /// likelihood of the fixes by Laplace, with one factor of two as the factor's deviation.
    fn surprise(&self) -> Option<f64> {
        let squared = self.residuals_squared();
        let gate = gate(&squared);
        let of_fixes: f64 = squared.iter().map(|one| one * tie_weight(*one, gate)).sum();
        let steps = 1..self.places.len();
        let log_steps: f64 = steps.map(|idx| -self.step(idx).1.map(f64::ln).sum()).sum();
        let prior = self.drift_factor.log2().powi(2);
        let log_hessian = self.linearise().log_determinant()?;
        Some(of_fixes + self.cost_of_steps() + log_hessian + log_steps + prior)
    }

    fn linearise(&self) -> Tridiagonal {
        let mut system = Tridiagonal::new(self.places.len());
        self.add_prior(&mut system);
        for idx in 1..self.places.len() {
            self.add_step(&mut system, idx);
        }
        let residuals_squared = self.residuals_squared();
        let gate = gate(&residuals_squared);
        for (tie_idx, residual_squared) in residuals_squared.iter().enumerate() {
            self.add_tie(&mut system, tie_idx, tie_weight(*residual_squared, gate));
        }
        system
    }

    fn add_prior(&self, system: &mut Tridiagonal) {
        let extent = self
            .places
            .iter()
            .map(|place| (place.translation() - self.places[0].translation()).norm())
            .fold(1.0, f64::max);
        let position = PRIOR_POSITION_SHARE * extent / self.places[0].scale();
        let sigma = [PRIOR_ROTATION_RAD, position, PRIOR_LOG_SCALE];
        let error = (self.start[0].inverse() * self.places[0]).log();
        let weight = Tangent7::from_fn(|row, _| sigma[row / 3].powi(-2));
        system.add_diagonal(
            0,
            &Matrix7::from_diagonal(&weight),
            &-error.component_mul(&weight),
        );
    }

    fn add_step(&self, system: &mut Tridiagonal, idx: usize) {
        let (error, weight) = self.step(idx);
        let predicted = self.places[idx - 1].inverse() * self.places[idx];
        let about_scene = self.about_scene(idx);
        let d_error_d_first = -predicted.inverse().adjoint();
        let weight = about_scene.transpose() * Matrix7::from_diagonal(&weight) * about_scene;
        system.add_pair(idx - 1, &d_error_d_first, &weight, &error);
    }

    /// From a tangent at keyframe `idx` to one that moves the scene ahead: `ν + ω × p`. A change
    /// of scale is about the camera.
    fn about_scene(&self, idx: usize) -> Matrix7 {
        let scene = Vector3::z() * self.depths[idx];
        let mut about_scene = Matrix7::identity();
        about_scene
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&-so3::hat(&scene));
        about_scene
    }

    /// The error of the map's step to keyframe `idx` from the one before, `e = log(M⁻¹ Xᵢ⁻¹ Xⱼ)`,
    /// and the inverse variances of its components about the scene.
    fn step(&self, idx: usize) -> (Tangent7, Tangent7) {
        let measured =
            self.keyframes[idx - 1].map_from_camera.inverse() * self.keyframes[idx].map_from_camera;
        let predicted = self.places[idx - 1].inverse() * self.places[idx];
        let error: Tangent7 = (measured.inverse() * predicted).log();
        let depth = self.depths[idx];
        let way = measured.translation().norm() / depth;
        let turn_rad = measured.rotation().angle();
        let drift = &self.drift;
        let rotation =
            (drift.rotation_rad.powi(2) * way + (drift.rotation_per_rad * turn_rad).powi(2) + 1e-8)
                .sqrt();
        let log_scale =
            (drift.log_scale.powi(2) * way + (drift.log_scale_per_rad * turn_rad).powi(2) + 1e-8)
                .sqrt();
        let factor = self.drift_factor;
        // A millimetre for what the pose of a keyframe is uncertain by at least.
        let translation =
            (factor * drift.translation * depth * way.sqrt()).hypot(1e-3 / self.start[0].scale());
        let sigma = [rotation * factor, translation, log_scale * factor];
        (error, Tangent7::from_fn(|row, _| sigma[row / 3].powi(-2)))
    }

    fn add_tie(&self, system: &mut Tridiagonal, tie_idx: usize, weight: f64) {
        let tie = self.ties[tie_idx];
        let node_idx = self.node_of_tie[tie_idx];
        let place = &self.places[node_idx];
        let camera = tie.keyframe_from_camera.translation();
        let lever = tie.keyframe_from_camera.rotation() * self.antenna_in_camera;
        let rotation = *place.rotation().to_rotation_matrix().matrix();
        let mut jacobian = Matrix3x7::zeros();
        let turned = rotation * -(so3::hat(camera) * place.scale() + so3::hat(&lever));
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&turned);
        jacobian
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&place.linear_matrix());
        jacobian
            .fixed_view_mut::<3, 1>(0, 6)
            .copy_from(&(place.linear_matrix() * camera));
        let information = self.information[tie_idx] * weight;
        let weighted = jacobian.transpose() * information;
        system.add_diagonal(
            node_idx,
            &(weighted * jacobian),
            &(weighted * self.residual(tie_idx)),
        );

        let enu_from_camera = rotation * tie.keyframe_from_camera.rotation_matrix();
        if let Some(heading) = tie.fix.heading {
            let forward = enu_from_camera * self.forward_in_camera;
            let horizontal_squared = forward.xy().norm_squared();
            // Straight up or down there is no heading.
            if horizontal_squared > 0.03 {
                let error = wrap(heading.angle_rad - forward.y.atan2(forward.x));
                let d_angle_d_forward =
                    Vector3::new(-forward.y, forward.x, 0.0) / horizontal_squared;
                let in_keyframe = tie.keyframe_from_camera.rotation() * self.forward_in_camera;
                let d_forward_d_turn = -rotation * so3::hat(&in_keyframe);
                let row = (d_angle_d_forward.transpose() * d_forward_d_turn).transpose();
                system.add_turn(node_idx, &row, error, heading.sigma_rad);
            }
        }
        if let Some(up) = tie.up_in_camera {
            let in_keyframe = tie.keyframe_from_camera.rotation() * up.into_inner();
            let up_in_enu = rotation * in_keyframe;
            let d_up_d_turn = -rotation * so3::hat(&in_keyframe);
            for axis in 0..2 {
                let row = d_up_d_turn.row(axis).transpose();
                system.add_turn(node_idx, &row, -up_in_enu[axis], UP_SIGMA_RAD);
            }
        }
    }

    /// Fix minus predicted antenna, in ENU.
    fn residual(&self, tie_idx: usize) -> Vector3<f64> {
        let tie = self.ties[tie_idx];
        let place = &self.places[self.node_of_tie[tie_idx]];
        let lever = tie.keyframe_from_camera.rotation() * self.antenna_in_camera;
        let antenna = *place * *tie.keyframe_from_camera.translation() + place.rotation() * lever;
        tie.fix.antenna_in_enu - antenna
    }

    fn residuals_squared(&self) -> Vec<f64> {
        let squared = |tie_idx: usize| {
            let residual = self.residual(tie_idx);
            residual.dot(&(self.information[tie_idx] * residual))
        };
        (0..self.ties.len()).map(squared).collect()
    }

    /// The cost of fixes and steps together per degree of freedom: one if noise and drift are as
    /// stated. Each step has as many components as the keyframe it leads to has unknowns.
    fn total_excess(&self) -> f64 {
        let squared = self.residuals_squared();
        let gate = gate(&squared);
        let inliers: Vec<f64> = squared.into_iter().filter(|one| *one < gate).collect();
        (inliers.iter().sum::<f64>() + self.cost_of_steps()) / (3.0 * inliers.len() as f64)
    }

    fn cost_of_steps(&self) -> f64 {
        let steps = (1..self.places.len()).map(|idx| {
            let (error, weight) = self.step(idx);
            let error = self.about_scene(idx) * error;
            error.component_mul(&error).dot(&weight)
        });
        steps.sum()
    }

    /// Whether neighbouring fixes err alike, as where the map bends, not independently.
    fn residuals_are_correlated(&self) -> bool {
        let squared = self.residuals_squared();
        let gate = 6.0 * median(&squared);
        let (mut product, mut power) = (0.0, 0.0);
        for idx in 1..self.ties.len() {
            if squared[idx] < gate && squared[idx - 1] < gate {
                let residual = self.residual(idx);
                product += residual.dot(&self.residual(idx - 1));
                power += residual.norm_squared();
            }
        }
        product > 0.2 * power
    }
}

impl Tridiagonal {
    /// A scalar that depends on the rotation alone.
    fn add_turn(&mut self, idx: usize, d_value_d_turn: &Vector3<f64>, error: f64, sigma: f64) {
        let mut row = RowVector7::zeros();
        row.fixed_view_mut::<1, 3>(0, 0)
            .copy_from(&d_value_d_turn.transpose());
        let weight = sigma.powi(-2);
        let hessian = row.transpose() * row * weight;
        self.add_diagonal(idx, &hessian, &(row.transpose() * (error * weight)));
    }
}

/// Squared residuals beyond this are outliers.
fn gate(residuals_squared: &[f64]) -> f64 {
    CHI2_GATE.max(6.0 * median(residuals_squared))
}

/// No loss of efficiency within the gate, little influence beyond it.
fn tie_weight(residual_squared: f64, gate: f64) -> f64 {
    (gate / residual_squared.max(gate)).powi(2)
}

fn wrap(angle_rad: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle_rad - turn * (angle_rad / turn).round()
}

pub(super) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

//! Residuals, their derivatives, and the blocks of the normal equations.

use geometry::RobustKernel;
use geometry::absolute_pose::d_position_d_pose;
use nalgebra::{Matrix3, Matrix6x3, Vector2, Vector3, Vector6};

use super::workspace::{Estimate, PointBlock, PoseBlock, SortedObservation};
use super::{BundleObservation, BundleProblem, Workspace};
use crate::triangulation::d_position_d_point;

/// What an observation costs whose point is behind the camera: as a residual of 100 sigmas.
const BEHIND_CAMERA_SQUARED: f64 = 1e4;

/// Robust cost of an estimate over the used observations, summed in order.
pub(super) fn cost(
    problem: &BundleProblem,
    sorted: &[SortedObservation],
    estimate: &Estimate,
    kernel: RobustKernel,
) -> f64 {
    let mut sum = 0.0;
    for sorted in sorted.iter().filter(|sorted| sorted.used) {
        let observation = &problem.observations[sorted.idx];
        let squared = Projection::new(estimate, observation).map_or(BEHIND_CAMERA_SQUARED, |p| {
            p.residual(observation).norm_squared()
        });
        sum += kernel.cost(squared);
    }
    sum
}

/// The squared, whitened residual of each observation, `None` behind the camera.
pub(super) fn residual_squared(
    estimate: &Estimate,
    observation: &BundleObservation,
) -> Option<f64> {
    Projection::new(estimate, observation)
        .map(|projection| projection.residual(observation).norm_squared())
        .filter(|squared| squared.is_finite())
}

/// Fills the blocks of the normal equations at the current estimate.
pub(super) fn linearise(problem: &BundleProblem, workspace: &mut Workspace, kernel: RobustKernel) {
    workspace.pose_blocks.fill(PoseBlock::default());
    for point_idx in 0..problem.points.len() {
        let mut point_block = PointBlock::default();
        for k in workspace.starts[point_idx]..workspace.starts[point_idx + 1] {
            let sorted = workspace.sorted[k];
            workspace.couplings[k] = Matrix6x3::zeros();
            if !sorted.used {
                continue;
            }
            let observation = &problem.observations[sorted.idx];
            let Some(projection) = Projection::new(&workspace.current, observation) else {
                continue;
            };
            let row = projection.whitened_row(&workspace.current, observation, kernel);
            row.add_to_point(&mut point_block);
            if let Some(pose_row) = sorted.row {
                row.add_to_pose(&mut workspace.pose_blocks[pose_row]);
                workspace.couplings[k] = row.coupling();
            }
        }
        workspace.point_blocks[point_idx] = point_block;
    }
    for block in &mut workspace.pose_blocks {
        block.hessian.fill_upper_triangle_with_lower_triangle();
    }
}

/// Where an observation should be, by an estimate.
struct Projection {
    position: Vector2<f64>,
    inverse_depth: f64,
}

impl Projection {
    fn new(estimate: &Estimate, observation: &BundleObservation) -> Option<Self> {
        let (rotation, translation) = &estimate.matrices[observation.pose_idx];
        let point = rotation * estimate.points[observation.point_idx] + translation;
        let inverse_depth = 1.0 / point.z;
        (point.z > 0.0).then(|| Self {
            position: point.xy() * inverse_depth,
            inverse_depth,
        })
    }

    fn residual(&self, observation: &BundleObservation) -> Vector2<f64> {
        (self.position - observation.position) / observation.sigma
    }

    fn whitened_row(
        &self,
        estimate: &Estimate,
        observation: &BundleObservation,
        kernel: RobustKernel,
    ) -> WhitenedRow {
        let residual = self.residual(observation);
        let weight = kernel.weight(residual.norm_squared()).sqrt();
        let scale = weight / observation.sigma;
        let rotation: &Matrix3<f64> = &estimate.matrices[observation.pose_idx].0;
        let d_pose = d_position_d_pose(&self.position, self.inverse_depth);
        let d_point = d_position_d_point(rotation, &self.position, self.inverse_depth);
        WhitenedRow {
            residual: residual * weight,
            d_residual_d_pose: d_pose.map(|row| row * scale),
            d_residual_d_point: d_point.map(|row| row.transpose() * scale),
        }
    }
}

/// The two residuals of an observation and their derivatives, divided by its sigma and times
/// the root of its robust weight.
struct WhitenedRow {
    residual: Vector2<f64>,
    d_residual_d_pose: [Vector6<f64>; 2],
    d_residual_d_point: [Vector3<f64>; 2],
}

impl WhitenedRow {
    fn add_to_point(&self, block: &mut PointBlock) {
        for (d_point, residual) in self.d_residual_d_point.iter().zip(self.residual.iter()) {
            block.gradient += d_point * *residual;
            block.hessian += d_point * d_point.transpose();
        }
    }

    /// Adds to the lower triangle only.
    fn add_to_pose(&self, block: &mut PoseBlock) {
        let [first, second] = &self.d_residual_d_pose;
        block.gradient += first * self.residual.x + second * self.residual.y;
        for column in 0..6 {
            for row in column..6 {
                block.hessian[(row, column)] +=
                    first[row] * first[column] + second[row] * second[column];
            }
        }
    }

    fn coupling(&self) -> Matrix6x3<f64> {
        let [first_pose, second_pose] = &self.d_residual_d_pose;
        let [first_point, second_point] = &self.d_residual_d_point;
        Matrix6x3::from_fn(|row, column| {
            first_pose[row] * first_point[column] + second_pose[row] * second_point[column]
        })
    }
}

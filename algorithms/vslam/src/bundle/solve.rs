//! One damped step: points are eliminated, the poses' system is solved, points follow.

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3};

use super::Workspace;
use super::workspace::PointBlock;
use crate::block_cholesky::NotPositiveDefinite;

/// What a step promises.
pub(super) struct Step {
    /// How much the quadratic model's cost falls.
    pub predicted_decrease: f64,
}

/// Solves `(H + λ diag H) δ = −g` into the workspace's steps.
pub(super) fn solve(workspace: &mut Workspace, damping: f64) -> Result<Step, NotPositiveDefinite> {
    reduce(workspace, damping);
    workspace.reduced.factorise()?;
    workspace.reduced.solve(&mut workspace.pose_steps);
    substitute(workspace);
    Ok(Step {
        predicted_decrease: predicted_decrease(workspace, damping),
    })
}

/// Builds the reduced system of the poses and its right-hand side (in `pose_steps`).
pub(super) fn reduce(workspace: &mut Workspace, damping: f64) {
    workspace.reduced.set_zero();
    for (row, block) in workspace.pose_blocks.iter().enumerate() {
        let mut damped = block.hessian;
        for axis in 0..6 {
            damped[(axis, axis)] += damping * damped[(axis, axis)].max(DIAGONAL_MIN);
        }
        *workspace.reduced.block_mut(row, row) = damped;
        workspace.pose_steps[row] = -block.gradient;
    }
    for point_idx in 0..workspace.point_blocks.len() {
        eliminate(workspace, point_idx, damping);
    }
}

/// Keeps a pose without observations where it is.
const DIAGONAL_MIN: f64 = 1e-9;

/// Subtracts what a point says about the poses that see it.
fn eliminate(workspace: &mut Workspace, point_idx: usize, damping: f64) {
    let block = &mut workspace.point_blocks[point_idx];
    block.factor_inverse = damped_factor_inverse(block, damping);
    let Some(factor_inverse) = block.factor_inverse else {
        return;
    };
    let whitened_gradient = factor_inverse * block.gradient;
    let range = workspace.starts[point_idx]..workspace.starts[point_idx + 1];
    for k in range.clone() {
        let Some(row) = workspace.sorted[k].row else {
            break;
        };
        if !workspace.sorted[k].used {
            continue;
        }
        let whitened = times_lower_transposed(&workspace.couplings[k], &factor_inverse);
        workspace.whitened[k] = whitened;
        workspace.pose_steps[row] += whitened * whitened_gradient;
        for other in range.start..=k {
            let observation = &workspace.sorted[other];
            let Some(column) = observation.row.filter(|_| observation.used) else {
                continue;
            };
            let target = workspace.reduced.block_mut(row, column);
            subtract_product(target, &whitened, &workspace.whitened[other]);
            if other != k && column == row {
                // A pose that sees the point twice.
                subtract_product(target, &workspace.whitened[other], &whitened);
            }
        }
    }
}

/// `L⁻¹` of the damped block `L Lᵀ`.
fn damped_factor_inverse(block: &PointBlock, damping: f64) -> Option<Matrix3<f64>> {
    let mut damped = block.hessian;
    for axis in 0..3 {
        damped[(axis, axis)] *= 1.0 + damping;
    }
    let factor = damped.cholesky()?.unpack();
    let inverse = factor.solve_lower_triangular(&Matrix3::identity())?;
    inverse
        .iter()
        .all(|entry| entry.is_finite())
        .then_some(inverse)
}

/// `coupling · lowerᵀ`, leaving out the zeros.
fn times_lower_transposed(coupling: &Matrix6x3<f64>, lower: &Matrix3<f64>) -> Matrix6x3<f64> {
    let (x, y, z) = (coupling.column(0), coupling.column(1), coupling.column(2));
    Matrix6x3::from_columns(&[
        x * lower[(0, 0)],
        x * lower[(1, 0)] + y * lower[(1, 1)],
        x * lower[(2, 0)] + y * lower[(2, 1)] + z * lower[(2, 2)],
    ])
}

/// `target -= left rightᵀ`: the innermost loop of all, written for the vectoriser.
fn subtract_product(target: &mut Matrix6<f64>, left: &Matrix6x3<f64>, right: &Matrix6x3<f64>) {
    for column in 0..6 {
        let (a, b, c) = (right[(column, 0)], right[(column, 1)], right[(column, 2)]);
        for row in 0..6 {
            target[(row, column)] -= left[(row, 0)] * a + left[(row, 1)] * b + left[(row, 2)] * c;
        }
    }
}

/// The points' steps that belong to the poses' steps.
fn substitute(workspace: &mut Workspace) {
    for (point_idx, block) in workspace.point_blocks.iter().enumerate() {
        let Some(factor_inverse) = block.factor_inverse else {
            workspace.point_steps[point_idx] = Vector3::zeros();
            continue;
        };
        let mut whitened = factor_inverse * block.gradient;
        for k in workspace.starts[point_idx]..workspace.starts[point_idx + 1] {
            let Some(row) = workspace.sorted[k].row else {
                break;
            };
            if workspace.sorted[k].used {
                whitened += workspace.whitened[k].tr_mul(&workspace.pose_steps[row]);
            }
        }
        workspace.point_steps[point_idx] = -factor_inverse.tr_mul(&whitened);
    }
}

/// `½ δᵀ (λ D δ − g)`, twice, because costs here are without the half.
fn predicted_decrease(workspace: &Workspace, damping: f64) -> f64 {
    let mut sum = 0.0;
    for (block, step) in workspace.pose_blocks.iter().zip(&workspace.pose_steps) {
        for axis in 0..6 {
            let diagonal = block.hessian[(axis, axis)].max(DIAGONAL_MIN);
            sum += step[axis] * (damping * diagonal * step[axis] - block.gradient[axis]);
        }
    }
    for (block, step) in workspace.point_blocks.iter().zip(&workspace.point_steps) {
        for axis in 0..3 {
            let diagonal = block.hessian[(axis, axis)];
            sum += step[axis] * (damping * diagonal * step[axis] - block.gradient[axis]);
        }
    }
    sum
}

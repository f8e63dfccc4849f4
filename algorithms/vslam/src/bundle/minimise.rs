//! The Levenberg–Marquardt loop around linearisation and solution.

use geometry::{Camera, RobustKernel, Transform};
use nalgebra::{Matrix6, Vector6};

use super::linearise::{cost, linearise, residual_squared};
use super::solve::{reduce, solve};
use super::{BundleProblem, BundleReport, BundleSettings, Workspace};

/// Moves the free poses and the points of `problem` to where they fit its observations best.
///
/// Deterministic. Allocates only where `workspace` has not yet held a problem as large, and for
/// the report. Cost: measured in `benches/bundle.rs`.
///
/// # Panics
/// If an observation's index is out of range: that is a bug of the caller.
pub fn adjust(
    problem: &mut BundleProblem,
    settings: &BundleSettings,
    workspace: &mut Workspace,
) -> BundleReport {
    workspace.prepare(problem);
    let kernel = RobustKernel::Huber {
        threshold: settings.chi_squared_max.sqrt(),
    };
    let mut report = BundleReport {
        cost_before: cost(problem, &workspace.sorted, &workspace.current, kernel),
        ..BundleReport::default()
    };
    let robust = minimise(
        problem,
        workspace,
        kernel,
        settings.iteration_count_max,
        settings,
    );
    report.iteration_count = robust.iteration_count;
    report.damping = robust.damping;
    report.converged = robust.converged;
    report.cost_after = robust.cost;
    if settings.refit_iteration_count_max > 0 {
        leave_out_outliers(problem, workspace, settings.chi_squared_max);
        let count_max = settings.refit_iteration_count_max;
        let plain = minimise(problem, workspace, RobustKernel::None, count_max, settings);
        report.iteration_count += plain.iteration_count;
        report.converged = plain.converged;
        report.cost_after = cost_of_all(problem, workspace, kernel);
    }
    for (pose, adjusted) in problem.poses.iter_mut().zip(&workspace.current.poses) {
        pose.camera_from_map = *adjusted;
    }
    problem.points.clone_from(&workspace.current.points);
    classify(problem, workspace, settings, &mut report);
    add_covariances(problem, workspace, settings, &mut report);
    report
}

struct Minimum {
    cost: f64,
    iteration_count: usize,
    converged: bool,
    damping: f64,
}

fn minimise(
    problem: &BundleProblem,
    workspace: &mut Workspace,
    kernel: RobustKernel,
    iteration_count_max: usize,
    settings: &BundleSettings,
) -> Minimum {
    let mut minimum = Minimum {
        cost: cost(problem, &workspace.sorted, &workspace.current, kernel),
        iteration_count: 0,
        converged: false,
        damping: settings.damping,
    };
    let mut damping = settings.damping;
    let mut growth = 2.0;
    let mut stale = true;
    while minimum.iteration_count < iteration_count_max && !minimum.converged {
        minimum.iteration_count += 1;
        if stale {
            linearise(problem, workspace, kernel);
            stale = false;
        }
        let Ok(step) = solve(workspace, damping) else {
            damping *= growth;
            growth *= 2.0;
            continue;
        };
        apply_step(workspace);
        let moved_cost = cost(problem, &workspace.sorted, &workspace.moved, kernel);
        let decrease = minimum.cost - moved_cost;
        if decrease >= 0.0 {
            // Nielsen's rule: the damping follows how well the model predicted the decrease.
            let gain_ratio = decrease / step.predicted_decrease.max(f64::MIN_POSITIVE);
            damping *= (1.0 - (2.0 * gain_ratio - 1.0).powi(3)).clamp(0.1, 2.0);
            growth = 2.0;
            minimum.converged = decrease <= settings.cost_decrease_min * minimum.cost;
            minimum.cost = moved_cost;
            std::mem::swap(&mut workspace.current, &mut workspace.moved);
            stale = true;
        } else {
            // Also where the cost is not a number.
            damping *= growth;
            growth *= 2.0;
            minimum.converged =
                step.predicted_decrease <= settings.cost_decrease_min * minimum.cost;
        }
    }
    minimum.damping = damping;
    minimum
}

/// Writes the estimate that the steps lead to.
fn apply_step(workspace: &mut Workspace) {
    for (pose_idx, row) in workspace.rows.iter().enumerate() {
        if let Some(row) = row {
            let step: Vector6<f64> = -workspace.pose_steps[*row];
            let moved = Transform::<Camera, Camera>::exp(&step) * workspace.current.poses[pose_idx];
            workspace.moved.set_pose(pose_idx, moved);
        }
    }
    let points = workspace.current.points.iter().zip(&workspace.point_steps);
    for (moved, (point, step)) in workspace.moved.points.iter_mut().zip(points) {
        *moved = point + step;
    }
}

fn leave_out_outliers(problem: &BundleProblem, workspace: &mut Workspace, chi_squared_max: f64) {
    for sorted in workspace.sorted.iter_mut().filter(|sorted| sorted.used) {
        let squared = residual_squared(&workspace.current, &problem.observations[sorted.idx]);
        sorted.used = squared.is_some_and(|squared| squared <= chi_squared_max);
    }
    workspace.leave_out_lonely_points();
}

/// The robust cost with the left-out outliers back in, to compare with the cost before.
fn cost_of_all(problem: &BundleProblem, workspace: &mut Workspace, kernel: RobustKernel) -> f64 {
    let refitted = std::mem::take(&mut workspace.current);
    workspace.prepare(problem);
    workspace.current = refitted;
    cost(problem, &workspace.sorted, &workspace.current, kernel)
}

fn classify(
    problem: &BundleProblem,
    workspace: &mut Workspace,
    settings: &BundleSettings,
    report: &mut BundleReport,
) {
    let mut squared_sum = 0.0;
    let mut inlier_count = 0;
    report.inliers.resize(problem.observations.len(), false);
    for sorted in &mut workspace.sorted {
        let observation = &problem.observations[sorted.idx];
        let squared = residual_squared(&workspace.current, observation)
            .filter(|squared| *squared <= settings.chi_squared_max && observation.is_usable());
        report.inliers[sorted.idx] = squared.is_some();
        report.inlier_count += usize::from(squared.is_some());
        // Unknowns are counted against what determines them.
        sorted.used &= squared.is_some();
        if sorted.used {
            squared_sum += squared.unwrap_or_default();
            inlier_count += 1;
        }
    }
    workspace.leave_out_lonely_points();
    let point_count = workspace
        .starts
        .windows(2)
        .filter(|range| workspace.sorted[range[0]..range[1]].iter().any(|o| o.used))
        .count();
    let unknown_count = 6 * workspace.pose_blocks.len() + 3 * point_count;
    let expected = expected_squared_sum(inlier_count, unknown_count, settings.chi_squared_max);
    report.variance_factor = expected.map(|expected| squared_sum / expected);
}

/// The mean of the inliers' sum of squared residuals, if there are more of them than unknowns.
///
/// The fit leaves each residual the share `v = 1 − unknowns / residuals` of its variance; cutting
/// its χ² distribution at `c` then leaves the mean `2 v − c e / (1 − e)` with `e = exp(−c / 2v)`.
fn expected_squared_sum(
    inlier_count: usize,
    unknown_count: usize,
    chi_squared_max: f64,
) -> Option<f64> {
    let share = 1.0 - unknown_count as f64 / (2.0 * inlier_count as f64);
    if share.is_nan() || share <= 0.0 {
        return None;
    }
    let tail = (-0.5 * chi_squared_max / share).exp();
    let mean = 2.0 * share - chi_squared_max * tail / (1.0 - tail);
    Some(mean * inlier_count as f64)
}

fn add_covariances(
    problem: &BundleProblem,
    workspace: &mut Workspace,
    settings: &BundleSettings,
    report: &mut BundleReport,
) {
    if !settings.point_covariances && !settings.pose_covariances {
        return;
    }
    linearise(problem, workspace, RobustKernel::None);
    if settings.point_covariances {
        report.point_covariances = workspace
            .point_blocks
            .iter()
            .map(|block| Some(block.hessian.cholesky()?.inverse()))
            .collect();
    }
    if settings.pose_covariances {
        report.pose_covariances = pose_covariances(workspace);
    }
}

/// The diagonal blocks of the inverse of the reduced system without damping.
fn pose_covariances(workspace: &mut Workspace) -> Vec<Option<Matrix6<f64>>> {
    reduce(workspace, 0.0);
    let determined = workspace.reduced.factorise().is_ok();
    let rows = std::mem::take(&mut workspace.rows);
    let covariances = rows
        .iter()
        .map(|row| {
            let row = row.filter(|_| determined)?;
            let mut covariance = Matrix6::zeros();
            for axis in 0..6 {
                workspace.pose_steps.fill(Vector6::zeros());
                workspace.pose_steps[row][axis] = 1.0;
                workspace.reduced.solve(&mut workspace.pose_steps);
                covariance.set_column(axis, &workspace.pose_steps[row]);
            }
            Some(covariance)
        })
        .collect();
    workspace.rows = rows;
    covariances
}

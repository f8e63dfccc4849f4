//! The relative pose that fits all inliers best.

use geometry::{Camera, RobustKernel, Transform, so3};
use nalgebra::{Matrix3, Matrix5, Vector3, Vector5};

use super::essential::Essential;
use super::pair::{CHI_SQUARED_1_P95, Pair};
use super::ransac::Model;

/// Steps over a fixed set of inliers.
#[derive(Clone, Copy, Debug)]
pub(super) struct RefineRound {
    /// Squared residuals in sigmas above this at the start of the round are left out.
    pub chi_squared_max: f64,
    pub iteration_count: usize,
}

/// Levenberg–Marquardt on Sampson's error with Huber's kernel over rotation and direction.
///
/// `None` if the pairs leave a direction free.
pub(super) fn refine_relative_pose(
    start: &Transform<Camera, Camera>,
    pairs: &[Pair],
    sigma: f64,
    rounds: &[RefineRound],
) -> Option<Transform<Camera, Camera>> {
    let mut pose = *start;
    let mut inliers = Vec::with_capacity(pairs.len());
    for round in rounds {
        let essential = Essential::of_pose(&pose);
        let squared_max = round.chi_squared_max * sigma * sigma;
        inliers.clear();
        inliers.extend(
            pairs
                .iter()
                .filter(|pair| essential.residual_squared(pair) <= squared_max)
                .copied(),
        );
        pose = minimise(pose, &inliers, sigma, round.iteration_count)?;
    }
    Some(pose)
}

fn minimise(
    start: Transform<Camera, Camera>,
    inliers: &[Pair],
    sigma: f64,
    iteration_count: usize,
) -> Option<Transform<Camera, Camera>> {
    let mut pose = start;
    let mut normal = accumulate(&pose, inliers, sigma);
    let mut damping = 1e-4;
    for _ in 0..iteration_count {
        let mut damped = normal.hessian;
        for axis in 0..5 {
            damped[(axis, axis)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&-normal.gradient);
        let moved = moved(&pose, &step);
        let moved_normal = accumulate(&moved, inliers, sigma);
        let gain = normal.cost - moved_normal.cost;
        if gain >= 0.0 {
            pose = moved;
            normal = moved_normal;
            damping *= 0.1;
            if gain < 1e-3 {
                break;
            }
        } else {
            damping *= 10.0;
        }
    }
    Some(pose)
}

/// `R' = exp(ω) R`, and the unit translation moved along its two tangents.
pub(super) fn moved(
    pose: &Transform<Camera, Camera>,
    step: &Vector5<f64>,
) -> Transform<Camera, Camera> {
    let rotation = so3::exp(&step.fixed_rows::<3>(0).into_owned()) * pose.rotation();
    let tangents = tangents(pose.translation());
    let translation = pose.translation() + tangents[0] * step[3] + tangents[1] * step[4];
    Transform::new(rotation, translation.normalize())
}

/// Two directions at right angles to a unit vector and to each other.
fn tangents(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let mut axis = Vector3::zeros();
    axis[direction.abs().imin()] = 1.0;
    let first = direction.cross(&axis).normalize();
    [first, direction.cross(&first)]
}

/// The derivatives of `E = [t]× R` by the five entries of a step.
fn d_essential_d_step(pose: &Transform<Camera, Camera>) -> [Matrix3<f64>; 5] {
    let rotation = pose.rotation_matrix();
    let translation_hat = pose.translation().cross_matrix();
    let tangents = tangents(pose.translation());
    let turned = |axis: Vector3<f64>| translation_hat * axis.cross_matrix() * rotation;
    [
        turned(Vector3::x()),
        turned(Vector3::y()),
        turned(Vector3::z()),
        tangents[0].cross_matrix() * rotation,
        tangents[1].cross_matrix() * rotation,
    ]
}

/// Sampson's signed error of a pair and its derivative.
pub(super) fn sampson_error(
    essential: &Matrix3<f64>,
    derivatives: &[Matrix3<f64>; 5],
    pair: &Pair,
) -> (f64, Vector5<f64>) {
    let line_in_second = essential * pair.first;
    let line_in_first = essential.tr_mul(&pair.second);
    let value = pair.second.dot(&line_in_second);
    let slope_squared = line_in_second.xy().norm_squared() + line_in_first.xy().norm_squared();
    let inverse_slope = 1.0 / slope_squared.sqrt();
    let error = value * inverse_slope;
    let derivative = Vector5::from_fn(|axis, _| {
        let d_line_in_second = derivatives[axis] * pair.first;
        let d_line_in_first = derivatives[axis].tr_mul(&pair.second);
        let d_value = pair.second.dot(&d_line_in_second);
        let d_half_slope_squared = line_in_second.xy().dot(&d_line_in_second.xy())
            + line_in_first.xy().dot(&d_line_in_first.xy());
        (d_value - error * inverse_slope * d_half_slope_squared) * inverse_slope
    });
    (error, derivative)
}

struct NormalEquations {
    hessian: Matrix5<f64>,
    gradient: Vector5<f64>,
    cost: f64,
}

fn accumulate(pose: &Transform<Camera, Camera>, inliers: &[Pair], sigma: f64) -> NormalEquations {
    let kernel = RobustKernel::Huber {
        threshold: CHI_SQUARED_1_P95.sqrt(),
    };
    let essential = Essential::of_pose(pose).0;
    let derivatives = d_essential_d_step(pose);
    let mut normal = NormalEquations {
        hessian: Matrix5::zeros(),
        gradient: Vector5::zeros(),
        cost: 0.0,
    };
    for pair in inliers {
        let (error, derivative) = sampson_error(&essential, &derivatives, pair);
        let (error, derivative) = (error / sigma, derivative / sigma);
        let squared = error * error;
        normal.cost += kernel.cost(squared);
        let weight = kernel.weight(squared);
        normal.gradient += derivative * (weight * error);
        normal.hessian += derivative * derivative.transpose() * weight;
    }
    normal
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    #[test]
    fn sampson_derivative_matches_differences() {
        let tangent = Vector6::new(0.1, -0.2, 0.05, 0.5, 0.2, -0.4);
        let start = Transform::<Camera, Camera>::exp(&tangent);
        let pose = Transform::new(*start.rotation(), start.translation().normalize());
        let pair = Pair {
            first: Vector3::new(0.2, -0.3, 1.0),
            second: Vector3::new(0.1, 0.25, 1.0),
        };
        let error = |pose: &Transform<Camera, Camera>| {
            sampson_error(
                &Essential::of_pose(pose).0,
                &d_essential_d_step(pose),
                &pair,
            )
        };
        let (_, derivative) = error(&pose);
        for axis in 0..5 {
            let mut step = Vector5::zeros();
            step[axis] = 1e-6;
            let (high, low) = (
                error(&moved(&pose, &step)).0,
                error(&moved(&pose, &-step)).0,
            );
            let numeric = (high - low) / 2e-6;
            assert!((numeric - derivative[axis]).abs() < 1e-8, "axis {axis}");
        }
    }
}

//! Residuals of pairs, and their derivatives by `[ω; ν; ln s]`.

use geometry::{Matrix7, RobustKernel, Similarity, Tangent7, so3};
use nalgebra::{Matrix3, SMatrix, Vector3};

use super::pairs::Pair;
use crate::alignment::{Metric, Source, Target};
use crate::cloud::ShapedCloud;

/// Sums over all pairs, each whitened by its metric and weighted by the kernel.
#[derive(Clone, Debug, Default)]
pub(crate) struct NormalEquations {
    pub hessian: Matrix7,
    pub gradient: Tangent7,
    pub cost: f64,
    pub weight_sum: f64,
}

impl NormalEquations {
    pub fn sum(
        source: &ShapedCloud,
        target: &ShapedCloud,
        target_from_source: &Similarity<Target, Source>,
        pairs: &[Pair],
        metric: Metric,
        kernel: RobustKernel,
    ) -> Self {
        let linear = target_from_source.linear_matrix();
        let rotation = linear / target_from_source.scale();
        let mut sums = Self::default();
        for pair in pairs {
            let (source_idx, target_idx) = (pair.source_idx as usize, pair.target_idx as usize);
            let point = &source.points[source_idx];
            let residual = target.points[target_idx] - *target_from_source * *point;
            let information = information(source, target, pair, &rotation, metric);
            let weight = kernel.weight(f64::from(pair.distance_squared));
            // Both sides of the metric in the source's axes: d_residual_d_delta = −s R L.
            let lever = lever(point);
            let in_source = linear.transpose() * information;
            let weighted = (in_source * linear * weight) * lever;
            sums.hessian += lever.transpose() * weighted;
            sums.gradient -= lever.transpose() * (in_source * residual * weight);
            sums.cost += weight * residual.dot(&(information * residual));
            sums.weight_sum += weight;
        }
        sums
    }
}

/// `L` in `exp(δ) x ≈ x + L δ`.
fn lever(point: &Vector3<f64>) -> SMatrix<f64, 3, 7> {
    let mut lever = SMatrix::<f64, 3, 7>::zeros();
    lever
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&-so3::hat(point));
    lever
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&Matrix3::identity());
    lever.fixed_view_mut::<3, 1>(0, 6).copy_from(point);
    lever
}

/// What a pair's residual is whitened by, up to the noise's variance.
pub(crate) fn information(
    source: &ShapedCloud,
    target: &ShapedCloud,
    pair: &Pair,
    rotation: &Matrix3<f64>,
    metric: Metric,
) -> Matrix3<f64> {
    let target_shape = &target.shapes[pair.target_idx as usize];
    match metric {
        Metric::Point => Matrix3::identity(),
        Metric::Plane => match target_shape.normal {
            Some(normal) => normal * normal.transpose(),
            None => Matrix3::identity(),
        },
        Metric::Gicp => {
            let source_shape = &source.shapes[pair.source_idx as usize];
            let sum =
                target_shape.covariance + rotation * source_shape.covariance * rotation.transpose();
            sum.try_inverse().unwrap_or_else(Matrix3::identity) * metric_scale_squared()
        }
    }
}

/// Makes the residual of generalised ICP across two surfaces a length.
fn metric_scale_squared() -> f64 {
    2.0 * crate::cloud::PLANE_THICKNESS
}

#[cfg(test)]
mod tests {
    use geometry::Similarity;
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::Cloud;

    /// Goal: the gradient is that of the cost. Method: central differences of the cost over all
    /// seven axes, in each metric, with pairs and weights held.
    #[test]
    fn gradient_agrees_with_differences() {
        let grid = |count: usize| {
            (0..count).map(|idx| {
                let (x, y) = ((idx % 9) as f64 * 0.1, (idx / 9) as f64 * 0.1);
                Vector3::new(x, y, 0.3 * (3.0 * x).sin() * y)
            })
        };
        let source = ShapedCloud::new(&Cloud::from_points(grid(81).collect()), None);
        let target = ShapedCloud::new(&Cloud::from_points(grid(90).collect()), None);
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.05, 0.08));
        let start: Similarity<Target, Source> =
            Similarity::new(1.1, rotation, Vector3::new(0.02, 0.01, -0.03));
        let mut pairs = Vec::new();
        super::super::find_pairs(&source, &target, &start, 1.0, true, &mut pairs);
        for metric in [Metric::Point, Metric::Plane] {
            let sum = |at: &Similarity<Target, Source>| {
                NormalEquations::sum(&source, &target, at, &pairs, metric, RobustKernel::None)
            };
            let analytic = sum(&start).gradient;
            for axis in 0..7 {
                let mut step = Tangent7::zeros();
                step[axis] = 1e-6;
                let above = sum(&start.perturbed(&step)).cost;
                let below = sum(&start.perturbed(&-step)).cost;
                // The cost is r², its gradient 2 Jᵀ r.
                let difference = (above - below) / 2e-6 / 2.0;
                assert!(
                    (difference - analytic[axis]).abs() < 1e-6 * (1.0 + difference.abs()),
                    "{metric:?} {axis}: {difference} {}",
                    analytic[axis]
                );
            }
        }
    }
}

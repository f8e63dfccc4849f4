//! What a pair's residual is whitened by, up to the noise's variance.

use nalgebra::Matrix3;

use crate::cloud::{PLANE_THICKNESS, Shape};

/// How the distance between the points of a pair counts.
pub(crate) trait PairMetric {
    /// - `rotation`: target from source.
    fn information(source: &Shape, target: &Shape, rotation: &Matrix3<f64>) -> Matrix3<f64>;
}

/// In all directions alike (eq. 6).
pub(crate) struct PointToPoint;

/// Across the target's surface; hardly at all where the target has none.
pub(crate) struct PointToPlane;

/// By the shapes of both points (generalised ICP, Segal et al. 2009): unit variance along a
/// surface and little across, or round where there is none.
pub(crate) struct PlaneToPlane;

impl PairMetric for PointToPoint {
    fn information(source: &Shape, target: &Shape, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        if !source.noise_known && !target.noise_known {
            return Matrix3::identity();
        }
        inverse(&(Matrix3::identity() + noise(source, target, rotation)))
    }
}

impl PairMetric for PointToPlane {
    fn information(source: &Shape, target: &Shape, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        let Some(normal) = target.normal else {
            // As little as generalised ICP makes of a point without a surface.
            return PointToPoint::information(source, target, rotation) * PLANE_THICKNESS;
        };
        let across = normal * normal.transpose();
        if !source.noise_known && !target.noise_known {
            return across;
        }
        let own = normal.dot(&(noise(source, target, rotation) * normal));
        across * (2.0 * PLANE_THICKNESS / (2.0 * PLANE_THICKNESS + own))
    }
}

impl PairMetric for PlaneToPlane {
    #[inline]
    fn information(source: &Shape, target: &Shape, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        let mut sum = Matrix3::identity() * 2.0;
        if let Some(normal) = target.normal {
            sum -= normal * (1.0 - PLANE_THICKNESS) * normal.transpose();
        }
        if let Some(normal) = source.normal {
            let normal = rotation * normal;
            sum -= normal * (1.0 - PLANE_THICKNESS) * normal.transpose();
        }
        if source.noise_known || target.noise_known {
            sum += noise(source, target, rotation);
        }
        // Across two surfaces the residual is a length.
        inverse(&sum) * (2.0 * PLANE_THICKNESS)
    }
}

fn noise(source: &Shape, target: &Shape, rotation: &Matrix3<f64>) -> Matrix3<f64> {
    target.noise + rotation * source.noise * rotation.transpose()
}

/// The inverse of a symmetric positive matrix, by its cofactors.
#[inline]
fn inverse(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let [a, b, c] = [matrix[(0, 0)], matrix[(0, 1)], matrix[(0, 2)]];
    let [d, e, f] = [matrix[(1, 1)], matrix[(1, 2)], matrix[(2, 2)]];
    let (first, second, third) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let scale = 1.0 / (a * first + b * second + c * third);
    let (fourth, fifth, sixth) = (a * f - c * c, b * c - a * e, a * d - b * b);
    Matrix3::new(
        first, second, third, second, fourth, fifth, third, fifth, sixth,
    ) * scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cofactors_invert() {
        let matrix = Matrix3::new(2.0, 0.3, -0.4, 0.3, 1.5, 0.2, -0.4, 0.2, 0.7);
        assert!((inverse(&matrix) * matrix - Matrix3::identity()).norm() < 1e-12);
    }
}

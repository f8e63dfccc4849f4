//! The principal axes of a 3×3 scatter, in closed form.

use std::f64::consts::FRAC_PI_3;

use nalgebra::{Matrix3, Vector3};

/// The eigenvalues of a symmetric matrix, least first (Smith 1961).
///
/// Errors are those of rounding relative to the largest.
pub(super) fn eigenvalues(matrix: &Matrix3<f64>) -> [f64; 3] {
    let mean = matrix.trace() / 3.0;
    let deviation = matrix - Matrix3::identity() * mean;
    let spread = (deviation.norm_squared() / 6.0).sqrt();
    if spread.is_nan() || spread <= f64::MIN_POSITIVE {
        return [mean; 3];
    }
    let half_determinant = (deviation / spread).determinant() / 2.0;
    let angle = half_determinant.clamp(-1.0, 1.0).acos() / 3.0;
    let largest = mean + 2.0 * spread * angle.cos();
    let least = mean + 2.0 * spread * (angle + 2.0 * FRAC_PI_3).cos();
    [least, 3.0 * mean - largest - least, largest]
}

/// The eigenvector of an eigenvalue that is apart from the others; `None` where it is not.
pub(super) fn eigenvector(matrix: &Matrix3<f64>, eigenvalue: f64) -> Option<Vector3<f64>> {
    let rest = matrix - Matrix3::identity() * eigenvalue;
    let rows: [Vector3<f64>; 3] = std::array::from_fn(|row| rest.column(row).into_owned());
    let [first, second, third] = &rows;
    // All rows lie across the eigenvector; of their products the longest is the surest.
    let products = [first.cross(second), second.cross(third), third.cross(first)];
    let longest = products
        .into_iter()
        .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
    longest.try_normalize(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use nalgebra::{SymmetricEigen, UnitQuaternion};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Goal: surfaces of any size, thickness and direction get the values and the normal that
        /// they were made of.
        #[test]
        fn finds_what_a_scatter_was_made_of(
            turn in prop::array::uniform3(-3.0_f64..3.0),
            logarithms in prop::array::uniform3(-4.0_f64..0.0),
            size in -6.0_f64..6.0,
        ) {
            let rotation = UnitQuaternion::from_scaled_axis(turn.into()).to_rotation_matrix();
            let scale = 10_f64.powf(size);
            let mut values = logarithms.map(|one| scale * 10_f64.powf(one));
            values.sort_by(f64::total_cmp);
            let matrix =
                rotation * Matrix3::from_diagonal(&values.into()) * rotation.transpose();
            let found = eigenvalues(&matrix);
            for (found, value) in found.iter().zip(values) {
                prop_assert!((found - value).abs() < 1e-7 * values[2], "{found} {value}");
            }
            prop_assume!(values[1] > 1.5 * values[0]);
            let normal = eigenvector(&matrix, found[0]).unwrap();
            let expected = rotation.matrix().column(0).into_owned();
            let sine = normal.cross(&expected).norm();
            prop_assert!(sine < 1e-4, "{sine}");
        }
    }

    #[test]
    fn agrees_with_an_iterative_solver() {
        let matrix = Matrix3::new(2.0, 0.3, -0.4, 0.3, 1.5, 0.2, -0.4, 0.2, 0.7);
        let mut expected: Vec<f64> = SymmetricEigen::new(matrix)
            .eigenvalues
            .iter()
            .copied()
            .collect();
        expected.sort_by(f64::total_cmp);
        let found = eigenvalues(&matrix);
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-14);
        }
    }

    #[test]
    fn a_spot_has_no_axes() {
        assert_eq!(eigenvalues(&Matrix3::zeros()), [0.0; 3]);
        assert!(eigenvector(&Matrix3::zeros(), 0.0).is_none());
        assert!(eigenvector(&Matrix3::identity(), 1.0).is_none());
    }
}

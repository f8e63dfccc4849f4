//! The epipolar constraint: `second ᵀ E first = 0` with `E = [t]× R`.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::five_point::essential_matrices;
use super::pair::{CHI_SQUARED_1_P95, Pair};
use super::ransac::Model;
use super::refine::{RefineRound, refine_relative_pose};

/// An essential matrix of any scale.
#[derive(Clone, Copy, Debug)]
pub(super) struct Essential(pub Matrix3<f64>);

impl Essential {
    pub(super) fn of_pose(second_from_first: &Transform<Camera, Camera>) -> Self {
        let translation = second_from_first.translation();
        Self(translation.cross_matrix() * second_from_first.rotation_matrix())
    }

    /// The two rotations and two directions of translation, combined. In one of the four the
    /// points lie in front of both cameras.
    pub(super) fn poses(&self) -> [Transform<Camera, Camera>; 4] {
        let svd = self.0.svd(true, true);
        let (u, v_transposed) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
        let turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let rotation = |turn: &Matrix3<f64>| {
            let matrix = u * turn * v_transposed;
            // A reflection here is a rotation for the matrix of opposite sign.
            let proper = matrix * matrix.determinant().signum();
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(proper))
        };
        let (left, right) = (rotation(&turn), rotation(&turn.transpose()));
        let direction: Vector3<f64> = u.column(2).into_owned();
        [
            Transform::new(left, direction),
            Transform::new(left, -direction),
            Transform::new(right, direction),
            Transform::new(right, -direction),
        ]
    }
}

impl Model for Essential {
    const SAMPLE_SIZE: usize = 5;
    const CHI_SQUARED_MAX: f64 = CHI_SQUARED_1_P95;
    const DIMENSION: f64 = 3.0;
    const PARAMETER_COUNT: f64 = 5.0;

    fn fit(pairs: &[Pair], sample: &[usize], models: &mut Vec<Self>) {
        let first = std::array::from_fn(|i| pairs[sample[i]].first);
        let second = std::array::from_fn(|i| pairs[sample[i]].second);
        let mut matrices = Vec::with_capacity(10);
        essential_matrices(&first, &second, &mut matrices);
        models.extend(matrices.into_iter().map(Self));
    }

    /// Sampson's approximation of the squared distance to the nearest pair that fits.
    fn residual_squared(&self, pair: &Pair) -> f64 {
        let line_in_second = self.0 * pair.first;
        let line_in_first = self.0.tr_mul(&pair.second);
        let value = pair.second.dot(&line_in_second);
        let slope = line_in_second.xy().norm_squared() + line_in_first.xy().norm_squared();
        value * value / slope
    }

    fn improve(&self, pairs: &[Pair], sigma: f64) -> Option<Self> {
        let rounds = [RefineRound {
            chi_squared_max: 2.0 * Self::CHI_SQUARED_MAX,
            iteration_count: 4,
        }];
        let refined = refine_relative_pose(&self.poses()[0], pairs, sigma, &rounds)?;
        Some(Self::of_pose(&refined))
    }
}

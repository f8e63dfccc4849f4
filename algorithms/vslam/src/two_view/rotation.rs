//! A camera that turned without moving: what a start must be told apart from.

use nalgebra::{Matrix3, Vector3};

use super::pair::{CHI_SQUARED_2_P95, Pair};
use super::ransac::Model;

/// The rotation `second_from_first`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn(Matrix3<f64>);

impl Turn {
    /// The rotation that brings the pairs' rays closest together (Kabsch).
    fn align(pairs: impl Iterator<Item = Pair>) -> Self {
        let cross: Matrix3<f64> = pairs
            .map(|pair| pair.second.normalize() * pair.first.normalize().transpose())
            .sum();
        let svd = cross.svd(true, true);
        let (u, v_transposed) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
        let sign = (u * v_transposed).determinant().signum();
        Self(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_transposed)
    }
}

impl Model for Turn {
    const SAMPLE_SIZE: usize = 2;
    const CHI_SQUARED_MAX: f64 = CHI_SQUARED_2_P95;
    const DIMENSION: f64 = 2.0;
    const PARAMETER_COUNT: f64 = 3.0;

    fn fit(pairs: &[Pair], sample: &[usize], models: &mut Vec<Self>) {
        models.push(Self::align(sample.iter().map(|idx| pairs[*idx])));
    }

    /// The squared distance to the nearest pair that fits, from the transfer errors both ways.
    fn residual_squared(&self, pair: &Pair) -> f64 {
        let in_second = self.0 * pair.first;
        let in_first = self.0.tr_mul(&pair.second);
        let forward = in_second.xy() / in_second.z - pair.second.xy();
        let backward = in_first.xy() / in_first.z - pair.first.xy();
        // Each error has the noise of both views in it: twice the variance, and counted twice.
        0.25 * (forward.norm_squared() + backward.norm_squared())
    }

    fn improve(&self, pairs: &[Pair], sigma: f64) -> Option<Self> {
        let mut model = *self;
        // Parallax spreads the residuals: start wide, so that the middle is found.
        for factor in [4.0, 2.0, 1.0] {
            let squared_max = factor * Self::CHI_SQUARED_MAX * sigma * sigma;
            let explained = |pair: &&Pair| model.residual_squared(pair) <= squared_max;
            model = Self::align(pairs.iter().filter(explained).copied());
        }
        Some(model)
    }
}

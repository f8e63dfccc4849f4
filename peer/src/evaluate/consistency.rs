//! Whether stated uncertainty is honest.

use geometry::Enu;
use nalgebra::{Cholesky, Matrix3};

use super::associate;
use crate::files::StampedPose;

/// How stated covariances compare with the errors that were made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Consistency {
    /// The share of positions with `eᵀP⁻¹e ≤ 14.16`; honest is 0.9973, or a little less.
    pub inside_3sigma_share: Option<f64>,
    /// The mean of `eᵀP⁻¹e / 3`; honest is one, more is overconfident, less is timid.
    pub nees_mean: Option<f64>,
}

/// 99.73 % of χ² with three degrees of freedom, the mass within three sigma in one dimension.
const CHI_SQUARED_3_SIGMA: f64 = 14.16;

/// Compares each position's error with its covariance (`covariances[i]` belongs to `causal[i]`).
///
/// A covariance that is not positive definite claims the impossible: it counts as outside, and is
/// left out of the mean, which it would make infinite.
pub fn consistency(
    truth: &[StampedPose<Enu>],
    causal: &[StampedPose<Enu>],
    covariances: &[Matrix3<f64>],
) -> Consistency {
    let mut judged_count = 0;
    let mut inside_count = 0;
    let mut normalised = Vec::new();
    for pair in associate(truth, causal) {
        let Some(covariance) = covariances.get(pair.estimate_idx) else {
            continue;
        };
        judged_count += 1;
        let error = causal[pair.estimate_idx].target_from_camera.translation()
            - truth[pair.truth_idx].target_from_camera.translation();
        let Some(cholesky) = Cholesky::new(*covariance) else {
            continue;
        };
        let error_squared = error.dot(&cholesky.solve(&error));
        inside_count += usize::from(error_squared <= CHI_SQUARED_3_SIGMA);
        normalised.push(error_squared / 3.0);
    }
    let mean = |sum: f64, count: usize| (count > 0).then(|| sum / count as f64);
    Consistency {
        inside_3sigma_share: mean(inside_count as f64, judged_count),
        nees_mean: mean(normalised.iter().sum(), normalised.len())
            .filter(|value| value.is_finite()),
    }
}

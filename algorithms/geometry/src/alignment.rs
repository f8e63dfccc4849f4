//! Closed-form alignment of paired points.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::Similarity;

/// Why [`umeyama`] has no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DegenerateAlignment {
    /// Fewer than three pairs, or their weights do not sum to a positive number.
    TooFewPairs,
    /// The points lie on a line (or in one spot): the rotation about it is free.
    Collinear,
}

/// The similarity that maps `source` points to `target` points with the least weighted squared
/// error (Umeyama 1991).
///
/// - `pairs`: `(point_in_target, point_in_source, weight)`, weights at least zero.
/// - `free_scale`: whether the scale is estimated; otherwise it is one.
pub fn umeyama<Target, Source>(
    pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>, f64)> + Clone,
    free_scale: bool,
) -> Result<Similarity<Target, Source>, DegenerateAlignment> {
    let mut weight_sum = 0.0;
    let mut pair_count = 0;
    let mut target_mean = Vector3::zeros();
    let mut source_mean = Vector3::zeros();
    for (target, source, weight) in pairs.clone() {
        weight_sum += weight;
        pair_count += usize::from(weight > 0.0);
        target_mean += target * weight;
        source_mean += source * weight;
    }
    if pair_count < 3 || weight_sum <= 0.0 || !weight_sum.is_finite() {
        return Err(DegenerateAlignment::TooFewPairs);
    }
    target_mean /= weight_sum;
    source_mean /= weight_sum;

    let mut cross = Matrix3::zeros();
    let mut source_variance = 0.0;
    for (target, source, weight) in pairs {
        let centred_source = source - source_mean;
        cross += (target - target_mean) * centred_source.transpose() * (weight / weight_sum);
        source_variance += weight / weight_sum * centred_source.norm_squared();
    }
    let svd = cross.svd(true, true);
    let (u, v_transposed) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
    let spread = svd.singular_values[1] / svd.singular_values[0];
    // One spot gives 0/0.
    if spread.is_nan() || spread <= 1e-9 {
        return Err(DegenerateAlignment::Collinear);
    }
    let mut signs = Vector3::new(1.0, 1.0, 1.0);
    if u.determinant() * v_transposed.determinant() < 0.0 {
        signs.z = -1.0;
    }
    let matrix = u * Matrix3::from_diagonal(&signs) * v_transposed;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    let scale = if free_scale {
        svd.singular_values.dot(&signs) / source_variance
    } else {
        1.0
    };
    if scale <= 0.0 || !scale.is_finite() {
        return Err(DegenerateAlignment::Collinear);
    }
    let translation = target_mean - rotation * source_mean * scale;
    Ok(Similarity::new(scale, rotation, translation))
}

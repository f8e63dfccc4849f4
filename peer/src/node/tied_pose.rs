//! A vehicle's own pose on the Earth, and what it rests on.

use geodesy::Datum;
use geometry::{Camera, Enu, Map, Matrix7, Similarity, Transform, so3};
use nalgebra::{Matrix3, Matrix6, SMatrix};

use super::status::Tie;

/// A pose on the Earth with its covariance `[ω; p]` in the global axes, and what the state rests
/// on.
pub(super) struct TiedPose {
    pub tie: Tie,
    pub pose: Option<(Transform<Enu, Camera>, Matrix6<f64>)>,
    pub datum: Option<Datum>,
    pub jump_count: u64,
    pub overruled_count: u64,
}

/// The covariance of a camera's pose in the global frame, `[ω; p]` in the global axes.
///
/// - `map_covariance`: of `enu_from_map`, `[ω; ν; ln s]`, right perturbation.
/// - `own_covariance`: of `map_from_camera`, `[ω; ν]`, right perturbation.
pub(super) fn pose_covariance(
    enu_from_map: &Similarity<Enu, Map>,
    map_covariance: &Matrix7,
    map_from_camera: &Transform<Map, Camera>,
    own_covariance: Option<&Matrix6<f64>>,
) -> Matrix6<f64> {
    // S exp(δ) x ≈ S x + s R (ω × x + ν + λ x).
    let linear = enu_from_map.linear_matrix();
    let rotation = linear / enu_from_map.scale();
    let position = map_from_camera.translation();
    let mut d_pose_d_map = SMatrix::<f64, 6, 7>::zeros();
    d_pose_d_map
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&rotation);
    d_pose_d_map
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(-linear * so3::hat(position)));
    d_pose_d_map.fixed_view_mut::<3, 3>(3, 3).copy_from(&linear);
    d_pose_d_map
        .fixed_view_mut::<3, 1>(3, 6)
        .copy_from(&(linear * position));
    let mut covariance = d_pose_d_map * map_covariance * d_pose_d_map.transpose();
    if let Some(own_covariance) = own_covariance {
        let axes = map_from_camera.rotation_matrix();
        let mut d_pose_d_own = Matrix6::zeros();
        d_pose_d_own
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(rotation * axes));
        d_pose_d_own
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(linear * axes));
        covariance += d_pose_d_own * own_covariance * d_pose_d_own.transpose();
    }
    covariance
}

pub(super) fn position_block(covariance: &Matrix6<f64>) -> Matrix3<f64> {
    covariance.fixed_view::<3, 3>(3, 3).into_owned()
}

/// One sigma along the axis that is known worst, in the covariance's unit.
pub(super) fn worst_sigma(position_covariance: &Matrix3<f64>) -> f64 {
    let eigenvalues = position_covariance.symmetric_eigenvalues();
    eigenvalues.max().max(0.0).sqrt()
}

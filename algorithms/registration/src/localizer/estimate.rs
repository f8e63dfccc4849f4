//! The place of the own map, with an honest covariance.

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Timestamp, Transform, so3};
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};

use super::types::AnchorIdx;

/// Where the own map stands on the Earth.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub enu_from_map: Similarity<Enu, Map>,
    /// Over `[ω; ν; ln s]`, right perturbation; at the newest alignment.
    pub covariance: Matrix7,
    /// When the newest accepted keyframe was captured.
    pub captured_at: Timestamp,
    /// How long ago that was; zero for a clock that runs backwards.
    pub age_s: f64,
    /// Where the camera was then.
    pub aligned_position_in_map: Vector3<f64>,
    /// Keyframes accepted since the map was born.
    pub accepted_count: u64,
    /// How often the estimate was replaced by one that contradicted it.
    pub jump_count: u64,
    /// The anchors that the estimate rests on.
    pub anchors: Vec<AnchorIdx>,
    /// The anchors that contradict them and were left out.
    pub inconsistent_anchors: Vec<AnchorIdx>,
    /// Two anchors contradict each other and nothing decides between them.
    pub conflict: bool,
    /// Variance that drift adds per unit of distance travelled in the map since the newest
    /// alignment, relative to the distance.
    pub(super) drift_per_length: f64,
}

impl Estimate {
    /// The camera's pose in the global frame.
    pub fn enu_from_camera(
        &self,
        map_from_camera: &Transform<Map, Camera>,
    ) -> Transform<Enu, Camera> {
        self.enu_from_map.transform_pose(map_from_camera)
    }

    /// The covariance of a camera's position in the global frame [m²].
    ///
    /// - `pose_covariance`: of the pose in the map, `[ω; ν]`, right perturbation.
    pub fn position_covariance(
        &self,
        map_from_camera: &Transform<Map, Camera>,
        pose_covariance: Option<&Matrix6<f64>>,
    ) -> Matrix3<f64> {
        self.pose_covariance(map_from_camera, pose_covariance)
            .fixed_view::<3, 3>(3, 3)
            .into_owned()
    }

    /// The covariance of a camera's pose in the global frame: `[ω; p]` with the rotation vector
    /// in the global axes [rad] and the position in the global frame [m].
    pub fn pose_covariance(
        &self,
        map_from_camera: &Transform<Map, Camera>,
        pose_covariance: Option<&Matrix6<f64>>,
    ) -> Matrix6<f64> {
        // S exp(δ) x ≈ S x + s R (ω × x + ν + λ x).
        let linear = self.enu_from_map.linear_matrix();
        let rotation = linear / self.enu_from_map.scale();
        let position = map_from_camera.translation();
        let mut d_pose_d_delta = SMatrix::<f64, 6, 7>::zeros();
        d_pose_d_delta
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&rotation);
        d_pose_d_delta
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(-linear * so3::hat(position)));
        d_pose_d_delta
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&linear);
        d_pose_d_delta
            .fixed_view_mut::<3, 1>(3, 6)
            .copy_from(&(linear * position));
        let mut covariance = d_pose_d_delta * self.covariance * d_pose_d_delta.transpose();
        if let Some(pose_covariance) = pose_covariance {
            let camera_axes = map_from_camera.rotation_matrix();
            let mut d_pose_d_camera = Matrix6::zeros();
            d_pose_d_camera
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&(rotation * camera_axes));
            d_pose_d_camera
                .fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&(linear * camera_axes));
            covariance += d_pose_d_camera * pose_covariance * d_pose_d_camera.transpose();
        }
        let travelled = (position - self.aligned_position_in_map).norm();
        let scale = self.enu_from_map.scale();
        let drift = self.drift_per_length * (scale * travelled).powi(2);
        for axis in 3..6 {
            covariance[(axis, axis)] += drift;
        }
        covariance
    }
}

//! The place of the own map, with an honest covariance.

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::{Matrix3, Matrix6};

use super::track::drift_covariance;
use super::types::{AnchorIdx, Contradiction, DriftRates, Reference};

/// Where the own map stands on the Earth.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub enu_from_map: Similarity<Enu, Map>,
    /// Over `[ω; ν; ln s]`, right perturbation; at the newest keyframe.
    pub covariance: Matrix7,
    /// When the newest accepted keyframe was captured.
    pub captured_at: Timestamp,
    /// How long ago that was; zero for a clock that runs backwards.
    pub age_s: f64,
    /// The newest keyframe's pose: what the covariance refers to.
    pub map_from_keyframe: Transform<Map, Camera>,
    /// Median depth of the scene there, in the map's unit.
    pub depth_in_map: f64,
    /// Keyframes accepted since the map was born.
    pub accepted_count: u64,
    /// The anchors that the estimate rests on.
    pub anchors: Vec<AnchorIdx>,
    /// How those came to their places.
    pub reference: Reference,
    /// The anchors that contradict them and were left out.
    pub left_out: Vec<Contradiction>,
    /// Anchors contradict each other and nothing decides between them.
    pub conflict: bool,
    pub(super) drift: DriftRates,
}

impl Estimate {
    /// The camera's pose in the global frame.
    pub fn enu_from_camera(
        &self,
        map_from_camera: &Transform<Map, Camera>,
    ) -> Transform<Enu, Camera> {
        self.enu_from_map.transform_pose(map_from_camera)
    }

    /// The covariance of a camera's position in the global frame (m²).
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

    /// The covariance of `enu_from_map` where a camera is: over `[ω; ν; ln s]` in its axes and the
    /// map's unit.
    ///
    /// It grows with the distance between the camera and the newest keyframe.
    pub fn covariance_at(&self, map_from_camera: &Transform<Map, Camera>) -> Matrix7 {
        // S exp(δ) B = S B exp(Ad(B⁻¹) δ).
        let camera_from_map = Similarity::from(map_from_camera.inverse()).adjoint();
        let keyframe = self.map_from_keyframe.translation();
        let travelled = (map_from_camera.translation() - keyframe).norm();
        camera_from_map * self.covariance * camera_from_map.transpose()
            + drift_covariance(&self.drift, self.depth_in_map, travelled)
    }

    /// The covariance of a camera's pose in the global frame: `[ω; p]`, the rotation vector
    /// (rad) and the position (m) in the axes of the global frame.
    ///
    /// It grows with the distance between the camera and the newest keyframe.
    pub fn pose_covariance(
        &self,
        map_from_camera: &Transform<Map, Camera>,
        pose_covariance: Option<&Matrix6<f64>>,
    ) -> Matrix6<f64> {
        let in_camera = self.covariance_at(map_from_camera);
        let mut covariance = in_camera.fixed_view::<6, 6>(0, 0).into_owned();
        if let Some(pose_covariance) = pose_covariance {
            covariance += pose_covariance;
        }
        let enu_from_camera = self.enu_from_camera(map_from_camera);
        in_global_axes(&covariance, &enu_from_camera, self.enu_from_map.scale())
    }
}

/// From `[ω; ν]` in a camera's axes and its map's unit to `[ω; p]` in the global axes.
pub(super) fn in_global_axes(
    covariance: &Matrix6<f64>,
    enu_from_camera: &Transform<Enu, Camera>,
    unit_m: f64,
) -> Matrix6<f64> {
    let axes = enu_from_camera.rotation_matrix();
    let mut turn = Matrix6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&axes);
    turn.fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&(axes * unit_m));
    turn * covariance * turn.transpose()
}

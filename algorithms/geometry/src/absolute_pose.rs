//! The pose of one camera from points that it sees: minimal, robust and refined.
//!
//! Observations lie on the ideal plane `(x/z, y/z)`, so that no camera model is needed here.
//! [`ransac_absolute_pose`] finds a pose without a start, [`refine_absolute_pose`] makes one exact.

use nalgebra::{Matrix2, Matrix6, Vector2, Vector3};

use crate::{Camera, Transform};

mod p3p;
mod polynomial;
mod ransac;
mod refine;
#[cfg(test)]
mod tests;

pub use p3p::p3p;
pub use ransac::{RansacSettings, ransac_absolute_pose};
pub use refine::{PositionPrior, RefineSettings, d_position_d_pose, refine_absolute_pose};

/// The 95 % quantile of χ² with two degrees of freedom.
pub const CHI_SQUARED_2_P95: f64 = 5.991;

/// A point of known position, and where the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointObservation {
    /// The point, in the frame in which the camera's pose is wanted.
    pub point_in_world: Vector3<f64>,
    /// Where it is seen, on the ideal plane `(x/z, y/z)`.
    pub position: Vector2<f64>,
    /// Standard deviation of each coordinate of `position`, in the same unit.
    pub sigma: f64,
    /// One standard deviation of the point's own place as the camera would see it, where that is
    /// uncertain along one line, as the range of a point is; zero for a point that is exact.
    pub blur: Vector2<f64>,
}

impl PointObservation {
    /// Makes an error on the plane one of unit covariance: the inverse root of `σ² I + b bᵀ`.
    fn whitener(&self) -> Matrix2<f64> {
        let blur_squared = self.blur.norm_squared();
        if blur_squared == 0.0 {
            return Matrix2::identity() / self.sigma;
        }
        let along = 1.0 / (1.0 + blur_squared / (self.sigma * self.sigma)).sqrt();
        let outer = self.blur * self.blur.transpose() / blur_squared;
        (Matrix2::identity() - outer * (1.0 - along)) / self.sigma
    }
}

/// Why no pose was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseRefusal {
    /// Fewer usable observations than a pose needs.
    TooFewObservations {
        /// How many there were.
        found: usize,
        /// How many are needed.
        required: usize,
    },
    /// No pose explains enough of the observations.
    TooFewInliers {
        /// How many the best pose explains.
        found: usize,
        /// How many are needed.
        required: usize,
    },
    /// The points leave a direction of the pose free: they lie in one spot or on a line.
    Degenerate,
}

/// A pose that explains most observations, not yet the most accurate one.
#[derive(Clone, Debug, PartialEq)]
pub struct AbsolutePose<World> {
    /// Maps points of the world into the camera.
    pub camera_from_world: Transform<Camera, World>,
    /// For each observation, whether the pose explains it.
    pub inliers: Vec<bool>,
    /// How many observations the pose explains.
    pub inlier_count: usize,
    /// How many minimal samples were drawn.
    pub iteration_count: usize,
}

/// The pose that fits its observations best, and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinedPose<World> {
    /// Maps points of the world into the camera.
    pub camera_from_world: Transform<Camera, World>,
    /// Covariance of `[ω; ν]` that perturbs the **inverse** on the right,
    /// `world_from_camera * exp([ω; ν])`: rotation (rad) and translation along the camera's axes,
    /// whatever the distance to the world's origin.
    /// The covariance of the camera's position in the world is `R Σνν Rᵀ`, `R` that of
    /// `world_from_camera`.
    pub world_from_camera_covariance: Matrix6<f64>,
    /// For each observation, whether the pose explains it.
    pub inliers: Vec<bool>,
    /// How many observations the pose explains.
    pub inlier_count: usize,
    /// The variance of the inliers' residuals relative to what their sigmas promise. It is
    /// already in the covariance.
    pub variance_factor: f64,
}

/// The squared, whitened residual, or `None` if the point is not in front of the camera (or any
/// number is not finite).
fn residual_squared<World>(
    camera_from_world: &Transform<Camera, World>,
    observation: &PointObservation,
) -> Option<f64> {
    let point_in_camera = *camera_from_world * observation.point_in_world;
    if point_in_camera.z <= 0.0 {
        return None;
    }
    let predicted = point_in_camera.xy() / point_in_camera.z;
    let whitened = observation.whitener() * (predicted - observation.position);
    Some(whitened.norm_squared()).filter(|squared| squared.is_finite())
}

//! Bundle adjustment: poses and points that fit all observations together.
//!
//! Levenberg–Marquardt on the reduced camera system (Triggs et al. 2000, section 6), robust by
//! Huber's kernel. Poses move by `map_from_camera * exp([ω; ν])`.

use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};

mod linearise;
mod minimise;
mod solve;
mod workspace;

#[cfg(test)]
mod tests;

pub use minimise::adjust;
pub use workspace::Workspace;

/// A camera's pose in the problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BundlePose {
    /// Maps points of the map into the camera.
    pub camera_from_map: Transform<Camera, Map>,
    /// Whether it stays as it is. With one fixed pose the scale is free, and is kept near its
    /// start by the damping alone; with two, everything is determined.
    pub fixed: bool,
}

/// Where a camera sees a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BundleObservation {
    /// Which of [`BundleProblem::poses`].
    pub pose_idx: usize,
    /// Which of [`BundleProblem::points`].
    pub point_idx: usize,
    /// Where the point is seen, on the ideal plane `(x/z, y/z)`.
    pub position: Vector2<f64>,
    /// Standard deviation of each coordinate of `position`, in the same unit.
    pub sigma: f64,
}

impl BundleObservation {
    fn is_usable(&self) -> bool {
        let sigma_valid = self.sigma > 0.0 && self.sigma.is_finite();
        sigma_valid
            && self
                .position
                .iter()
                .all(|coordinate| coordinate.is_finite())
    }
}

/// What is to be fitted; [`adjust`] overwrites the poses and points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BundleProblem {
    /// The cameras, best in the order of time: the solver uses that neighbours see the same.
    pub poses: Vec<BundlePose>,
    /// The points in the map. Those with fewer than two usable observations stay as they are.
    pub points: Vec<Vector3<f64>>,
    /// In any order. What is not finite, or has a sigma that is not positive, is an outlier.
    pub observations: Vec<BundleObservation>,
}

/// How long to optimise, and what to leave out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BundleSettings {
    /// A squared, whitened residual above this has linear cost, and is an outlier in the end.
    pub chi_squared_max: f64,
    /// Steps of the robust fit at most. Without outliers five converge; each outlier share of
    /// 5 % adds about four.
    pub iteration_count_max: usize,
    /// Steps of plain least squares at most that follow without the outliers; zero for none.
    /// Five plus five steps end nearer to the truth than forty robust ones where 5 % or more are
    /// outliers, and slightly farther where none are.
    pub refit_iteration_count_max: usize,
    /// Stop when a step lowers the cost by less than this share of it. Noise makes up most of the
    /// cost: 1e-4 leaves weak directions, scale above all, where they started.
    pub cost_decrease_min: f64,
    /// How much the first step is damped. To go on where another run ended: what that reported.
    pub damping: f64,
    /// Whether [`BundleReport::point_covariances`] is filled.
    pub point_covariances: bool,
    /// Whether [`BundleReport::pose_covariances`] is filled.
    pub pose_covariances: bool,
}

impl BundleSettings {
    pub(crate) const DEFAULT: Self = Self {
        chi_squared_max: 5.991,
        iteration_count_max: 10,
        refit_iteration_count_max: 0,
        cost_decrease_min: 1e-6,
        damping: 1e-4,
        point_covariances: true,
        pose_covariances: false,
    };
}

impl Default for BundleSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What [`adjust`] did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BundleReport {
    /// Robust cost before, of which each good observation adds about two.
    pub cost_before: f64,
    /// The same cost after.
    pub cost_after: f64,
    /// Steps tried, refused ones included.
    pub iteration_count: usize,
    /// Whether the last step gained too little to go on, and not the count that ended it.
    pub converged: bool,
    /// What the next step of the robust fit would have been damped by.
    pub damping: f64,
    /// For each observation, whether the result explains it.
    pub inliers: Vec<bool>,
    /// How many observations the result explains.
    pub inlier_count: usize,
    /// The variance of the inliers' residuals relative to what their sigmas promise; `None`
    /// where there are no more observations than unknowns. Covariances are not scaled by it.
    pub variance_factor: Option<f64>,
    /// For each point, its covariance in the map given the poses, from its inliers; `None`
    /// where these do not determine it. Empty unless asked for.
    pub point_covariances: Vec<Option<Matrix3<f64>>>,
    /// For each pose, the covariance of its `[ω; ν]` with the points free, relative to the fixed
    /// poses; `None` for these, and for all if the problem leaves a direction free. Empty unless
    /// asked for.
    pub pose_covariances: Vec<Option<Matrix6<f64>>>,
}

//! The first two views of a map: relative pose and points, or a reason why not.

use geometry::{Camera, Transform};
use nalgebra::{Vector2, Vector3};

mod essential;
mod five_point;
mod homography;
mod null_space;
mod pair;
mod polynomial;
mod ransac;
mod reconstruct;
mod refine;
mod rotation;

#[cfg(test)]
mod tests;

pub use reconstruct::reconstruct;

/// A point that both views see, on the ideal plane `(x/z, y/z)` of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Where the first camera sees it.
    pub first: Vector2<f64>,
    /// Where the second camera sees it.
    pub second: Vector2<f64>,
}

/// What is known of the measurements, and what a start must offer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoViewSettings {
    /// Standard deviation of each coordinate of a correspondence, on the ideal plane.
    pub sigma: f64,
    /// Stop drawing samples when a better model is less likely than one minus this.
    pub confidence: f64,
    /// Samples drawn at most for each of the two models.
    pub iteration_count_max: usize,
    /// Fewer correspondences are refused unseen.
    pub match_count_min: usize,
    /// Points that must come out in front of both cameras, accurate and with parallax.
    pub point_count_min: usize,
    /// The median angle between the two rays of the points must reach this (rad). Less gives a
    /// map whose depths are guesses, more makes a slow camera wait.
    pub parallax_rad_min: f64,
}

impl Default for TwoViewSettings {
    fn default() -> Self {
        Self {
            sigma: 1.0 / 500.0,
            confidence: 0.999,
            iteration_count_max: 300,
            match_count_min: 50,
            point_count_min: 50,
            parallax_rad_min: 1.0_f64.to_radians(),
        }
    }
}

/// Which model explained the correspondences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TwoViewModel {
    /// A general scene.
    Essential,
    /// A plane, or nearly one.
    Homography,
}

/// Two views and what they see, in units of the distance between them.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoView {
    /// Maps points of the first camera into the second; the translation has length one.
    pub second_from_first: Transform<Camera, Camera>,
    /// For each correspondence its point in the first camera's frame, if it has a good one.
    pub points_in_first: Vec<Option<Vector3<f64>>>,
    /// How many points there are.
    pub point_count: usize,
    /// Which model won.
    pub model: TwoViewModel,
    /// The median angle between the two rays of a point (rad).
    pub parallax_rad_median: f64,
}

/// Why two views are no start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TwoViewRefusal {
    /// Too few correspondences to try.
    TooFewMatches {
        /// How many there were.
        found: usize,
        /// How many are needed.
        required: usize,
    },
    /// No relative pose explains enough of the correspondences.
    TooFewInliers {
        /// How many the best one explains.
        found: usize,
        /// How many are needed.
        required: usize,
    },
    /// A rotation alone explains the correspondences, or so nearly that the translation would be
    /// made of noise.
    PureRotation,
    /// Two relative poses explain the correspondences about equally well.
    Ambiguous {
        /// Points of the best pose.
        best: usize,
        /// Points of the second best.
        second: usize,
    },
    /// The cameras are too close together for the distance of what they see.
    LowParallax {
        /// The median angle between two rays (rad).
        parallax_rad_median: f64,
    },
    /// Too few points in front of both cameras, accurate and with parallax.
    TooFewPoints {
        /// How many there were.
        found: usize,
        /// How many are needed.
        required: usize,
    },
}

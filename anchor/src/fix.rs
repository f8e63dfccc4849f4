//! Position fixes: where somebody else says the antenna is.

use geodesy::Geodetic;
use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};

/// One position of the antenna, as a receiver or a motion-capture system states it.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionFix {
    /// When it was valid, on the clock that also stamps the images.
    pub captured_at: Timestamp,
    pub position: FixPosition,
    /// Covariance (m²) along east, north, up (or the site's axes).
    pub covariance: Matrix3<f64>,
    pub heading: Option<Heading>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixPosition {
    Geodetic(Geodetic),
    /// In the frame of the anchor's datum (m): a site's own axes, or east, north, up.
    Local(Vector3<f64>),
}

/// Where the body's forward axis points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// Counter-clockwise from east (from the site's first axis).
    pub angle_rad: f64,
    pub sigma_rad: f64,
}

/// What became of the fixes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FixCounts {
    /// Tied to a camera pose.
    pub used: u64,
    /// Not finite, or with a covariance that is none.
    pub malformed: u64,
    /// Not newer than the fix before.
    pub out_of_order: u64,
    /// Of a frame that the datum does not relate to.
    pub foreign_datum: u64,
    /// At a time for which no camera pose is known.
    pub without_pose: u64,
}

impl PositionFix {
    /// Whether every number is finite and the variances are positive.
    pub fn is_well_formed(&self) -> bool {
        let local = match &self.position {
            FixPosition::Geodetic(_) => true,
            FixPosition::Local(point) => point.iter().all(|value| value.abs() < 1e9),
        };
        let heading = self.heading.is_none_or(|heading| {
            heading.angle_rad.is_finite() && heading.sigma_rad > 0.0 && heading.sigma_rad < 1e3
        });
        local && heading && self.covariance.cholesky().is_some() && self.sigma_m() < 1e6
    }

    /// The standard deviation of the position (m), the mean over the axes.
    pub fn sigma_m(&self) -> f64 {
        (self.covariance.trace() / 3.0).sqrt()
    }
}

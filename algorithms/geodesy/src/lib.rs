#![doc = include_str!("../README.md")]

mod datum;
mod wgs84;

pub use datum::{Datum, SiteName, SiteSurvey, enu_from_enu};
pub use wgs84::Geodetic;

/// Why a position or a datum is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GeodesyError {
    #[error("{quantity} is {got}, expected a value from {minimum} to {maximum}")]
    OutOfRange {
        quantity: &'static str,
        got: f64,
        minimum: f64,
        maximum: f64,
    },
    #[error("a site's name has 1 to 32 letters, digits, '-', '_' or '.', got {got:?}")]
    SiteName { got: String },
    #[error("no surveyed position of the site {site:?}, needed to relate it to {other}")]
    NotSurveyed { site: String, other: String },
}

#[cfg(test)]
mod tests;

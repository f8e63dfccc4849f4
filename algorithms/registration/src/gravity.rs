//! What is known about the direction of gravity.

use nalgebra::UnitVector3;

/// Up in both clouds: what is left to find is the turn about it, the place and the scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    pub up_in_target: UnitVector3<f64>,
    pub up_in_source: UnitVector3<f64>,
}

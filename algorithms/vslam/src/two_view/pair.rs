//! A correspondence, prepared for many evaluations.

use nalgebra::Vector3;

use super::Correspondence;

/// The two positions as `(x, y, 1)`, divided by nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub first: Vector3<f64>,
    pub second: Vector3<f64>,
}

impl From<&Correspondence> for Pair {
    fn from(correspondence: &Correspondence) -> Self {
        Self {
            first: correspondence.first.push(1.0),
            second: correspondence.second.push(1.0),
        }
    }
}

/// The 95 % quantile of χ² with one degree of freedom: a point and a line.
pub(super) const CHI_SQUARED_1_P95: f64 = 3.841;
/// The 95 % quantile of χ² with two degrees of freedom: a point and a point.
pub(super) const CHI_SQUARED_2_P95: f64 = 5.991;

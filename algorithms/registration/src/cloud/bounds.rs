//! The box around points.

use nalgebra::Vector3;

/// Its corners; inside out without points.
pub(crate) fn bounds(points: impl Iterator<Item = Vector3<f64>>) -> (Vector3<f64>, Vector3<f64>) {
    let nowhere = (
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    );
    points.fold(nowhere, |(lowest, highest), point| {
        (lowest.inf(&point), highest.sup(&point))
    })
}

//! Which points of two clouds may be the same.

use super::consensus::Correspondence;
use super::local_shape;
use super::mutual::mutual;
use crate::cloud::{Descriptors, ShapedCloud};

/// The nearest descriptor must be nearer than this share of the second nearest.
const BINARY_RATIO_MAX: f64 = 0.9;
/// For squared Euclidean distances, 0.85².
const HISTOGRAM_RATIO_MAX: f64 = 0.72;

/// Mutually nearest descriptors where both clouds have them, else mutually nearest local shapes.
pub(crate) fn find(
    source: &ShapedCloud,
    target: &ShapedCloud,
    with_scale: bool,
) -> Vec<Correspondence> {
    let pairs = match (&source.descriptors, &target.descriptors) {
        (Descriptors::Binary(of_source), Descriptors::Binary(of_target)) => {
            mutual(of_source, of_target, BINARY_RATIO_MAX, |a, b| {
                f64::from(a.distance(b))
            })
        }
        (Descriptors::Histogram(of_source), Descriptors::Histogram(of_target)) => mutual(
            of_source,
            of_target,
            HISTOGRAM_RATIO_MAX,
            histogram_distance_squared,
        ),
        _ => return local_shape::correspondences(source, target, with_scale),
    };
    let points = pairs
        .into_iter()
        .map(|(source_idx, target_idx)| Correspondence {
            in_target: target.points[target_idx],
            in_source: source.points[source_idx],
        });
    points.collect()
}

fn histogram_distance_squared(first: &[u8; 128], second: &[u8; 128]) -> f64 {
    let pairs = first.iter().zip(second);
    let squares = pairs.map(|(a, b)| {
        let difference = i32::from(*a) - i32::from(*b);
        difference * difference
    });
    f64::from(squares.sum::<i32>())
}

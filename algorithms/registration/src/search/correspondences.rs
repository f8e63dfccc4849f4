//! Which points of two clouds may be the same.

use super::consensus::Correspondence;
use super::local_shape;
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

/// Pairs that are each other's nearest, and clearly nearer than the second from both sides.
pub(crate) fn mutual<D>(
    source: &[D],
    target: &[D],
    ratio_max: f64,
    distance: impl Fn(&D, &D) -> f64,
) -> Vec<(usize, usize)> {
    let mut of_source = vec![Ranking::default(); source.len()];
    let mut of_target = vec![Ranking::default(); target.len()];
    for (source_idx, in_source) in source.iter().enumerate() {
        for (target_idx, in_target) in target.iter().enumerate() {
            let distance = distance(in_source, in_target);
            of_source[source_idx].offer(target_idx, distance);
            of_target[target_idx].offer(source_idx, distance);
        }
    }
    let clear = |ranking: &Ranking| ranking.best_distance <= ratio_max * ranking.second_distance;
    let candidates = of_source.iter().enumerate();
    candidates
        .filter(|(_, ranking)| clear(ranking) && ranking.best_idx < target.len())
        .map(|(source_idx, ranking)| (source_idx, ranking.best_idx))
        .filter(|(source_idx, target_idx)| {
            let back = &of_target[*target_idx];
            back.best_idx == *source_idx && clear(back)
        })
        .collect()
}

#[derive(Clone, Copy)]
struct Ranking {
    best_idx: usize,
    best_distance: f64,
    second_distance: f64,
}

impl Default for Ranking {
    fn default() -> Self {
        Self {
            best_idx: usize::MAX,
            best_distance: f64::INFINITY,
            second_distance: f64::INFINITY,
        }
    }
}

impl Ranking {
    fn offer(&mut self, idx: usize, distance: f64) {
        if distance < self.best_distance {
            self.second_distance = self.best_distance;
            (self.best_idx, self.best_distance) = (idx, distance);
        } else {
            self.second_distance = self.second_distance.min(distance);
        }
    }
}

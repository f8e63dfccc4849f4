//! Correspondences that an alignment brings together, and what they say of other alignments.

use geometry::{Matrix7, Similarity, so3};
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};

use super::Correspondence;
use crate::alignment::{Source, Target};

/// The 99.9 % bound of χ² with seven degrees of freedom.
const TORN_CHI_SQUARED: f64 = 24.3;
/// Each source point is compared with the target points of so many other correspondences.
const SHUFFLE_COUNT: usize = 8;

/// Correspondences in agreement, and their noise.
#[derive(Clone, Debug)]
pub(crate) struct Agreement {
    pairs: Vec<Correspondence>,
    /// Of one coordinate.
    variance: f64,
}

impl Agreement {
    pub fn new(
        pairs: &[Correspondence],
        alignment: &Similarity<Target, Source>,
        inlier_distance: f64,
    ) -> Self {
        let is_inlier = |pair: &&Correspondence| {
            distance_squared(pair, alignment) <= inlier_distance * inlier_distance
        };
        let pairs: Vec<_> = pairs.iter().filter(is_inlier).copied().collect();
        let freedom = (3.0 * pairs.len() as f64 - 7.0).max(1.0);
        let cost = pairs.iter().map(|pair| distance_squared(pair, alignment));
        Self {
            variance: cost.sum::<f64>() / freedom,
            pairs,
        }
    }

    /// Root mean square distance of the source points from their mean.
    pub fn spread(&self) -> f64 {
        let count = self.pairs.len().max(1) as f64;
        let mean = self
            .pairs
            .iter()
            .map(|pair| pair.in_source)
            .sum::<Vector3<f64>>()
            / count;
        let squares = self
            .pairs
            .iter()
            .map(|pair| (pair.in_source - mean).norm_squared());
        (squares.sum::<f64>() / count).sqrt()
    }

    /// Whether `other` fits worse than the noise lets it: by an error of the seven unknowns that
    /// has a chance of one in a thousand.
    pub fn is_torn(
        &self,
        own: &Similarity<Target, Source>,
        other: &Similarity<Target, Source>,
    ) -> bool {
        let cost = |alignment| {
            let squares = self
                .pairs
                .iter()
                .map(|pair| distance_squared(pair, alignment));
            squares.sum::<f64>()
        };
        cost(other) - cost(own) > TORN_CHI_SQUARED * self.variance
    }

    /// Over `[ω; ν; ln s]`, right perturbation; zero in the scale where that is fixed.
    pub fn covariance(
        &self,
        alignment: &Similarity<Target, Source>,
        with_scale: bool,
    ) -> Option<Matrix7> {
        let mut information = Matrix7::zeros();
        for pair in &self.pairs {
            let mut lever = SMatrix::<f64, 3, 7>::zeros();
            lever
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&-so3::hat(&pair.in_source));
            lever
                .fixed_view_mut::<3, 3>(0, 3)
                .copy_from(&Matrix3::identity());
            lever
                .fixed_view_mut::<3, 1>(0, 6)
                .copy_from(&pair.in_source);
            information += lever.transpose() * lever * alignment.scale().powi(2);
        }
        if with_scale {
            return Some(information.cholesky()?.inverse() * self.variance);
        }
        let rigid: Matrix6<f64> = information.fixed_view::<6, 6>(0, 0).into_owned();
        let mut covariance = Matrix7::zeros();
        let inverse = rigid.cholesky()?.inverse() * self.variance;
        covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&inverse);
        Some(covariance)
    }
}

fn distance_squared(pair: &Correspondence, alignment: &Similarity<Target, Source>) -> f64 {
    (pair.in_target - *alignment * pair.in_source).norm_squared()
}

/// The probability that a wrong correspondence agrees: the share that does when they are shuffled.
pub(crate) fn chance(
    pairs: &[Correspondence],
    alignment: &Similarity<Target, Source>,
    inlier_distance: f64,
) -> f64 {
    let mut agreeing = 0;
    for (idx, pair) in pairs.iter().enumerate() {
        let moved = *alignment * pair.in_source;
        for turn in 1..=SHUFFLE_COUNT {
            // Steps of different lengths, so that neighbours in the list do not decide, and none
            // that comes back to where it began.
            let step = (turn * turn * 7 % pairs.len()).max(1);
            let other = &pairs[(idx + step) % pairs.len()];
            agreeing += usize::from((other.in_target - moved).norm() <= inlier_distance);
        }
    }
    let tried = (pairs.len() * SHUFFLE_COUNT).max(1);
    (agreeing.max(1) as f64 / tried as f64).min(0.99)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: correspondences are not compared with themselves. Method: points far apart, in numbers
    /// that share factors with the steps; none agrees with another's partner, and the least that
    /// can be told is one of all that were tried.
    #[test]
    fn what_agrees_with_itself_is_no_chance() {
        for count in [7, 14, 28, 112] {
            let pair = |idx: usize| {
                let place = Vector3::new(idx as f64, 0.0, 0.0);
                Correspondence {
                    in_target: place,
                    in_source: place,
                }
            };
            let pairs: Vec<Correspondence> = (0..count).map(pair).collect();
            let found = chance(&pairs, &Similarity::identity(), 0.1);
            let least = 1.0 / (count * SHUFFLE_COUNT) as f64;
            assert!((found - least).abs() < 1e-12, "{count}: {found}");
        }
    }
}

//! Which correspondences agree with an alignment, and the alignment that they then give.

use geometry::Similarity;
use nalgebra::{Matrix3, Vector3};

use super::fit::Fit;
use super::{Correspondence, Hypothesis};
use crate::alignment::{Source, Target};
use crate::median::median;

/// From the rough pose of a sample to that of its inliers, in inlier distances.
const WIDTHS: [f64; 3] = [2.0, 1.4, 1.0];
/// Rounds in which the fit follows the noise that is there.
const ROUND_COUNT_MAX: usize = 10;
/// Of a normal error in three dimensions the median is 1.54 σ, and 99 % are below 3.4 σ.
const WIDTH_MEDIANS: f64 = 2.2;
/// With this share of the inliers wanted the noise is looked at too, which may bring the rest.
const PROMISING_SHARE: f64 = 0.8;
/// Where there is no noise: of the inlier distance.
const WIDTH_MIN: f64 = 1e-9;

/// The correspondences that count.
pub(super) struct Support {
    pairs: Vec<Correspondence>,
    inlier_distance: f64,
    distances: Vec<f64>,
}

impl Support {
    pub fn new(pairs: &[Correspondence], inlier_distance: f64) -> Self {
        Self {
            pairs: pairs.to_vec(),
            inlier_distance,
            distances: Vec::with_capacity(pairs.len()),
        }
    }

    pub fn pair_count(&self) -> usize {
        self.pairs.len()
    }

    pub fn count_within(&self, pose: &Similarity<Target, Source>, distance: f64) -> usize {
        self.within(pose, distance).count()
    }

    pub fn drop_within(&mut self, pose: &Similarity<Target, Source>, distance: f64) {
        let placed = Placed::new(pose);
        self.pairs.retain(|pair| placed.distance(pair) > distance);
    }

    /// Fits the inliers until they hold, first to within the inlier distance, then to within what
    /// their own noise explains. `None` if they are fewer than `count_min` or do not fix a pose.
    pub fn narrowed(
        &mut self,
        start: &Similarity<Target, Source>,
        fit: &Fit,
        count_min: usize,
    ) -> Option<Hypothesis> {
        let mut pose = *start;
        for width in WIDTHS {
            pose = fit.of(self.within(&pose, width * self.inlier_distance))?;
        }
        let count = self.count_within(&pose, self.inlier_distance);
        if (count as f64) < PROMISING_SHARE * count_min as f64 {
            return None;
        }
        for _ in 0..ROUND_COUNT_MAX {
            let width = self.noise_width(&pose);
            let Some(fitted) = fit.of(self.within(&pose, width)) else {
                break;
            };
            let moved = pose.inverse() * fitted;
            pose = fitted;
            if moved.log().norm() < 1e-9 {
                break;
            }
        }
        let inlier_count = self.count_within(&pose, self.inlier_distance);
        let is_fixed = fit.is_fixed_by(self.within(&pose, self.inlier_distance));
        (inlier_count >= count_min && is_fixed).then_some(Hypothesis {
            target_from_source: pose,
            inlier_count,
        })
    }

    /// How far inliers lie off by the noise that those within the inlier distance have.
    fn noise_width(&mut self, pose: &Similarity<Target, Source>) -> f64 {
        let mut distances = std::mem::take(&mut self.distances);
        distances.clear();
        let placed = Placed::new(pose);
        let all = self.pairs.iter().map(|pair| placed.distance(pair));
        distances.extend(all.filter(|distance| *distance <= self.inlier_distance));
        let median = median(&mut distances, f64::total_cmp).unwrap_or(self.inlier_distance);
        self.distances = distances;
        (WIDTH_MEDIANS * median).clamp(WIDTH_MIN * self.inlier_distance, self.inlier_distance)
    }

    fn within(
        &self,
        pose: &Similarity<Target, Source>,
        distance: f64,
    ) -> impl Iterator<Item = &Correspondence> + Clone {
        let placed = Placed::new(pose);
        self.pairs
            .iter()
            .filter(move |pair| placed.distance(pair) <= distance)
    }
}

/// An alignment as a matrix, which places many points faster.
#[derive(Clone, Copy)]
pub(super) struct Placed {
    linear: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Placed {
    pub fn new(pose: &Similarity<Target, Source>) -> Self {
        Self {
            linear: pose.linear_matrix(),
            translation: *pose.translation(),
        }
    }

    /// Between the two points of a correspondence.
    #[inline]
    pub fn distance(&self, pair: &Correspondence) -> f64 {
        (pair.in_target - self.linear * pair.in_source - self.translation).norm()
    }
}

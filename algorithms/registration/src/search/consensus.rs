//! The similarities that many correspondences agree on.

use geometry::{Similarity, umeyama};
use nalgebra::Vector3;
use rand::Rng;
use rand::seq::index::sample_array;

use crate::alignment::{Source, Target};

/// A point of each cloud that may be the same.
#[derive(Clone, Copy, Debug)]
pub struct Correspondence {
    pub in_target: Vector3<f64>,
    pub in_source: Vector3<f64>,
}

#[derive(Clone, Debug)]
pub struct ConsensusSettings {
    /// Whether the scale is estimated; otherwise it is one.
    pub with_scale: bool,
    /// Correspondences that an alignment brings within this distance agree with it.
    pub inlier_distance: f64,
    /// Samples at most. 20,000 find an alignment among 95 % outliers.
    pub sample_count_max: usize,
    pub inlier_count_min: usize,
    /// Scales beyond this factor are not believed.
    pub scale_factor_max: f64,
    /// How many different alignments are wanted.
    pub hypothesis_count: usize,
}

impl Default for ConsensusSettings {
    fn default() -> Self {
        Self {
            with_scale: true,
            inlier_distance: 0.05,
            sample_count_max: 60_000,
            inlier_count_min: 6,
            scale_factor_max: 10.0,
            hypothesis_count: 2,
        }
    }
}

/// An alignment and how many correspondences agree with it.
#[derive(Clone, Copy, Debug)]
pub struct Hypothesis {
    pub target_from_source: Similarity<Target, Source>,
    pub inlier_count: usize,
}

/// The alignments with most support, best first, each with inliers of its own.
///
/// Samples of three, refused before the fit unless the sides have one ratio (one, where the scale
/// is fixed); the fit of the inliers is repeated until it holds. Deterministic for a given `rng`.
pub fn find_consensus(
    pairs: &[Correspondence],
    settings: &ConsensusSettings,
    rng: &mut impl Rng,
) -> Vec<Hypothesis> {
    let mut rest: Vec<Correspondence> = pairs.to_vec();
    let mut hypotheses = Vec::new();
    while hypotheses.len() < settings.hypothesis_count {
        let Some(best) = best_of(&rest, settings, rng) else {
            break;
        };
        rest.retain(|pair| !agrees(pair, &best.target_from_source, settings));
        hypotheses.push(best);
    }
    hypotheses
}

fn best_of(
    pairs: &[Correspondence],
    settings: &ConsensusSettings,
    rng: &mut impl Rng,
) -> Option<Hypothesis> {
    let mut best: Option<Hypothesis> = None;
    if pairs.len() < settings.inlier_count_min.max(3) {
        return None;
    }
    let mut sample_count = 0;
    let mut sample_count_needed = settings.sample_count_max;
    while sample_count < sample_count_needed {
        sample_count += 1;
        let sample: [usize; 3] = sample_array(rng, pairs.len())?;
        let sample = sample.map(|idx| pairs[idx]);
        if !sides_agree(&sample, settings) {
            continue;
        }
        let Some(fit) = fit(sample.iter(), settings) else {
            continue;
        };
        let inlier_count = pairs
            .iter()
            .filter(|pair| agrees(pair, &fit, settings))
            .count();
        let floor = best.map_or(settings.inlier_count_min - 1, |best| best.inlier_count);
        if inlier_count <= floor {
            continue;
        }
        let improved = improve(fit, inlier_count, pairs, settings);
        let share = improved.inlier_count as f64 / pairs.len() as f64;
        let needed = (0.001_f64.ln() / (1.0 - share.powi(3)).ln())
            .ceil()
            .max(1.0);
        sample_count_needed = settings.sample_count_max.min(needed as usize);
        best = Some(improved);
    }
    best
}

/// Fits the inliers again until their number no longer grows.
fn improve(
    start: Similarity<Target, Source>,
    inlier_count: usize,
    pairs: &[Correspondence],
    settings: &ConsensusSettings,
) -> Hypothesis {
    let mut best = Hypothesis {
        target_from_source: start,
        inlier_count,
    };
    for _ in 0..10 {
        let before = best.target_from_source;
        let inliers = pairs.iter().filter(|pair| agrees(pair, &before, settings));
        let Some(fitted) = fit(inliers, settings) else {
            break;
        };
        let inlier_count = pairs
            .iter()
            .filter(|pair| agrees(pair, &fitted, settings))
            .count();
        if inlier_count < best.inlier_count {
            break;
        }
        let grows = inlier_count > best.inlier_count;
        best = Hypothesis {
            target_from_source: fitted,
            inlier_count,
        };
        if !grows {
            break;
        }
    }
    best
}

fn fit<'a>(
    pairs: impl Iterator<Item = &'a Correspondence> + Clone,
    settings: &ConsensusSettings,
) -> Option<Similarity<Target, Source>> {
    let weighted = pairs.map(|pair| (pair.in_target, pair.in_source, 1.0));
    let fit = umeyama(weighted, settings.with_scale).ok()?;
    let factor = fit.scale().max(1.0 / fit.scale());
    (factor <= settings.scale_factor_max).then_some(fit)
}

fn agrees(
    pair: &Correspondence,
    target_from_source: &Similarity<Target, Source>,
    settings: &ConsensusSettings,
) -> bool {
    let apart = pair.in_target - *target_from_source * pair.in_source;
    apart.norm_squared() < settings.inlier_distance * settings.inlier_distance
}

/// Whether the two triangles have one shape, and enough extent to say anything.
fn sides_agree(sample: &[Correspondence; 3], settings: &ConsensusSettings) -> bool {
    let mut lowest = f64::INFINITY;
    let mut highest: f64 = 0.0;
    for (first, second) in [(0, 1), (1, 2), (2, 0)] {
        let in_target = (sample[first].in_target - sample[second].in_target).norm();
        let in_source = (sample[first].in_source - sample[second].in_source).norm();
        if in_target < 2.0 * settings.inlier_distance || in_source <= 0.0 {
            return false;
        }
        // Both ends may be off by the inlier distance.
        let slack = 2.0 * settings.inlier_distance / in_target;
        let ratio = in_target / in_source;
        if !settings.with_scale && (ratio - 1.0).abs() > slack {
            return false;
        }
        lowest = lowest.min(ratio * (1.0 + slack));
        highest = highest.max(ratio * (1.0 - slack));
    }
    highest <= lowest
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Goal: 1,000 correspondences, noise of 1 % of the extent and up to 95 % outliers end within
    /// 1° and 1 % of scale.
    #[test]
    fn finds_a_similarity_among_outliers() {
        for (seed, outlier_share) in [(1, 0.5), (2, 0.8), (3, 0.95), (4, 0.95)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut point = || Vector3::from_fn(|_, _| rng.random::<f64>() - 0.5);
            let truth: Similarity<Target, Source> = Similarity::new(
                2.3,
                UnitQuaternion::from_scaled_axis(point() * 6.0),
                point(),
            );
            let pairs: Vec<Correspondence> = (0..1000)
                .map(|idx| {
                    let in_source = point();
                    let outlier = (idx as f64) < 1000.0 * outlier_share;
                    // Uniform noise: ±1.7 % has a standard deviation of 1 %.
                    let noise = point() * 2.0 * 0.017 * 2.3;
                    let in_target = if outlier {
                        truth * point() * 1.0
                    } else {
                        truth * in_source + noise
                    };
                    Correspondence {
                        in_target,
                        in_source,
                    }
                })
                .collect();
            let settings = ConsensusSettings {
                inlier_distance: 0.08,
                ..ConsensusSettings::default()
            };
            let found = find_consensus(&pairs, &settings, &mut rng);
            let error = truth.inverse() * found[0].target_from_source;
            assert!(
                error.rotation().angle() < 1.0_f64.to_radians(),
                "{outlier_share}"
            );
            assert!(error.scale().ln().abs() < 0.01, "{outlier_share}");
        }
    }

    #[test]
    fn finds_nothing_in_too_few_or_equal_points() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let same = Correspondence {
            in_target: Vector3::zeros(),
            in_source: Vector3::zeros(),
        };
        let settings = ConsensusSettings {
            sample_count_max: 100,
            ..ConsensusSettings::default()
        };
        assert!(find_consensus(&[], &settings, &mut rng).is_empty());
        assert!(find_consensus(&[same; 50], &settings, &mut rng).is_empty());
    }
}

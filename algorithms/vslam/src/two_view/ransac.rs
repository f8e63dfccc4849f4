//! Robust fit of a two-view model, the same for every model.

use rand::{Rng, RngExt};

use super::TwoViewSettings;
use super::pair::Pair;

/// What relates two views.
pub(super) trait Model: Copy {
    /// Pairs in a minimal sample.
    const SAMPLE_SIZE: usize;
    /// A squared residual in sigmas above this is an outlier's.
    const CHI_SQUARED_MAX: f64;
    /// Dimension of the set of pairs that fit, out of the four of all pairs.
    const DIMENSION: f64;
    /// Free parameters.
    const PARAMETER_COUNT: f64;

    /// Appends the models that fit a minimal sample.
    fn fit(pairs: &[Pair], sample: &[usize], models: &mut Vec<Self>);

    /// Squared distance of a pair, in four dimensions, to the nearest one that fits.
    fn residual_squared(&self, pair: &Pair) -> f64;

    fn explains(&self, pair: &Pair, sigma: f64) -> bool {
        self.residual_squared(pair) <= Self::CHI_SQUARED_MAX * sigma * sigma
    }

    /// A better fit to the pairs that this one explains.
    fn improve(&self, pairs: &[Pair], sigma: f64) -> Option<Self>;
}

/// A model and how well it explains all pairs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit<M> {
    pub model: M,
    /// Sum of squared residuals in sigmas, each truncated at [`Model::CHI_SQUARED_MAX`].
    pub cost: f64,
    pub inlier_count: usize,
}

impl<M: Model> Fit<M> {
    /// `None` as soon as the cost reaches the limit.
    pub(super) fn score(model: M, pairs: &[Pair], sigma: f64, cost_limit: f64) -> Option<Self> {
        let inverse_variance = 1.0 / (sigma * sigma);
        let mut cost = 0.0;
        let mut inlier_count = 0;
        for pair in pairs {
            let squared = model.residual_squared(pair) * inverse_variance;
            if squared <= M::CHI_SQUARED_MAX {
                cost += squared;
                inlier_count += 1;
            } else {
                // Also where it is not a number.
                cost += M::CHI_SQUARED_MAX;
            }
            if cost >= cost_limit {
                return None;
            }
        }
        Some(Self {
            model,
            cost,
            inlier_count,
        })
    }
}

/// The geometric robust information criterion (Torr 1998): what the residuals, the positions of
/// the pairs on the model, and the model itself take to be written down. The least wins.
pub(super) fn information_criterion<M: Model>(model: &M, pairs: &[Pair], sigma: f64) -> f64 {
    const DATA_DIMENSION: f64 = 4.0;
    let inverse_variance = 1.0 / (sigma * sigma);
    let residual_max = 2.0 * (DATA_DIMENSION - M::DIMENSION);
    let residuals: f64 = pairs
        .iter()
        .map(|pair| (model.residual_squared(pair) * inverse_variance).min(residual_max))
        .sum();
    let pair_count = pairs.len() as f64;
    residuals
        + DATA_DIMENSION.ln() * M::DIMENSION * pair_count
        + (DATA_DIMENSION * pair_count).ln() * M::PARAMETER_COUNT
}

/// Draws minimal samples until a better model is unlikely, and improves each new best on the
/// pairs that it explains (Chum et al. 2003).
pub(super) fn ransac<M: Model>(
    pairs: &[Pair],
    settings: &TwoViewSettings,
    rng: &mut impl Rng,
) -> Option<Fit<M>> {
    if pairs.len() < M::SAMPLE_SIZE {
        return None;
    }
    let mut best: Option<Fit<M>> = None;
    let mut models = Vec::new();
    let mut sample_memory = [0; SAMPLE_SIZE_MAX];
    let mut needed = settings.iteration_count_max;
    let mut iteration_count = 0;
    while iteration_count < needed {
        iteration_count += 1;
        let sample = &mut sample_memory[..M::SAMPLE_SIZE];
        draw_distinct(sample, pairs.len(), rng);
        models.clear();
        M::fit(pairs, sample, &mut models);
        for model in &models {
            let limit = best.as_ref().map_or(f64::INFINITY, |best| best.cost);
            let Some(fit) = Fit::score(*model, pairs, settings.sigma, limit) else {
                continue;
            };
            let improved = fit
                .model
                .improve(pairs, settings.sigma)
                .and_then(|model| Fit::score(model, pairs, settings.sigma, fit.cost));
            let fit = improved.unwrap_or(fit);
            let share = fit.inlier_count as f64 / pairs.len() as f64;
            needed = samples_needed(share, M::SAMPLE_SIZE, settings);
            best = Some(fit);
        }
    }
    best
}

/// How many samples make one without outliers likely enough.
fn samples_needed(inlier_share: f64, sample_size: usize, settings: &TwoViewSettings) -> usize {
    let all_inliers = inlier_share.powi(sample_size as i32);
    if all_inliers <= 0.0 {
        return settings.iteration_count_max;
    }
    let needed = (1.0 - settings.confidence).ln() / (-all_inliers).ln_1p();
    // NaN and infinity saturate to zero and to the largest number.
    settings
        .iteration_count_max
        .min(needed.ceil().max(1.0) as usize)
}

const SAMPLE_SIZE_MAX: usize = 5;

/// Fills a sample with distinct indices below `count`, which must be at least its length.
fn draw_distinct(sample: &mut [usize], count: usize, rng: &mut impl Rng) {
    let mut drawn_count = 0;
    while drawn_count < sample.len() {
        let drawn = rng.random_range(0..count);
        if !sample[..drawn_count].contains(&drawn) {
            sample[drawn_count] = drawn;
            drawn_count += 1;
        }
    }
}

//! The search for clouds that only have their shape in common.

use geometry::Similarity;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{
    Agreement, ConsensusSettings, Correspondence, Found, Hypothesis, find_consensus, local_shape,
    significance_of,
};
use crate::alignment::{Refusal, RegisterSettings, Source, Target};
use crate::cloud::ShapedCloud;
use crate::evidence::{Clue, Evidence};

/// Shapes recur, and so do wrong alignments: that many are compared.
const HYPOTHESIS_COUNT: usize = 6;
/// With a free scale the neighbourhoods first follow the radii of the clouds. Where one shows
/// only a part of the other, the radius says another scale; these cover factors from 0.5 to 2.
const SCALE_RATIOS: [f64; 5] = [1.0, 0.8, 1.25, 0.63, 1.6];
/// A neighbourhood whose size is wrong by more than this looks different.
const SCALE_FACTOR_MAX: f64 = 1.5;
/// So many powers of ten below chance no other scale is tried.
const SIGNIFICANCE_SURE: f64 = -20.0;
/// A rival with this share of the best one's significance makes the search ambiguous.
const RIVAL_SHARE_MAX: f64 = 0.5;

/// An alignment that shapes agree on, and its significance as a power of ten.
#[derive(Clone, Copy)]
struct Ranked {
    target_from_source: Similarity<Target, Source>,
    /// The correspondences that it was sought among.
    offered_count: usize,
    inlier_count: usize,
    false_alarms_log10: f64,
    /// Of the source points that agree.
    spread: f64,
}

/// The alignment that points of alike surroundings agree on, unless chance or another place would
/// do as well.
pub(super) fn find_by_shape(
    source: &ShapedCloud,
    target: &ShapedCloud,
    settings: &RegisterSettings,
) -> Result<Found, Refusal> {
    let inlier_distance = (0.02 * target.radius).max(3.0 * target.spacing);
    let ratios = if settings.with_scale {
        &SCALE_RATIOS[..]
    } else {
        &SCALE_RATIOS[..1]
    };
    let mut ranked: Vec<Ranked> = Vec::new();
    for ratio in ratios {
        let scale = if settings.with_scale {
            ratio * target.radius / source.radius
        } else {
            1.0
        };
        if !scale.is_finite() || scale <= 0.0 {
            break;
        }
        ranked.extend(at_scale(source, target, scale, inlier_distance, settings));
        ranked.sort_by(|a, b| a.false_alarms_log10.total_cmp(&b.false_alarms_log10));
        let best = ranked.first().map(|best| best.false_alarms_log10);
        if best.is_some_and(|best| best < SIGNIFICANCE_SURE) {
            break;
        }
    }
    let best = *ranked.first().ok_or(Refusal::SearchFoundNothing)?;
    let start = best.target_from_source;
    let rival = ranked[1..]
        .iter()
        .find(|rival| !is_near(&start, &rival.target_from_source, source.radius));
    let evidence = Evidence {
        clue: Clue::Shape,
        offered_count: best.offered_count,
        consistent_count: best.inlier_count,
        runner_up_count: rival.map_or(0, |rival| rival.inlier_count),
        false_alarms_log10: best.false_alarms_log10,
        spread: best.spread / source.radius,
    };
    if evidence.may_be_chance() || evidence.is_narrow() {
        return Err(Refusal::SearchFoundNothing);
    }
    let rival_limit = RIVAL_SHARE_MAX * best.false_alarms_log10;
    let is_rivalled = rival.is_some_and(|rival| rival.false_alarms_log10 < rival_limit);
    if is_rivalled || evidence.is_ambiguous() {
        return Err(evidence.ambiguous());
    }
    Ok(Found {
        start,
        evidence,
        agreement: None,
    })
}

/// Alignments near this scale.
fn at_scale(
    source: &ShapedCloud,
    target: &ShapedCloud,
    scale: f64,
    inlier_distance: f64,
    settings: &RegisterSettings,
) -> Vec<Ranked> {
    let mut pairs =
        local_shape::correspondences(source, target, target.radius / scale, target.radius);
    for Correspondence { in_source, .. } in &mut pairs {
        *in_source *= scale;
    }
    let consensus_settings = ConsensusSettings {
        with_scale: settings.with_scale,
        gravity: settings.gravity,
        inlier_distance,
        scale_factor_max: SCALE_FACTOR_MAX,
        hypothesis_count: HYPOTHESIS_COUNT,
        ..ConsensusSettings::default()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let hypotheses = find_consensus(&pairs, &consensus_settings, &mut rng);
    let ranked = hypotheses.iter().map(|hypothesis: &Hypothesis| {
        let scaled = &hypothesis.target_from_source;
        Ranked {
            target_from_source: Similarity::new(
                scaled.scale() * scale,
                *scaled.rotation(),
                *scaled.translation(),
            ),
            offered_count: pairs.len(),
            inlier_count: hypothesis.inlier_count,
            false_alarms_log10: significance_of(&pairs, hypothesis, inlier_distance),
            spread: Agreement::new(&pairs, scaled, inlier_distance).spread() / scale,
        }
    });
    ranked.collect()
}

/// Whether two alignments move no point of the cloud far apart.
fn is_near(
    first: &Similarity<Target, Source>,
    second: &Similarity<Target, Source>,
    radius: f64,
) -> bool {
    let between = first.inverse() * *second;
    between.rotation().angle() < 0.2
        && between.translation().norm() < 0.2 * radius
        && between.scale().ln().abs() < 0.2
}

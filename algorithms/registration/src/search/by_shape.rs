//! The search for clouds that only have their shape in common.

use geometry::Similarity;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{ConsensusSettings, Found, Hypothesis, find_consensus, local_shape, significance_of};
use crate::acceptance::partner_distance;
use crate::alignment::{Refusal, RegisterSettings, Source, Target};
use crate::cloud::ShapedCloud;
use crate::evidence::{Clue, Evidence};
use crate::icp::overlaps;

/// Hypotheses that are compared by their overlap.
const HYPOTHESIS_COUNT: usize = 6;
/// A second alignment with this share of the best one's overlap makes the search ambiguous.
const RIVAL_SHARE_MAX: f64 = 0.95;

/// The alignment that points of alike surroundings agree on and under which the clouds overlap,
/// unless chance or another place would do as well.
pub(super) fn find_by_shape(
    source: &ShapedCloud,
    target: &ShapedCloud,
    settings: &RegisterSettings,
) -> Result<Found, Refusal> {
    let pairs = local_shape::correspondences(source, target, settings.with_scale);
    let inlier_distance = (0.02 * target.radius).max(3.0 * target.spacing);
    let consensus_settings = ConsensusSettings {
        with_scale: settings.with_scale,
        gravity: settings.gravity,
        inlier_distance,
        hypothesis_count: HYPOTHESIS_COUNT,
        ..ConsensusSettings::default()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let hypotheses = find_consensus(&pairs, &consensus_settings, &mut rng);
    let mut ranked: Vec<(f64, Hypothesis)> = hypotheses
        .iter()
        .map(|hypothesis| {
            let start = hypothesis.target_from_source;
            // Before the refinement partners are farther apart.
            let distance = 2.0 * partner_distance(source, target, start.scale());
            let (of_source, of_target) = overlaps(source, target, &start, distance);
            let rank = of_source * of_target * hypothesis.inlier_count as f64;
            (rank, *hypothesis)
        })
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (best_rank, best) = *ranked.first().ok_or(Refusal::SearchFoundNothing)?;
    let start = best.target_from_source;
    let rivals = ranked[1..]
        .iter()
        .filter(|(_, rival)| !is_near(&start, &rival.target_from_source, source.radius));
    let evidence = Evidence {
        clue: Clue::Shape,
        offered_count: pairs.len(),
        consistent_count: best.inlier_count,
        runner_up_count: rivals
            .clone()
            .map(|(_, rival)| rival.inlier_count)
            .max()
            .unwrap_or(0),
        false_alarms_log10: significance_of(&pairs, &best, inlier_distance),
    };
    if evidence.may_be_chance() {
        return Err(Refusal::SearchFoundNothing);
    }
    let is_rivalled = rivals
        .clone()
        .any(|(rank, _)| *rank > RIVAL_SHARE_MAX * best_rank);
    if is_rivalled || evidence.is_ambiguous() {
        return Err(evidence.ambiguous());
    }
    Ok(Found {
        start,
        evidence,
        agreement: None,
    })
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

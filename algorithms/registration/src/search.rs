//! A start where none is known: correspondences by appearance or by local shape, then consensus.

mod consensus;
mod correspondences;
mod local_shape;
mod mutual;

use geometry::Similarity;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::acceptance::partner_distance;
use crate::alignment::{Refusal, RegisterSettings, Source, Target};
use crate::cloud::ShapedCloud;
use crate::icp::overlaps;

pub use consensus::{ConsensusSettings, Correspondence, Hypothesis, find_consensus};

/// Hypotheses that are compared by their overlap.
const HYPOTHESIS_COUNT: usize = 6;
/// A second alignment with this share of the best one's overlap makes the search ambiguous.
const RIVAL_SHARE_MAX: f64 = 0.95;

/// An alignment of the centred clouds, near enough for the iteration.
pub(crate) fn find(
    source: &ShapedCloud,
    target: &ShapedCloud,
    settings: &RegisterSettings,
) -> Result<Similarity<Target, Source>, Refusal> {
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let pairs = correspondences::find(source, target, settings.with_scale);
    let consensus_settings = ConsensusSettings {
        with_scale: settings.with_scale,
        inlier_distance: (0.02 * target.radius).max(3.0 * target.spacing),
        hypothesis_count: HYPOTHESIS_COUNT,
        ..ConsensusSettings::default()
    };
    let hypotheses = find_consensus(&pairs, &consensus_settings, &mut rng);
    let mut ranked: Vec<(f64, Similarity<Target, Source>)> = hypotheses
        .iter()
        .map(|hypothesis| {
            let start = hypothesis.target_from_source;
            // Before the refinement partners are farther apart.
            let distance = 2.0 * partner_distance(source, target, start.scale());
            let (of_source, of_target) = overlaps(source, target, &start, distance);
            (
                of_source * of_target * hypothesis.inlier_count as f64,
                start,
            )
        })
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (best_rank, best) = *ranked.first().ok_or(Refusal::SearchFoundNothing)?;
    let ambiguous = ranked[1..].iter().any(|(rank, start)| {
        *rank > RIVAL_SHARE_MAX * best_rank && !is_near(&best, start, source.radius)
    });
    if ambiguous {
        return Err(Refusal::Ambiguous);
    }
    Ok(best)
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

//! A start where none is known: correspondences by appearance or by local shape, then consensus.

mod agreement;
mod appearance;
mod by_shape;
mod consensus;
mod local_shape;
mod mutual;
mod nearest_few;

use geometry::Similarity;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::alignment::{Refusal, RegisterSettings, Source, Target};
use crate::cloud::{Descriptors, ShapedCloud};
use crate::evidence::{Clue, Evidence, false_alarms_log10};
use crate::median::median;
use agreement::Agreement;
use appearance::{Seen, match_mutual};
use by_shape::find_by_shape;

pub use appearance::Appearance;
pub use consensus::{ConsensusSettings, Correspondence, Hypothesis, find_consensus};

/// A start between the centred clouds, and what speaks for it.
#[derive(Clone, Debug)]
pub(crate) struct Found {
    pub start: Similarity<Target, Source>,
    pub evidence: Evidence,
    /// What points that look the same say; `None` where only shapes were compared.
    pub agreement: Option<Agreement>,
}

impl Found {
    /// Whether a refined alignment tears apart what looks the same.
    pub fn contradicts(&self, refined: &Similarity<Target, Source>) -> bool {
        self.agreement
            .as_ref()
            .is_some_and(|agreement| agreement.is_torn(&self.start, refined))
    }
}

/// How far points that look the same may lie apart, relative to the target's middle radius.
const INLIER_SHARE: f64 = 0.06;
/// Points of one cloud nearer than this, relative to its middle radius, are one thing mapped twice.
const TWIN_SHARE: f64 = 0.01;

/// An alignment of the centred clouds, near enough for the iteration.
pub(crate) fn find(
    source: &ShapedCloud,
    target: &ShapedCloud,
    settings: &RegisterSettings,
) -> Result<Found, Refusal> {
    let pairs = match (&source.descriptors, &target.descriptors) {
        (Descriptors::Binary(of_source), Descriptors::Binary(of_target)) => {
            match_mutual(seen(source, of_source), seen(target, of_target))
        }
        (Descriptors::Histogram(of_source), Descriptors::Histogram(of_target)) => {
            match_mutual(seen(source, of_source), seen(target, of_target))
        }
        _ => return find_by_shape(source, target, settings),
    };
    let pairs: Vec<Correspondence> = pairs
        .into_iter()
        .map(|(source_idx, target_idx)| Correspondence {
            in_target: target.points[target_idx],
            in_source: source.points[source_idx],
        })
        .collect();
    let inlier_distance = INLIER_SHARE * middle_radius(&target.points);
    find_by_appearance(&pairs, source.radius, inlier_distance, settings)
}

/// The alignment that points which look the same agree on, unless chance or another place would
/// do as well.
fn find_by_appearance(
    pairs: &[Correspondence],
    source_radius: f64,
    inlier_distance: f64,
    settings: &RegisterSettings,
) -> Result<Found, Refusal> {
    let consensus_settings = ConsensusSettings {
        with_scale: settings.with_scale,
        gravity: settings.gravity,
        inlier_distance,
        ..ConsensusSettings::default()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let hypotheses = find_consensus(pairs, &consensus_settings, &mut rng);
    let best = hypotheses.first().ok_or(Refusal::SearchFoundNothing)?;
    let start = best.target_from_source;
    let agreement = Agreement::new(pairs, &start, inlier_distance);
    let evidence = Evidence {
        clue: Clue::Appearance,
        offered_count: pairs.len(),
        consistent_count: best.inlier_count,
        runner_up_count: hypotheses.get(1).map_or(0, |second| second.inlier_count),
        false_alarms_log10: significance_of(pairs, best, inlier_distance),
        spread: agreement.spread() / source_radius,
    };
    evidence.judge()?;
    Ok(Found {
        start,
        evidence,
        agreement: Some(agreement),
    })
}

/// See [`Evidence::false_alarms_log10`].
fn significance_of(pairs: &[Correspondence], hypothesis: &Hypothesis, inlier_distance: f64) -> f64 {
    let chance = agreement::chance(pairs, &hypothesis.target_from_source, inlier_distance);
    false_alarms_log10(pairs.len(), hypothesis.inlier_count, chance)
}

fn seen<'a, D>(cloud: &'a ShapedCloud, descriptors: &'a [D]) -> Seen<'a, D> {
    Seen {
        points: &cloud.points,
        descriptors,
        twin_distance: TWIN_SHARE * middle_radius(&cloud.points),
    }
}

/// The median distance from the centre, which few far points do not move.
pub(crate) fn middle_radius(points: &[Vector3<f64>]) -> f64 {
    let mut distances: Vec<f64> = points.iter().map(Vector3::norm).collect();
    median(&mut distances, f64::total_cmp).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;

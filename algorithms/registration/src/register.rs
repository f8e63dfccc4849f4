//! One registration of two clouds, from preparation to verdict.

use geometry::{Similarity, Transform};
use nalgebra::{UnitQuaternion, Vector3};

use crate::acceptance::{judge, measure};
use crate::alignment::{
    Alignment, Outcome, Quality, Refusal, RegisterSettings, Source, Start, Target,
};
use crate::cloud::{Cloud, Descriptors, ShapedCloud};
use crate::evidence::Clue;
use crate::icp::{Icp, IcpSettings, iterate};
use crate::likeness::{Gates, Likeness, Things};
use crate::search::{self, Found, middle_radius};

/// Aligns `source` to `target`.
///
/// Deterministic: the search is seeded, sums run in fixed order.
pub fn register(source: &Cloud, target: &Cloud, settings: &RegisterSettings) -> Outcome {
    let source = ShapedCloud::new(source, settings.voxel_m);
    let target = ShapedCloud::new(target, settings.voxel_m);
    align(&source, &target, settings)
}

/// Fewer points than this are not a cloud.
const POINT_COUNT_MIN: usize = 20;

/// Aligns two clouds that are ready, so that a caller can time preparation and alignment apart.
pub fn align(source: &ShapedCloud, target: &ShapedCloud, settings: &RegisterSettings) -> Outcome {
    if source.point_count().min(target.point_count()) < POINT_COUNT_MIN {
        return Outcome::refused(Refusal::TooFewPoints {
            source_count: source.point_count(),
            target_count: target.point_count(),
        });
    }
    let given = match settings.start {
        Start::Identity => Similarity::identity(),
        Start::Given(guess) => guess,
        Start::Search => {
            return match search::find(source, target, settings) {
                Ok(found) => align_found(source, target, &found, settings),
                Err(refusal) => Outcome::refused(refusal),
            };
        }
    };
    let start = centred(source, target, &given);
    match iterate(source, target, &start, &icp_settings(settings)) {
        Some(icp) => verdict(source, target, &icp, None, settings),
        None => nothing_nearby(),
    }
}

/// Refines what a search found. Where correspondences say that the iteration ended elsewhere,
/// or where surfaces leave a direction free, they are believed: which points are the same is known
/// of them, and only guessed by nearness.
fn align_found(
    source: &ShapedCloud,
    target: &ShapedCloud,
    found: &Found,
    settings: &RegisterSettings,
) -> Outcome {
    let Some(refined) = iterate(source, target, &found.start, &icp_settings(settings)) else {
        return nothing_nearby();
    };
    let is_trusted = found.agreement.is_none()
        || (refined.converged
            && !refined.scale_bounded
            && !found.contradicts(&refined.target_from_source));
    if is_trusted {
        let outcome = verdict(source, target, &refined, Some(found), settings);
        let is_weak = matches!(
            outcome,
            Outcome::Refused {
                reason: Refusal::WeakGeometry { .. },
                ..
            }
        );
        if found.agreement.is_none() || !is_weak {
            return outcome;
        }
    }
    let kept = Icp {
        target_from_source: found.start,
        converged: true,
        scale_bounded: false,
        ..refined
    };
    verdict(source, target, &kept, Some(found), settings)
}

fn icp_settings(settings: &RegisterSettings) -> IcpSettings {
    IcpSettings {
        metric: settings.metric,
        with_scale: settings.with_scale,
        max_distance: settings.max_distance_m,
        iteration_limit: settings.iteration_limit,
    }
}

fn nothing_nearby() -> Outcome {
    Outcome::refused(Refusal::LittleOverlap {
        source: 0.0,
        target: 0.0,
    })
}

/// Measures and judges where an alignment ended.
fn verdict(
    source: &ShapedCloud,
    target: &ShapedCloud,
    icp: &Icp,
    found: Option<&Found>,
    settings: &RegisterSettings,
) -> Outcome {
    let by_correspondences = found
        .filter(|found| found.start == icp.target_from_source)
        .and_then(|found| found.agreement.as_ref());
    let mut quality = measure(source, target, icp, settings.metric, settings.with_scale);
    quality.evidence = found.map(|found| found.evidence);
    if found.is_some_and(|found| found.agreement.is_some()) {
        quality.likeness = likeness(source, target, &icp.target_from_source);
    }
    if by_correspondences.is_some() {
        // What surfaces leave free, points that are the same fix.
        quality.weak_directions.clear();
    }
    let verdict = judge(source, target, icp, &quality).and_then(|()| judge_evidence(&quality));
    let covariance = verdict.map(|()| match by_correspondences {
        Some(agreement) => agreement.covariance(&icp.target_from_source, settings.with_scale),
        None => icp.covariance(source, target, settings.metric, settings.with_scale),
    });
    match covariance {
        Ok(Some(covariance)) => {
            // S = T(c_t) S' T(−c_s): the step at the centred source moves along by T(c_s).
            let shift =
                Transform::<Source, Source>::new(UnitQuaternion::identity(), source.centroid);
            let adjoint = Similarity::from(shift).adjoint();
            Outcome::Accepted(Box::new(Alignment {
                target_from_source: uncentred(source, target, &icp.target_from_source),
                covariance: adjoint * covariance * adjoint.transpose(),
                quality,
            }))
        }
        Err(reason) => Outcome::Refused {
            reason,
            quality: Some(Box::new(quality)),
        },
        Ok(None) => Outcome::Refused {
            reason: Refusal::NotConverged,
            quality: Some(Box::new(quality)),
        },
    }
}

/// Found by shape alone, an alignment must fit clearly better than when shifted, relative to which
/// residual 1 is: right ones of rooms and of the castle, whole or cut, came to 0.49 at most, and
/// wrong ones that all else accepts to 0.6 and more.
const SHAPE_CONTRAST_MAX: f64 = 0.55;

/// The share of what both clouds show that looks alike in one place.
const EXTENT_MIN: f64 = 0.4;
/// How much overlap, presence and displacement weigh beside the extent: of round weights about
/// those of a logistic regression, the ones that part rendered rooms of one plan best from common
/// views.
const OVERLAP_WEIGHT: f64 = 1.5;
const PRESENCE_WEIGHT: f64 = 1.5;
const DISPLACED_WEIGHT: f64 = 4.0;
/// More of the correspondences, or wider apart, say no more.
const CONSISTENCY_MAX: f64 = 0.8;
/// What speaks for one place, less what speaks against it: of 648 pairs of rendered rooms of one
/// plan the best come to 3.11, and of common views from within 30° two in a hundred to less than
/// this.
const BALANCE_MIN: f64 = 3.15;

/// Whether two clouds are of one place: alike over much of it, with most of one cloud near the
/// other, by most of the correspondences and from all over it, with corners where they should be
/// and nothing displaced.
///
/// Nothing more will come, so that the likelier counts.
fn is_one_place(likeness: &Likeness, quality: &Quality) -> bool {
    let extent = likeness.extent;
    let overlap = quality.overlap_source.max(quality.overlap_target);
    let consistency = quality.evidence.map_or(2.0 * CONSISTENCY_MAX, |it| {
        let share = it.consistent_count as f64 / it.offered_count.max(1) as f64;
        share.min(CONSISTENCY_MAX) + it.spread.min(CONSISTENCY_MAX)
    });
    let balance =
        extent + OVERLAP_WEIGHT * overlap + PRESENCE_WEIGHT * likeness.presence + consistency
            - DISPLACED_WEIGHT * likeness.displaced;
    extent >= EXTENT_MIN && balance >= BALANCE_MIN
}

/// Asks more of an alignment for which only shapes speak.
fn judge_evidence(quality: &Quality) -> Result<(), Refusal> {
    let by_shape = quality
        .evidence
        .is_some_and(|evidence| evidence.clue == Clue::Shape);
    if by_shape && quality.residual_contrast > SHAPE_CONTRAST_MAX {
        return Err(Refusal::ShapeAlone {
            residual_contrast: quality.residual_contrast,
        });
    }
    match quality.likeness {
        Some(likeness) if likeness.tells_the_place() && !is_one_place(&likeness, quality) => {
            Err(Refusal::AnotherPlace {
                extent: likeness.extent,
            })
        }
        _ => Ok(()),
    }
}

/// How far a point may be from itself in the other cloud, relative to the middle radius of the
/// smaller one.
const REACH: f64 = 0.08;
/// Bits that may differ between two looks of one thing.
const BITS_MAX: u32 = 64;

/// How much of what both clouds show looks alike; `None` without binary descriptors.
fn likeness(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
) -> Option<Likeness> {
    let (Descriptors::Binary(of_source), Descriptors::Binary(of_target)) =
        (&source.descriptors, &target.descriptors)
    else {
        return None;
    };
    let moved = source
        .points
        .iter()
        .map(|point| *target_from_source * *point);
    let moved: Vec<Vector3<f64>> = moved.collect();
    let radius = middle_radius(&source.points) * target_from_source.scale();
    let reach = REACH * radius.min(middle_radius(&target.points));
    let ours = Things::new(&moved, of_source);
    let theirs = Things::new(&target.points, of_target);
    let gates = Gates {
        reach,
        bits_max: BITS_MAX,
    };
    Some(Likeness::between([&ours, &theirs], gates, []))
}

/// An alignment of the clouds as one of the centred clouds.
fn centred(
    source: &ShapedCloud,
    target: &ShapedCloud,
    alignment: &Similarity<Target, Source>,
) -> Similarity<Target, Source> {
    let translation = *alignment * source.centroid - target.centroid;
    Similarity::new(alignment.scale(), *alignment.rotation(), translation)
}

/// The inverse of [`centred`].
fn uncentred(
    source: &ShapedCloud,
    target: &ShapedCloud,
    centred: &Similarity<Target, Source>,
) -> Similarity<Target, Source> {
    let translation = target.centroid + centred.translation()
        - centred.rotation() * source.centroid * centred.scale();
    Similarity::new(centred.scale(), *centred.rotation(), translation)
}

#[cfg(test)]
mod tests;

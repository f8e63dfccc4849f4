//! One map against another's, by both ways that the product has.

use geometry::{Map, Matrix7, Similarity};
use registration::localizer::{Refusal, Verdict};
use registration::{
    AnchorIdx, ChunkIdx, Likeness, Localizer, LocalizerSettings, Outcome, Quality,
    RegisterSettings, Start, register,
};

use super::vehicle_map::VehicleMap;

/// What came of an attempt.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Answer {
    Aligned(Miss),
    /// Accepted, beyond what counts as aligned but not far off.
    Rough(Miss),
    /// Accepted, and elsewhere.
    Wrong(Miss),
    Refused(String),
}

/// How far an accepted alignment is from the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Miss {
    /// Of the scale's logarithm.
    pub scale: f64,
    pub rotation_deg: f64,
    /// Of the second vehicle's scene, relative to its depth.
    pub position: f64,
}

const ALIGNED: Miss = Miss {
    scale: 0.03,
    rotation_deg: 2.0,
    position: 0.05,
};
/// Beyond this nobody was found where they are.
const WRONG: Miss = Miss {
    scale: 0.10,
    rotation_deg: 6.0,
    position: 0.15,
};

impl Miss {
    /// - `found`, `truth`: of the second map in the first one.
    fn between(
        found: &Similarity<Map, Map>,
        truth: &Similarity<Map, Map>,
        second: &VehicleMap,
    ) -> Self {
        let map_from_site = second.truth.site_from_map.inverse();
        let depth = second.truth.depth_m * map_from_site.scale();
        let points = second.truth.points_in_site.iter();
        let mut shifts: Vec<f64> = points
            .map(|point| {
                let point = map_from_site * *point;
                (*found * point - *truth * point).norm() / truth.scale() / depth
            })
            .collect();
        shifts.sort_by(f64::total_cmp);
        Self {
            scale: (found.scale() / truth.scale()).ln().abs(),
            rotation_deg: found.rotation().angle_to(truth.rotation()).to_degrees(),
            position: shifts[shifts.len() / 2],
        }
    }

    fn is_within(&self, bounds: &Self) -> bool {
        self.scale <= bounds.scale
            && self.rotation_deg <= bounds.rotation_deg
            && self.position <= bounds.position
    }

    fn answer(self) -> Answer {
        if self.is_within(&ALIGNED) {
            Answer::Aligned(self)
        } else if self.is_within(&WRONG) {
            Answer::Rough(self)
        } else {
            Answer::Wrong(self)
        }
    }
}

/// The first map as an anchor's, the second one's keyframes one after the other as in flight.
///
/// Returns what came of it, and what spoke for it.
///
/// - `is_common`: whether the maps have anything in common; otherwise any alignment is wrong.
pub(super) fn localise(
    first: &VehicleMap,
    second: &VehicleMap,
    is_common: bool,
) -> (Answer, String) {
    let mut notes = String::new();
    let mut localizer = Localizer::new(LocalizerSettings::default());
    let anchor = AnchorIdx(0);
    for (idx, chunk) in (0..).zip(&first.chunks) {
        localizer.insert_chunk(anchor, ChunkIdx(idx), chunk.landmarks.clone());
        localizer.place_chunk(anchor, ChunkIdx(idx), chunk.map_from_chunk);
    }
    let covariance = Matrix7::identity() * 1e-12;
    localizer.place_anchor(anchor, Similarity::identity(), covariance, 1);
    let truth = truth(first, second);
    let mut answer = Answer::Refused("no keyframe".to_owned());
    for keyframe in &second.keyframes {
        let report = localizer.observe_keyframe(keyframe);
        notes = said(report.anchors.first().and_then(|one| one.likeness));
        match localizer.estimate(keyframe.captured_at) {
            None => answer = Answer::Refused(refusal(&report.verdict)),
            Some(estimate) => {
                let found: Similarity<Map, Map> = estimate.enu_from_map.relabel();
                let miss = Miss::between(&found, &truth, second);
                answer = if is_common {
                    miss.answer()
                } else {
                    Answer::Wrong(miss)
                };
                if matches!(answer, Answer::Wrong(_)) {
                    // Once believed, it has led the vehicle astray.
                    return (answer, notes);
                }
            }
        }
    }
    (answer, notes)
}

fn refusal(verdict: &Verdict) -> String {
    match verdict {
        Verdict::Refused(Refusal::NoLandmarks) => "no landmarks".to_owned(),
        verdict => verdict.to_string(),
    }
}

/// Both maps as whole clouds, from nothing.
///
/// Returns what came of it, and what spoke for it.
pub(super) fn register_clouds(
    first: &VehicleMap,
    second: &VehicleMap,
    is_common: bool,
) -> (Answer, String) {
    let settings = RegisterSettings {
        with_scale: true,
        start: Start::Search,
        ..RegisterSettings::default()
    };
    match register(&second.cloud, &first.cloud, &settings) {
        Outcome::Refused { reason, quality } => {
            let notes = quality.map_or_else(String::new, |it| measured(&it));
            (Answer::Refused(reason.to_string()), notes)
        }
        Outcome::Accepted(alignment) => {
            let found: Similarity<Map, Map> = alignment.target_from_source.relabel();
            let miss = Miss::between(&found, &truth(first, second), second);
            let answer = if is_common {
                miss.answer()
            } else {
                Answer::Wrong(miss)
            };
            (answer, measured(&alignment.quality))
        }
    }
}

fn measured(quality: &Quality) -> String {
    let consistent = quality.evidence.map_or_else(String::new, |it| {
        format!(
            "{} of {} spread over {:.2}, ",
            it.consistent_count, it.offered_count, it.spread
        )
    });
    format!(
        "{consistent}overlap {:.2} and {:.2}, {}",
        quality.overlap_source,
        quality.overlap_target,
        said(quality.likeness)
    )
}

fn said(likeness: Option<Likeness>) -> String {
    likeness.map_or_else(String::new, |likeness| {
        let bareness = likeness.bareness.unwrap_or(f64::NAN);
        format!(
            "alike over {:.2} ± {:.2} by {}, corners {:.2}, bare {bareness:.2}, displaced {:.2}",
            likeness.extent, likeness.sigma, likeness.count, likeness.presence, likeness.displaced
        )
    })
}

fn truth(first: &VehicleMap, second: &VehicleMap) -> Similarity<Map, Map> {
    first.truth.site_from_map.inverse() * second.truth.site_from_map
}

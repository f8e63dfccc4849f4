//! The first two keyframes of a map.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, UnitQuaternion, Vector2};
use rand_chacha::ChaCha8Rng;

use crate::bundle::{BundleSettings, Workspace};
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::mapping::adjust_all;
use crate::optics::Optics;
use crate::search::{Gate, Wanted, consistent_turns, find};
use crate::two_view::{Correspondence, TwoView, TwoViewRefusal, TwoViewSettings, reconstruct};
use crate::{StartReason, View, VslamMap};

/// A frame with fewer keypoints is no start.
const KEYPOINTS_MIN: usize = 80;
/// Fewer matches make the current frame the new reference.
const MATCHES_MIN: usize = 60;
/// A reference is replaced after this time: what it showed may have changed.
const REFERENCE_AGE_MAX_S: f64 = 4.0;
/// A map starts with at least this many points.
const POINTS_MIN: usize = 50;
/// Median angle between the two rays of a point: 2.5°, and what the noise needs.
const PARALLAX_RAD_MIN: f64 = 0.044;
const PARALLAX_SIGMAS_MIN: f64 = 6.0;
/// Window around where a keypoint was seen last, pixels at a width of 640.
const WINDOW_PX: f64 = 80.0;
const GATE: Gate = Gate {
    distance_max: 64,
    ratio_max: 0.9,
};

/// Waits for a second view that differs enough from the first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Starter {
    reference: Option<Reference>,
    /// How the camera's axes turned since the last frame (`now_from_last`), if a gyroscope tells.
    pub(crate) turn: Option<UnitQuaternion<f64>>,
}

#[derive(Clone, Debug)]
struct Reference {
    frame: Frame,
    /// Where each keypoint was matched last.
    last_seen: Vec<Vector2<f64>>,
}

/// Indices of one keypoint in the reference and in the current frame.
type Pair = (usize, usize);

impl Starter {
    /// Takes the next frame: a map with two keyframes, the second of which is this frame, or why
    /// there is none.
    pub(crate) fn advance(
        &mut self,
        optics: &Optics,
        frame: Frame,
        (empty, workspace): (&VslamMap, &mut Workspace),
        rng: &mut ChaCha8Rng,
    ) -> Result<VslamMap, StartReason> {
        if frame.observations.len() < KEYPOINTS_MIN {
            return Err(StartReason::FewKeypoints);
        }
        let Some(reference) = &mut self.reference else {
            self.reference = Some(Reference::new(frame));
            return Err(StartReason::FirstFrame);
        };
        let pairs = reference.follow(optics, &frame, self.turn.as_ref());
        let age_s = frame.captured_at - reference.frame.captured_at;
        if pairs.len() < MATCHES_MIN || age_s > REFERENCE_AGE_MAX_S {
            self.reference = Some(Reference::new(frame));
            return Err(StartReason::FewMatches);
        }
        let view = two_view(reference, &frame, &pairs, rng)?;
        let map = build(empty, (&reference.frame, &frame), (&pairs, &view));
        let map = polish(map, workspace)?;
        self.reference = None;
        Ok(map)
    }
}

impl Reference {
    fn new(frame: Frame) -> Self {
        let last_seen = frame.observations.iter().map(|one| one.position).collect();
        Self { frame, last_seen }
    }

    /// Matches the next frame, where keypoints were last or where a turn puts them: where more are
    /// found. Before there is a map nothing else tells whether a gyroscope is right.
    fn follow(
        &mut self,
        optics: &Optics,
        frame: &Frame,
        turn: Option<&UnitQuaternion<f64>>,
    ) -> Vec<Pair> {
        let unturned = std::iter::once(self.last_seen.clone());
        let tried = unturned.chain(turn.map(|turn| self.turned_by(turn)));
        let tried = tried.map(|expected| {
            let pairs = self.match_frame(optics, frame, &expected);
            (expected, pairs)
        });
        let (expected, pairs) = tried
            .max_by_key(|(_, pairs)| pairs.len())
            .expect("what was seen last is always tried");
        self.last_seen = expected;
        for &(first, second) in &pairs {
            self.last_seen[first] = frame.observations[second].position;
        }
        pairs
    }

    /// Where this turn of the camera puts all keypoints.
    fn turned_by(&self, turn: &UnitQuaternion<f64>) -> Vec<Vector2<f64>> {
        let last_seen = self.last_seen.iter();
        let turned = last_seen.map(|position| {
            let ray = turn * position.push(1.0);
            if ray.z > 0.0 {
                ray.xy() / ray.z
            } else {
                *position
            }
        });
        turned.collect()
    }

    /// - `expected`: where each keypoint should be.
    fn match_frame(&self, optics: &Optics, frame: &Frame, expected: &[Vector2<f64>]) -> Vec<Pair> {
        let mut best_of: Vec<Option<(usize, u32)>> = vec![None; frame.observations.len()];
        for (idx, observation) in self.frame.observations.iter().enumerate() {
            let level = observation.level;
            let wanted = Wanted {
                position: expected[idx],
                radius: WINDOW_PX * optics.window,
                levels: level.saturating_sub(1)..=level + 1,
                descriptor: &observation.descriptor,
            };
            let target = (&frame.grid, frame.observations.as_slice());
            if let Some(found) = find(&wanted, target, GATE, |_| true) {
                let best = &mut best_of[found.observation_idx];
                if best.is_none_or(|(_, distance)| found.distance < distance) {
                    *best = Some((idx, found.distance));
                }
            }
        }
        let pairs: Vec<Pair> = best_of
            .into_iter()
            .enumerate()
            .filter_map(|(current, best)| Some((best?.0, current)))
            .collect();
        let turn = |&(first, second): &Pair| {
            frame.observations[second].angle_rad - self.frame.observations[first].angle_rad
        };
        let turns_rad: Vec<f32> = pairs.iter().map(turn).collect();
        let consistent = consistent_turns(&turns_rad);
        let kept = pairs.into_iter().zip(consistent);
        kept.filter_map(|(pair, consistent)| consistent.then_some(pair))
            .collect()
    }
}

fn two_view(
    reference: &Reference,
    frame: &Frame,
    pairs: &[Pair],
    rng: &mut ChaCha8Rng,
) -> Result<TwoView, StartReason> {
    let correspondences: Vec<Correspondence> = pairs
        .iter()
        .map(|&(first, second)| Correspondence {
            first: reference.frame.observations[first].position,
            second: frame.observations[second].position,
        })
        .collect();
    // That of the finest level: with more, little parallax would pass for a rotation.
    let sigma = pairs
        .iter()
        .map(|&(_, second)| frame.observations[second].sigma)
        .fold(f64::INFINITY, f64::min);
    let settings = TwoViewSettings {
        sigma,
        point_count_min: POINTS_MIN,
        match_count_min: MATCHES_MIN,
        parallax_rad_min: PARALLAX_RAD_MIN.max(PARALLAX_SIGMAS_MIN * sigma),
        ..TwoViewSettings::default()
    };
    reconstruct(&correspondences, &settings, rng).map_err(|refusal| match refusal {
        TwoViewRefusal::TooFewMatches { .. } => StartReason::FewMatches,
        TwoViewRefusal::PureRotation if has_turned(&correspondences) => StartReason::OnlyTurned,
        TwoViewRefusal::PureRotation | TwoViewRefusal::LowParallax { .. } => {
            StartReason::LowParallax
        }
        TwoViewRefusal::Ambiguous { .. } => StartReason::Ambiguous,
        TwoViewRefusal::TooFewInliers { .. } | TwoViewRefusal::TooFewPoints { .. } => {
            StartReason::Unstable
        }
    })
}

/// Whether keypoints moved at all; a camera that stands still has not turned either.
fn has_turned(correspondences: &[Correspondence]) -> bool {
    let shifts = correspondences
        .iter()
        .map(|one| (one.second - one.first).norm());
    let mut shifts: Vec<f64> = shifts.collect();
    shifts.sort_by(f64::total_cmp);
    shifts
        .get(shifts.len() / 2)
        .is_some_and(|shift| *shift > PARALLAX_RAD_MIN)
}

/// The map of two views, in units of the median depth of its points before the first.
fn build(
    empty: &VslamMap,
    (first, second): (&Frame, &Frame),
    (pairs, view): (&[Pair], &TwoView),
) -> VslamMap {
    let mut depths: Vec<f64> = view
        .points_in_first
        .iter()
        .flatten()
        .map(|one| one.z)
        .collect();
    depths.sort_by(f64::total_cmp);
    let unit = 1.0 / depths[depths.len() / 2];
    let motion = &view.second_from_first;
    let second_from_first: Transform<Camera, Camera> =
        Transform::new(*motion.rotation(), motion.translation() * unit);
    let mut map = empty.clone();
    let first_id = map.add_keyframe(first.clone(), Transform::identity());
    let second_id = map.add_keyframe(second.clone(), second_from_first.relabel());
    if let Some(keyframe) = map.keyframe_mut(second_id) {
        keyframe.parent = Some(first_id);
    }
    for (&(first_idx, second_idx), point) in pairs.iter().zip(&view.points_in_first) {
        let Some(point) = point else {
            continue;
        };
        let new = NewPoint {
            position_in_map: point * unit,
            covariance_in_map: Matrix3::identity(),
            parallax_rad: 0.0,
            expected_range: None,
        };
        let view = |keyframe, idx: usize| View {
            keyframe,
            observation_idx: idx as u32,
        };
        map.add_point(
            new,
            vec![view(first_id, first_idx), view(second_id, second_idx)],
        );
    }
    map
}

/// Adjusts the new map, and refuses it if too little of it survives.
fn polish(mut map: VslamMap, workspace: &mut Workspace) -> Result<VslamMap, StartReason> {
    let settings = BundleSettings {
        iteration_count_max: 20,
        refit_iteration_count_max: 5,
        ..BundleSettings::default()
    };
    adjust_all(&mut map, &settings, workspace);
    let behind: Vec<_> = map
        .points()
        .filter(|point| {
            map.keyframes()
                .any(|keyframe| (*keyframe.camera_from_map() * point.position_in_map).z <= 0.0)
        })
        .map(|point| point.id)
        .collect();
    for point in behind {
        map.remove_point(point);
    }
    if map.point_count() < POINTS_MIN {
        return Err(StartReason::Unstable);
    }
    Ok(map)
}

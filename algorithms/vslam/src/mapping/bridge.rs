//! Places in a turn, from everything that was seen on the way.
//!
//! A camera that turns fast sees nothing for long: the last points of known range leave the image
//! before the new ones have parallax, and no single keyframe is held by what is known. Together
//! they are. Each thing that two or three of them saw ties the way between them to the way before
//! it, however little that tells of its own range.

use super::adjust::{BORDER_MAX, LOCAL, Selection, Solved, apply, renew_point, sighting};
use super::grow::{PARALLAX_RAD_MIN, parallax_rad_min};
use crate::bundle::{BundleProblem, BundleSettings, Workspace};
use crate::held::{PLACE_SIGMA_MAX, is_placed};
use crate::map::VslamMap;
use crate::triangulation::{Sighting, parallax_rad};
use crate::{Keyframe, KeyframeId};

/// Keyframes without a place that may hang on what was known before them. A turn at few frames a
/// second takes no more; a camera that goes on for longer pans on the spot, and has drifted.
const UNPLACED_MAX: usize = 3;
/// Keyframes before them that move with them: what a turn shows also tells of the way into it.
const PLACED_MAX: usize = 6;
/// Fewer keyframes around them do not hold the scale.
const BORDER_MIN: usize = 2;
/// The newest must show so many things that agree.
const INLIERS_MIN: usize = 40;
/// A place that is less certain than this, as a share of the way from the last one, is none: all
/// that is new would be too near or too far by as much.
const STEP_SIGMA_MAX: f64 = 0.1;
/// A point gets a range if its rays meet at an angle of so many standard deviations of the places
/// that they come from: a step of unknown length tells no distances.
const PLACE_SIGMAS_MIN: f64 = 5.0;

/// Places the newest keyframes that have no place, by everything that they see; returns the ones
/// that could move, and how far the newest did. `None` where it has a place, or where all that was
/// seen does not tell: then nothing has changed.
pub(super) fn bridge(
    map: &mut VslamMap,
    newest: KeyframeId,
    workspace: &mut Workspace,
) -> Option<(Vec<KeyframeId>, f64)> {
    let (free, last_placed) = free_keyframes(map)?;
    let selection = select(map, &free)?;
    let (before, views) = selection.problem(map);
    let settings = BundleSettings {
        pose_covariances: true,
        ..LOCAL
    };
    let solved = Solved::of(&before, &settings, workspace);
    let newest_idx = selection.keyframes.binary_search(&newest).ok()?;
    let last_idx = selection.keyframes.binary_search(&last_placed).ok()?;
    let depth = agreeing_depth(&solved, newest_idx)?;
    let step = solved.distance(last_idx, newest_idx);
    let sigma = sigma_of_place(&solved, newest_idx)?;
    let sigma_max = f64::min(PLACE_SIGMA_MAX * depth, STEP_SIGMA_MAX * step);
    // A shorter step shows no parallax that counts: what keypoints err in common looks like one.
    let steps_aside = step >= PARALLAX_RAD_MIN * depth;
    if !solved.report.converged || sigma > sigma_max || !steps_aside {
        return None;
    }
    apply(map, &selection, (&before, &views), &solved);
    for point_idx in 0..selection.points.len() {
        give_range(map, &selection, &solved, (point_idx, sigma));
    }
    Some((free, solved.shift(&before, newest_idx)))
}

/// The newest without a place and the last few with one, newest first; and the last with one.
fn free_keyframes(map: &VslamMap) -> Option<(Vec<KeyframeId>, KeyframeId)> {
    let newest = || map.keyframes().rev();
    let unplaced = newest().take_while(|one| !is_placed(map, one));
    let unplaced_count = unplaced.take(UNPLACED_MAX + 1).count();
    if !(1..=UNPLACED_MAX).contains(&unplaced_count) {
        return None;
    }
    let free = newest().take(unplaced_count + PLACED_MAX);
    let free: Vec<KeyframeId> = free.map(Keyframe::id).collect();
    let last_placed = *free.get(unplaced_count)?;
    Some((free, last_placed))
}

/// `None` where nothing would hold the scale: a map of a few keyframes.
fn select(map: &VslamMap, free: &[KeyframeId]) -> Option<Selection> {
    let points = map.points_of(free);
    let seeing = map.seen_by(points.iter().copied());
    let placed = |id: &KeyframeId| map.keyframe(*id).is_some_and(|one| is_placed(map, one));
    let border = seeing.iter().map(|one| one.keyframe);
    let border = border.filter(|id| !free.contains(id) && placed(id));
    let mut keyframes: Vec<KeyframeId> = border.take(BORDER_MAX).collect();
    if keyframes.len() < BORDER_MIN {
        return None;
    }
    keyframes.extend(free);
    keyframes.sort_unstable();
    let fixed = |id: &KeyframeId| !free.contains(id);
    Some(Selection::new(keyframes, points, fixed, |_| false))
}

/// How far away the things are that agree with a keyframe, if there are enough.
fn agreeing_depth(solved: &Solved, pose_idx: usize) -> Option<f64> {
    let BundleProblem {
        poses,
        points,
        observations,
    } = &solved.problem;
    let agreeing = observations.iter().zip(&solved.report.inliers);
    let agreeing = agreeing.filter(|(one, inlier)| **inlier && one.pose_idx == pose_idx);
    let depth = |point_idx: usize| (poses[pose_idx].camera_from_map * points[point_idx]).z;
    let mut depths: Vec<f64> = agreeing.map(|(one, _)| depth(one.point_idx)).collect();
    if depths.len() < INLIERS_MIN {
        return None;
    }
    let middle = depths.len() / 2;
    Some(*depths.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// One standard deviation of where a keyframe is, in its least certain direction, with the noise
/// that the keypoints turn out to have.
fn sigma_of_place(solved: &Solved, pose_idx: usize) -> Option<f64> {
    let covariance = solved.report.pose_covariances.get(pose_idx)?.as_ref()?;
    let of_place = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    let variance = of_place.symmetric_eigenvalues().max();
    let sigma = (variance * solved.report.variance_factor?).sqrt();
    sigma.is_finite().then_some(sigma)
}

/// Moves a point of unknown range to where the adjustment puts it, if its views tell.
fn give_range(
    map: &mut VslamMap,
    selection: &Selection,
    solved: &Solved,
    (point_idx, sigma): (usize, f64),
) {
    let id = selection.points[point_idx];
    let position = &solved.problem.points[point_idx];
    let covariance = solved.report.point_covariances[point_idx];
    let Some((point, covariance)) = map.point(id).zip(covariance) else {
        return;
    };
    let sightings = point.views().iter().filter_map(|view| sighting(map, view));
    let sightings: Vec<Sighting> = sightings.collect();
    if point.has_range() || sightings.len() < 2 {
        return;
    }
    let range = |one: &Sighting| (one.camera_from_map * *position).norm();
    let nearest = sightings.iter().map(range).fold(f64::INFINITY, f64::min);
    let noise = sightings.iter().map(|one| one.sigma).fold(0.0, f64::max);
    let noise = noise * std::f64::consts::SQRT_2;
    let least = parallax_rad_min(noise).max(PLACE_SIGMAS_MIN * sigma / nearest);
    if parallax_rad(&sightings, position) < least {
        return;
    }
    if let Some(point) = map.point_mut(id) {
        point.position_in_map = *position;
        point.expected_range = None;
    }
    renew_point(map, id, Some(&covariance));
}

#[cfg(test)]
mod tests;

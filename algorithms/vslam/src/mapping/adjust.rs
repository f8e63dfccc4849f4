//! Bundle adjustment of a part of the map.

use geometry::Transform;
use nalgebra::{Matrix3, Vector3};

use super::settling::{SHIFT_MAX, YOUNG_KEYFRAMES};
use crate::bundle::{
    BundleObservation, BundlePose, BundleProblem, BundleReport, BundleSettings, Workspace, adjust,
};
use crate::held::is_placed;
use crate::triangulation::{Sighting, parallax_rad};
use crate::{KeyframeId, MapPoint, PointId, View, VslamMap};

/// Keyframes that a local adjustment moves, at most.
const WINDOW_MAX: usize = 12;
/// Keyframes that hold its border, at most; those that see most come first.
pub(super) const BORDER_MAX: usize = 16;
/// Fewer points do not tell by how much the map around a keyframe was stretched.
const STRETCH_POINTS_MIN: usize = 10;
/// A keyframe joins the window if it shares this many points.
const SHARED_MIN: u32 = 15;

/// What a keyframe that is held where it was tracked to may cost for each point that it sees; each
/// of them costs about two anyway. In valleys it was 0.1 to 0.5.
const HELD_PRICE_MAX: f64 = 1.0;

/// Which keyframes and points of the map the rows of a problem are.
#[derive(Clone, Debug)]
pub(crate) struct Selection {
    pub(crate) keyframes: Vec<KeyframeId>,
    pub(crate) points: Vec<PointId>,
    fixed: Vec<bool>,
    /// Where these are was not measured: they cannot move, and what they see does not count.
    unplaced: Vec<bool>,
}

impl Selection {
    /// These rows, in the order of keyframes and points; `fixed` and `unplaced` are asked of each
    /// keyframe.
    pub(super) fn new(
        keyframes: Vec<KeyframeId>,
        points: Vec<PointId>,
        fixed: impl Fn(&KeyframeId) -> bool,
        unplaced: impl Fn(&KeyframeId) -> bool,
    ) -> Self {
        Self {
            fixed: keyframes.iter().map(fixed).collect(),
            unplaced: keyframes.iter().map(unplaced).collect(),
            keyframes,
            points,
        }
    }

    /// Everything.
    pub(crate) fn all(map: &VslamMap) -> Self {
        let window: Vec<KeyframeId> = map.keyframes().map(crate::Keyframe::id).collect();
        select(map, &window)
    }

    /// The problem with these rows, and the view that each of its observations is.
    pub(crate) fn problem(&self, map: &VslamMap) -> (BundleProblem, Vec<ViewName>) {
        problem(map, self)
    }
}

/// Adjusts a keyframe and those that share most with it; returns the keyframes that could move, and
/// how far the newest would have moved if nothing had held it.
pub(crate) fn adjust_local(
    map: &mut VslamMap,
    id: KeyframeId,
    workspace: &mut Workspace,
) -> (Vec<KeyframeId>, f64) {
    let mut window = vec![id];
    window.extend(
        map.covisible(id)
            .iter()
            .take(WINDOW_MAX - 1)
            .filter(|one| one.shared_count >= SHARED_MIN)
            .map(|one| one.keyframe),
    );
    let selection = select(map, &window);
    let (before, views) = problem(map, &selection);
    let mut solved = Solved::of(&before, &LOCAL, workspace);
    let idx = selection.keyframes.binary_search(&id).ok();
    let shift = idx.map_or(0.0, |idx| solved.shift(&before, idx));
    let held = idx.and_then(|idx| hold(map, (id, idx), (&before, &solved), workspace));
    if let Some(held) = held {
        solved = held;
    }
    apply(map, &selection, (&before, &views), &solved);
    (window, shift)
}

/// Where the newest keyframe was tracked to, if the adjustment takes it far from there for next to
/// nothing: then it has followed a valley, along which a turn and a step explain what is seen
/// nearly as well, and noise that keypoints share decides where it ends. The way of the camera
/// until now knows better.
fn hold(
    map: &VslamMap,
    (newest, idx): (KeyframeId, usize),
    (before, free): (&BundleProblem, &Solved),
    workspace: &mut Workspace,
) -> Option<Solved> {
    let depth = map.median_depth(newest)?.abs();
    let is_young = map.keyframe_count() <= YOUNG_KEYFRAMES;
    if is_young || before.poses[idx].fixed || free.shift(before, idx) <= SHIFT_MAX * depth {
        return None;
    }
    let mut bound = before.clone();
    bound.poses[idx].fixed = true;
    let held = Solved::of(&bound, &LOCAL, workspace);
    let seen = before.observations.iter().filter(|one| one.pose_idx == idx);
    let price = held.report.cost_after - free.report.cost_after;
    (price <= HELD_PRICE_MAX * seen.count() as f64).then_some(held)
}

pub(super) const LOCAL: BundleSettings = BundleSettings {
    iteration_count_max: 40,
    // A match that is wrong by far pulls as hard as any, and where few points tell a turn from
    // a step a handful of them decides. Left out too late, the map has grown on what they said.
    refit_iteration_count_max: 20,
    // Rotation and sideways motion explain nearly the same residuals. Steps along that valley
    // gain little, and a map that does not take them shrinks from keyframe to keyframe.
    cost_decrease_min: 1e-6,
    ..BundleSettings::DEFAULT
};

/// Adjusts everything; meant for maps of a few keyframes.
pub(crate) fn adjust_all(
    map: &mut VslamMap,
    settings: &BundleSettings,
    workspace: &mut Workspace,
) -> BundleReport {
    let selection = Selection::all(map);
    run(map, &selection, settings, workspace)
}

/// The window with its points and border, in the order of time.
///
/// At least one keyframe is fixed. A young map has no border: then no second one is fixed either,
/// so that what the first two views got wrong is not for ever; see [`keep_scale`].
fn select(map: &VslamMap, window: &[KeyframeId]) -> Selection {
    // The others say nothing of where cameras are.
    let ranged = |point: &PointId| map.point(*point).is_some_and(MapPoint::has_range);
    let mut points = map.points_of(window);
    points.retain(ranged);
    let seeing = map.seen_by(points.iter().copied());
    let border = seeing
        .iter()
        .map(|one| one.keyframe)
        .filter(|id| !window.contains(id))
        .take(BORDER_MAX);
    let mut fixed_ids: Vec<KeyframeId> = border.collect();
    let mut keyframes: Vec<KeyframeId> = window.iter().chain(&fixed_ids).copied().collect();
    keyframes.sort_unstable();
    let origin = map.keyframes().next().map(crate::Keyframe::id);
    fixed_ids.extend(origin.filter(|origin| window.contains(origin)));
    if fixed_ids.is_empty() {
        fixed_ids.extend(keyframes.first());
    }
    let unplaced = |id: &KeyframeId| map.keyframe(*id).is_some_and(|one| !is_placed(map, one));
    Selection::new(keyframes, points, |id| fixed_ids.contains(id), unplaced)
}

fn run(
    map: &mut VslamMap,
    selection: &Selection,
    settings: &BundleSettings,
    workspace: &mut Workspace,
) -> BundleReport {
    let (before, views) = problem(map, selection);
    let solved = Solved::of(&before, settings, workspace);
    apply(map, selection, (&before, &views), &solved);
    solved.report
}

/// An adjusted problem.
pub(super) struct Solved {
    pub(super) problem: BundleProblem,
    pub(super) report: BundleReport,
    /// By how much it was stretched to keep its scale.
    scale: f64,
}

impl Solved {
    pub(super) fn of(
        before: &BundleProblem,
        settings: &BundleSettings,
        workspace: &mut Workspace,
    ) -> Self {
        let mut problem = before.clone();
        let report = adjust(&mut problem, settings, workspace);
        let scale = keep_scale(before, &mut problem);
        Self {
            problem,
            report,
            scale,
        }
    }

    /// How far a pose has moved.
    pub(super) fn shift(&self, before: &BundleProblem, pose_idx: usize) -> f64 {
        (self.centre(pose_idx) - centre(&before.poses[pose_idx])).norm()
    }

    /// How far two poses are from each other.
    pub(super) fn distance(&self, from: usize, to: usize) -> f64 {
        (self.centre(to) - self.centre(from)).norm()
    }

    fn centre(&self, pose_idx: usize) -> Vector3<f64> {
        centre(&self.problem.poses[pose_idx])
    }
}

/// Where a camera is in the map.
fn centre(pose: &BundlePose) -> Vector3<f64> {
    *pose.camera_from_map.inverse().translation()
}

/// Brings an adjustment into the map; points of unknown range stay where they are.
pub(super) fn apply(
    map: &mut VslamMap,
    selection: &Selection,
    (before, views): (&BundleProblem, &[ViewName]),
    solved: &Solved,
) {
    let Solved {
        problem,
        report,
        scale,
    } = solved;
    let ranged = |id: &PointId| map.point(*id).is_some_and(MapPoint::has_range);
    let ranged: Vec<bool> = selection.points.iter().map(ranged).collect();
    let stretches = stretches(before, problem, |point_idx| ranged[point_idx]);
    let poses = selection.keyframes.iter().zip(&problem.poses);
    for ((id, pose), stretch) in poses.zip(stretches) {
        if let Some(keyframe) = map.keyframe_mut(*id) {
            keyframe.camera_from_map = pose.camera_from_map;
            keyframe.unit *= stretch;
        }
    }
    for (&(point, keyframe), inlier) in views.iter().zip(&report.inliers) {
        if !inlier {
            map.unlink(point, keyframe);
        }
    }
    for (point_idx, id) in selection.points.iter().enumerate() {
        let Some(point) = map.point_mut(*id).filter(|_| ranged[point_idx]) else {
            continue;
        };
        point.position_in_map = problem.points[point_idx];
        let covariance = report.point_covariances[point_idx];
        let covariance = covariance.map(|covariance| covariance * (scale * scale));
        renew_point(map, *id, covariance.as_ref());
    }
}

/// Where a single keyframe is fixed the scale is free, and the adjustment leaves it anywhere.
/// Takes the one at which the cameras stay where they were as far as they can: who has their
/// earlier poses need not know that the map has changed. Returns by how much that stretched it.
fn keep_scale(before: &BundleProblem, after: &mut BundleProblem) -> f64 {
    let holds = |idx: &usize| {
        let sees = |one: &BundleObservation| one.pose_idx == *idx;
        before.poses[*idx].fixed && before.observations.iter().any(sees)
    };
    let mut holding = (0..before.poses.len()).filter(holds);
    let (Some(origin), None) = (holding.next(), holding.next()) else {
        return 1.0;
    };
    let origin = centre(&before.poses[origin]);
    let (mut along, mut length_squared) = (0.0, 0.0);
    let pairs = before.poses.iter().zip(&after.poses);
    for (before, after) in pairs.filter(|(before, _)| !before.fixed) {
        let (before, after) = (centre(before) - origin, centre(after) - origin);
        along += before.dot(&after);
        length_squared += after.norm_squared();
    }
    let scale = along / length_squared;
    if !scale.is_finite() || scale <= 0.0 {
        return 1.0;
    }
    for pose in after.poses.iter_mut().filter(|pose| !pose.fixed) {
        let centre = origin + (centre(pose) - origin) * scale;
        let rotation = *pose.camera_from_map.rotation();
        pose.camera_from_map = Transform::new(rotation, -(rotation * centre));
    }
    for point in &mut after.points {
        *point = origin + (*point - origin) * scale;
    }
    scale
}

/// Brings what is known of a point up to date after it was adjusted.
pub(crate) fn renew_point(map: &mut VslamMap, id: PointId, covariance: Option<&Matrix3<f64>>) {
    if let (Some(point), Some(covariance)) = (map.point_mut(id), covariance) {
        point.covariance_in_map = *covariance;
    }
    update_parallax(map, id);
    map.refresh_point(id);
}

/// By how much the points that each keyframe sees moved away from it: the median of the ratios of
/// those that count.
pub(crate) fn stretches(
    before: &BundleProblem,
    after: &BundleProblem,
    counts: impl Fn(usize) -> bool,
) -> Vec<f64> {
    let mut ratios: Vec<Vec<f64>> = vec![Vec::new(); before.poses.len()];
    for observation in &before.observations {
        if !counts(observation.point_idx) {
            continue;
        }
        let (pose_idx, point_idx) = (observation.pose_idx, observation.point_idx);
        let depth = |problem: &BundleProblem| {
            (problem.poses[pose_idx].camera_from_map * problem.points[point_idx]).z
        };
        ratios[pose_idx].push(depth(after) / depth(before));
    }
    let median = |mut ratios: Vec<f64>| {
        ratios.retain(|ratio| *ratio > 0.0 && ratio.is_finite());
        ratios.sort_by(f64::total_cmp);
        let median = ratios.get(ratios.len() / 2).copied();
        median
            .filter(|_| ratios.len() >= STRETCH_POINTS_MIN)
            .unwrap_or(1.0)
    };
    ratios.into_iter().map(median).collect()
}

pub(crate) type ViewName = (PointId, KeyframeId);

fn problem(map: &VslamMap, selection: &Selection) -> (BundleProblem, Vec<ViewName>) {
    let mut problem = BundleProblem::default();
    let mut views = Vec::new();
    let held = selection.fixed.iter().zip(&selection.unplaced);
    for (id, (fixed, unplaced)) in selection.keyframes.iter().zip(held) {
        let keyframe = map
            .keyframe(*id)
            .expect("the selection holds the map's keyframes");
        problem.poses.push(BundlePose {
            camera_from_map: keyframe.camera_from_map,
            fixed: *fixed || *unplaced,
        });
    }
    for (point_idx, id) in selection.points.iter().enumerate() {
        let point = map
            .point(*id)
            .expect("the selection holds the map's points");
        problem.points.push(point.position_in_map);
        for view in &point.views {
            let Ok(pose_idx) = selection.keyframes.binary_search(&view.keyframe) else {
                continue;
            };
            if selection.unplaced[pose_idx] {
                continue;
            }
            let keyframe = map
                .keyframe(view.keyframe)
                .expect("views name the map's keyframes");
            let observation = &keyframe.observations[view.observation_idx as usize];
            problem.observations.push(BundleObservation {
                pose_idx,
                point_idx,
                position: observation.position,
                sigma: observation.sigma,
            });
            views.push((*id, view.keyframe));
        }
    }
    (problem, views)
}

/// The widest angle only grows while views are added, so a few views tell it well enough.
fn update_parallax(map: &mut VslamMap, id: PointId) {
    let Some(point) = map.point(id) else {
        return;
    };
    let chosen = point.views.first().into_iter().chain(point.views.last());
    let sightings: Vec<Sighting> = chosen.filter_map(|view| sighting(map, view)).collect();
    let position: Vector3<f64> = point.position_in_map;
    let parallax = parallax_rad(&sightings, &position).max(point.parallax_rad);
    if let Some(point) = map.point_mut(id) {
        point.parallax_rad = parallax;
    }
}

pub(super) fn sighting(map: &VslamMap, view: &View) -> Option<Sighting> {
    let keyframe = map.keyframe(view.keyframe)?;
    let observation = &keyframe.observations[view.observation_idx as usize];
    Some(Sighting {
        camera_from_map: keyframe.camera_from_map,
        position: observation.position,
        sigma: observation.sigma,
    })
}

#[cfg(test)]
mod tests;

//! Fits all keyframes and points together, beside the frames.
//!
//! A loop closed by a pose graph is right at its seam and nearly right elsewhere; the observations
//! themselves say the rest. While that is worked out the map goes on growing: what was found is
//! then applied as a motion of each keyframe, and newer keyframes go along.

use std::collections::BTreeMap;

use geometry::{Map, Similarity};
use nalgebra::Vector3;

use crate::bundle::{BundleProblem, BundleReport, BundleSettings, Workspace, adjust};
use crate::map::Moves;
use crate::mapping::{Selection, renew_point, stretches};
use crate::{KeyframeId, PointId, VslamMap};

/// Steps in all. Those along the loop are seen last, when the damping has gone down.
pub(super) const STEPS_MAX: usize = 40;
/// A step that lowers the cost by less than this share of it is the last.
const COST_DECREASE_MIN: f64 = 1e-6;

/// An adjustment of a whole map under way.
#[derive(Debug)]
pub(crate) struct GlobalAdjustment {
    selection: Selection,
    views: Vec<(PointId, KeyframeId)>,
    /// As the map was, and as it should have been.
    before: BundleProblem,
    problem: BundleProblem,
    damping: f64,
    step_count: usize,
    converged: bool,
    workspace: Workspace,
}

impl GlobalAdjustment {
    /// Takes the map as it is.
    pub(crate) fn new(map: &VslamMap) -> Self {
        let selection = Selection::all(map);
        let (problem, views) = selection.problem(map);
        Self {
            selection,
            views,
            before: problem.clone(),
            problem,
            damping: BundleSettings::default().damping,
            step_count: 0,
            converged: false,
            workspace: Workspace::default(),
        }
    }

    /// How many observations there are.
    pub(super) fn observation_count(&self) -> usize {
        self.problem.observations.len()
    }

    /// Goes on for some steps at most; the map stays as it is.
    ///
    /// Cost per step: measured 40 ms for 550 keyframes with 120,000 observations.
    pub(super) fn advance(&mut self, step_count: usize) {
        let left = STEPS_MAX - self.step_count;
        if self.converged || left == 0 {
            return;
        }
        let settings = self.settings(step_count.min(left));
        let report = adjust(&mut self.problem, &settings, &mut self.workspace);
        self.step_count += report.iteration_count.max(1);
        self.damping = report.damping;
        self.converged = report.converged;
    }

    /// Takes the steps that are left, and moves the map as they say.
    pub(super) fn finish(mut self, map: &mut VslamMap) {
        self.advance(STEPS_MAX);
        let settings = BundleSettings {
            point_covariances: true,
            ..self.settings(0)
        };
        let report = adjust(&mut self.problem, &settings, &mut self.workspace);
        self.apply(map, &report);
    }

    fn settings(&self, iteration_count_max: usize) -> BundleSettings {
        BundleSettings {
            iteration_count_max,
            cost_decrease_min: COST_DECREASE_MIN,
            point_covariances: false,
            damping: self.damping,
            ..BundleSettings::default()
        }
    }

    fn apply(&self, map: &mut VslamMap, report: &BundleReport) {
        let moves = self.moves(map);
        let positions = self.positions(map, &moves);
        map.correct(&moves);
        for (id, position) in positions {
            if let Some(point) = map.point_mut(id) {
                point.position_in_map = position;
            }
        }
        for ((point, keyframe), inlier) in self.views.iter().zip(&report.inliers) {
            if !inlier {
                map.unlink(*point, *keyframe);
            }
        }
        for (id, covariance) in self.selection.points.iter().zip(&report.point_covariances) {
            renew_point(map, *id, covariance.as_ref());
        }
    }

    /// How keyframes move; those that are newer move with their parent.
    fn moves(&self, map: &VslamMap) -> Moves {
        let stretches = stretches(&self.before, &self.problem, |_| true);
        let poses = self.before.poses.iter().zip(&self.problem.poses);
        let solved = poses.zip(stretches).map(|((before, after), stretch)| {
            let after = after.camera_from_map.inverse();
            let after = Similarity::new(stretch, *after.rotation(), *after.translation());
            after * Similarity::from(before.camera_from_map)
        });
        let solved: BTreeMap<KeyframeId, Similarity<Map, Map>> = self
            .selection
            .keyframes
            .iter()
            .copied()
            .zip(solved)
            .collect();
        let mut moves = Moves::new();
        let mut last = Similarity::identity();
        for keyframe in map.keyframes() {
            let parent = keyframe.parent.and_then(|parent| map.holder(parent));
            let inherited = parent.and_then(|parent| moves.get(&parent).copied());
            let own = solved.get(&keyframe.id).copied().or(inherited);
            last = own.unwrap_or(last);
            moves.insert(keyframe.id, last);
        }
        moves
    }

    /// Where points belong: where they were solved to be, and what they moved since the start.
    fn positions(&self, map: &VslamMap, moves: &Moves) -> Vec<(PointId, Vector3<f64>)> {
        let solved = self.before.points.iter().zip(&self.problem.points);
        let points = self.selection.points.iter().zip(solved);
        points
            .filter_map(|(id, (before, after))| {
                let point = map.point(*id)?;
                let view = point.views.first()?;
                let moved = moves.get(&view.keyframe)?.linear_matrix();
                Some((*id, after + moved * (point.position_in_map - before)))
            })
            .collect()
    }
}

//! Memory of the optimiser, kept between calls so that steps allocate nothing.

use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};

use super::BundleProblem;
use crate::block_cholesky::BlockEnvelope;

/// Buffers for [`super::adjust`]. Reuse one for many problems: it grows to the largest.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    /// Observations grouped by point, and within a point by free pose; fixed poses come last.
    pub(super) sorted: Vec<SortedObservation>,
    /// Where each point's observations begin in `sorted`, and the end.
    pub(super) starts: Vec<usize>,
    /// For each pose its row in the reduced system, if it is free.
    pub(super) rows: Vec<Option<usize>>,

    /// The estimate: the current one, and the one that a step leads to.
    pub(super) current: Estimate,
    pub(super) moved: Estimate,

    pub(super) pose_blocks: Vec<PoseBlock>,
    pub(super) point_blocks: Vec<PointBlock>,
    /// `Jposeᵀ w Jpoint` of each sorted observation, zero where the pose is fixed.
    pub(super) couplings: Vec<Matrix6x3<f64>>,
    /// `couplings` times the inverse transposed factor of the point's damped block.
    pub(super) whitened: Vec<Matrix6x3<f64>>,
    pub(super) reduced: BlockEnvelope<6>,
    pub(super) pose_steps: Vec<Vector6<f64>>,
    pub(super) point_steps: Vec<Vector3<f64>>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct SortedObservation {
    /// Where it is in the problem.
    pub idx: usize,
    /// The row of its pose in the reduced system.
    pub row: Option<usize>,
    /// Whether it takes part.
    pub used: bool,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Estimate {
    pub poses: Vec<Transform<Camera, Map>>,
    /// The same poses as matrices, because they are applied to many points.
    pub matrices: Vec<(Matrix3<f64>, Vector3<f64>)>,
    pub points: Vec<Vector3<f64>>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PoseBlock {
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PointBlock {
    pub hessian: Matrix3<f64>,
    pub gradient: Vector3<f64>,
    /// The inverse of the lower Cholesky factor of the damped block, if it has one.
    pub factor_inverse: Option<Matrix3<f64>>,
}

impl Workspace {
    /// Sorts the problem and makes room for it.
    pub(super) fn prepare(&mut self, problem: &BundleProblem) {
        self.number_poses(problem);
        self.sort_observations(problem);
        self.leave_out_lonely_points();
        self.current.load(problem);
        self.moved.load(problem);
        let free_count = self.rows.iter().flatten().count();
        self.pose_blocks.clear();
        self.pose_blocks.resize(free_count, PoseBlock::default());
        self.point_blocks.clear();
        self.point_blocks
            .resize(problem.points.len(), PointBlock::default());
        self.couplings.clear();
        self.couplings.resize(self.sorted.len(), Matrix6x3::zeros());
        self.whitened.clear();
        self.whitened.resize(self.sorted.len(), Matrix6x3::zeros());
        self.pose_steps.clear();
        self.pose_steps.resize(free_count, Vector6::zeros());
        self.point_steps.clear();
        self.point_steps
            .resize(problem.points.len(), Vector3::zeros());
        self.shape_reduced_system(free_count);
    }

    fn number_poses(&mut self, problem: &BundleProblem) {
        self.rows.clear();
        let mut row = 0;
        for pose in &problem.poses {
            self.rows.push((!pose.fixed).then_some(row));
            row += usize::from(!pose.fixed);
        }
    }

    fn sort_observations(&mut self, problem: &BundleProblem) {
        let rows = &self.rows;
        self.sorted.clear();
        self.sorted.extend(
            problem
                .observations
                .iter()
                .enumerate()
                .map(|(idx, observation)| {
                    let point = &problem.points[observation.point_idx];
                    let point_valid = point.iter().all(|coordinate| coordinate.is_finite());
                    SortedObservation {
                        idx,
                        row: rows[observation.pose_idx],
                        used: point_valid && observation.is_usable(),
                    }
                }),
        );
        let key = |observation: &SortedObservation| {
            let row = observation.row.unwrap_or(usize::MAX);
            (
                problem.observations[observation.idx].point_idx,
                row,
                observation.idx,
            )
        };
        self.sorted.sort_unstable_by_key(key);
        self.starts.clear();
        self.starts.resize(problem.points.len() + 1, 0);
        for observation in &problem.observations {
            self.starts[observation.point_idx + 1] += 1;
        }
        for point_idx in 0..problem.points.len() {
            self.starts[point_idx + 1] += self.starts[point_idx];
        }
    }

    /// One observation does not hold a point.
    pub(super) fn leave_out_lonely_points(&mut self) {
        for range in self.starts.windows(2) {
            let observations = &mut self.sorted[range[0]..range[1]];
            if observations.iter().filter(|o| o.used).count() < 2 {
                observations.iter_mut().for_each(|o| o.used = false);
            }
        }
    }

    /// Two poses are coupled if they see a point together; each row begins at the first pose
    /// with which it is coupled.
    fn shape_reduced_system(&mut self, free_count: usize) {
        let mut first_columns: Vec<usize> = (0..free_count).collect();
        for range in self.starts.windows(2) {
            let mut first_row = None;
            for observation in self.sorted[range[0]..range[1]].iter().filter(|o| o.used) {
                let Some(row) = observation.row else { break };
                let first = *first_row.get_or_insert(row);
                first_columns[row] = first_columns[row].min(first);
            }
        }
        self.reduced.reshape(first_columns.into_iter());
    }
}

impl Estimate {
    fn load(&mut self, problem: &BundleProblem) {
        self.poses.clear();
        self.poses
            .extend(problem.poses.iter().map(|pose| pose.camera_from_map));
        self.points.clone_from(&problem.points);
        self.matrices.clear();
        self.matrices.extend(
            self.poses
                .iter()
                .map(|pose| (pose.rotation_matrix(), *pose.translation())),
        );
    }

    pub(super) fn set_pose(&mut self, pose_idx: usize, pose: Transform<Camera, Map>) {
        self.poses[pose_idx] = pose;
        self.matrices[pose_idx] = (pose.rotation_matrix(), *pose.translation());
    }
}

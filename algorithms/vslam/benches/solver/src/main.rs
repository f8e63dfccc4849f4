//! Our bundle adjustment beside a general solver's on the same problem, in one run.
//!
//! Both start from the same poses and points, hold the same two poses, use Huber's kernel at the
//! same threshold, and stop when a step lowers the cost by less than a millionth.

#[path = "../../bundle/problem.rs"]
mod problem;

use std::error::Error;
use std::time::{Duration, Instant};

use apex_solver::JacobianMode;
use apex_solver::apex_camera_models::PinholeCamera;
use apex_solver::apex_manifolds::ManifoldType;
use apex_solver::core::VarKey;
use apex_solver::core::loss_functions::HuberLoss;
use apex_solver::core::problem::Problem;
use apex_solver::factors::BundleAdjustment;
use apex_solver::factors::visual::ProjectionFactor;
use apex_solver::linalg::{ExplicitSchurVariant, LinearSolverType};
use apex_solver::optimizer::levenberg_marquardt::{LevenbergMarquardt, LevenbergMarquardtConfig};
use geometry::Transform;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use peer_nalgebra::{DVector, Matrix2xX, Vector2};
use vslam::bundle::{BundlePose, BundleProblem, BundleSettings, Workspace, adjust};

use problem::{OBSERVATION_COUNT, SIGMA, problem};

const RUN_COUNT: usize = 15;
const STEPS_MAX: usize = 50;
const COST_DECREASE_MIN: f64 = 1e-6;

struct Outcome {
    /// Median over the runs.
    duration: Duration,
    step_count: usize,
    problem: BundleProblem,
}

fn main() -> Result<(), Box<dyn Error>> {
    let start = problem();
    let ours = ours(&start);
    println!(
        "{} observations, {RUN_COUNT} runs each, median",
        OBSERVATION_COUNT
    );
    print("vslam::bundle", &ours, &ours);
    let sparse = LinearSolverType::ExplicitSparseSchur;
    for (name, linear) in [
        ("apex-solver, explicit Schur", sparse),
        (
            "apex-solver, implicit Schur",
            LinearSolverType::ImplicitSparseSchur,
        ),
    ] {
        print(name, &general(&start, linear)?, &ours);
    }
    Ok(())
}

fn print(name: &str, outcome: &Outcome, ours: &Outcome) {
    let milliseconds = outcome.duration.as_secs_f64() * 1e3;
    println!(
        "{name}: {milliseconds:.1} ms, {} steps, residual {:.4} sigma, {:.2} times ours",
        outcome.step_count,
        residual(&outcome.problem),
        outcome.duration.as_secs_f64() / ours.duration.as_secs_f64()
    );
}

/// Root mean square of the whitened residuals.
fn residual(problem: &BundleProblem) -> f64 {
    let squares = problem.observations.iter().map(|observation| {
        let pose = &problem.poses[observation.pose_idx].camera_from_map;
        let in_camera = *pose * problem.points[observation.point_idx];
        let residual = in_camera.xy() / in_camera.z - observation.position;
        residual.norm_squared() / (2.0 * SIGMA * SIGMA)
    });
    (squares.sum::<f64>() / problem.observations.len() as f64).sqrt()
}

fn median(mut durations: Vec<Duration>) -> Duration {
    durations.sort_unstable();
    durations[durations.len() / 2]
}

fn ours(start: &BundleProblem) -> Outcome {
    let settings = BundleSettings {
        iteration_count_max: STEPS_MAX,
        cost_decrease_min: COST_DECREASE_MIN,
        point_covariances: false,
        ..BundleSettings::default()
    };
    let mut workspace = Workspace::default();
    let mut durations = Vec::new();
    let mut solved = start.clone();
    let mut step_count = 0;
    for _ in 0..RUN_COUNT {
        solved = start.clone();
        let began = Instant::now();
        step_count = adjust(&mut solved, &settings, &mut workspace).iteration_count;
        durations.push(began.elapsed());
    }
    Outcome {
        duration: median(durations),
        step_count,
        problem: solved,
    }
}

/// Building the problem is left out of the time, as if it could be kept from window to window.
fn general(start: &BundleProblem, linear: LinearSolverType) -> Result<Outcome, Box<dyn Error>> {
    let mut durations = Vec::new();
    let mut last = None;
    for _ in 0..RUN_COUNT {
        let (mut problem, (pose_keys, point_keys)) = build(start)?;
        let config = LevenbergMarquardtConfig::for_bundle_adjustment()
            .with_linear_solver_type(linear)
            .with_schur_variant(ExplicitSchurVariant::Sparse)
            .with_max_iterations(STEPS_MAX)
            .with_cost_tolerance(COST_DECREASE_MIN)
            .with_damping(BundleSettings::default().damping);
        let mut solver = LevenbergMarquardt::with_config(config);
        let began = Instant::now();
        let result = solver.optimize(&mut problem)?;
        durations.push(began.elapsed());
        let mut solved = start.clone();
        for (pose, key) in solved.poses.iter_mut().zip(&pose_keys) {
            read_pose(pose, result.parameters[*key].as_param_slice());
        }
        for (point, key) in solved.points.iter_mut().zip(&point_keys) {
            point.copy_from_slice(result.parameters[*key].as_param_slice());
        }
        last = Some((result.iterations, solved));
    }
    let (step_count, problem) = last.ok_or("no run")?;
    Ok(Outcome {
        duration: median(durations),
        step_count,
        problem,
    })
}

type Keys = (Vec<VarKey>, Vec<VarKey>);

fn build(start: &BundleProblem) -> Result<(Problem, Keys), Box<dyn Error>> {
    let mut problem = Problem::new(JacobianMode::Sparse);
    let mut pose_keys = Vec::new();
    for pose in &start.poses {
        let parameters = DVector::from_column_slice(&pose_parameters(pose));
        let key = problem.add_variable(ManifoldType::SE3, parameters);
        for dof in 0..6 {
            if pose.fixed {
                problem.fix_variable(key, dof);
            }
        }
        pose_keys.push(key);
    }
    let mut point_keys = Vec::new();
    for point in &start.points {
        let parameters = DVector::from_column_slice(point.as_slice());
        let key = problem.add_variable(ManifoldType::RN, parameters);
        problem.mark_for_elimination(key);
        point_keys.push(key);
    }
    // In units of sigma, as Huber's threshold is.
    let camera = PinholeCamera::from([1.0 / SIGMA, 1.0 / SIGMA, 0.0, 0.0]);
    let threshold = BundleSettings::default().chi_squared_max.sqrt();
    for observation in &start.observations {
        let seen = Matrix2xX::from_columns(&[Vector2::new(
            observation.position.x / SIGMA,
            observation.position.y / SIGMA,
        )]);
        let factor: ProjectionFactor<PinholeCamera, BundleAdjustment> =
            ProjectionFactor::new(seen, camera.clone());
        let keys = [
            pose_keys[observation.pose_idx],
            point_keys[observation.point_idx],
        ];
        let kernel = Box::new(HuberLoss::new(threshold)?);
        problem.add_residual_block(&keys, Box::new(factor), Some(kernel));
    }
    Ok((problem, (pose_keys, point_keys)))
}

/// Translation, then the quaternion with its real part first.
fn pose_parameters(pose: &BundlePose) -> [f64; 7] {
    let translation = pose.camera_from_map.translation();
    let rotation = pose.camera_from_map.rotation();
    [
        translation.x,
        translation.y,
        translation.z,
        rotation.w,
        rotation.i,
        rotation.j,
        rotation.k,
    ]
}

fn read_pose(pose: &mut BundlePose, parameters: &[f64]) {
    let [x, y, z, real, i, j, k] = *parameters else {
        return;
    };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(real, i, j, k));
    pose.camera_from_map = Transform::new(rotation, Vector3::new(x, y, z));
}

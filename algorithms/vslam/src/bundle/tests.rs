//! Synthetic cameras along a walk: derivatives, consistency, calibration, outliers, bad input.

use geometry::{Camera, Map, RobustKernel, Transform, so3};
use nalgebra::{Vector2, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::linearise::{cost, linearise};
use super::*;

const SIGMA: f64 = 1.0 / 480.0;

fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

fn uniform(rng: &mut ChaCha8Rng, limit: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-limit..=limit))
}

fn step(rng: &mut ChaCha8Rng, limit: f64) -> Vector6<f64> {
    Vector6::from_fn(|_, _| rng.random_range(-limit..=limit))
}

struct Walk {
    truth: BundleProblem,
    problem: BundleProblem,
    rng: ChaCha8Rng,
}

/// Poses 0.3 apart that look at points 3 to 6 away; every point is seen by most poses. The first
/// two are fixed at the truth, the others and the points start off by up to `error`.
fn walk(seed: u64, pose_count: usize, point_count: usize, error: f64) -> Walk {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut truth = BundleProblem::default();
    for i in 0..pose_count {
        let turn = uniform(&mut rng, 0.1);
        let place = Vector3::x() * (0.3 * i as f64) + uniform(&mut rng, 0.1);
        let map_from_camera: Transform<Map, Camera> = Transform::new(so3::exp(&turn), place);
        truth.poses.push(BundlePose {
            camera_from_map: map_from_camera.inverse(),
            fixed: i < 2,
        });
    }
    for _ in 0..point_count {
        let wide = uniform(&mut rng, 1.0);
        truth.points.push(Vector3::new(
            1.0 + 2.5 * wide.x,
            1.5 * wide.y,
            4.5 + 1.5 * wide.z,
        ));
    }
    for pose_idx in 0..pose_count {
        for point_idx in 0..point_count {
            let in_camera = truth.poses[pose_idx].camera_from_map * truth.points[point_idx];
            if rng.random_bool(0.2) {
                continue;
            }
            let noise = Vector2::from_fn(|_, _| gaussian(&mut rng) * SIGMA);
            truth.observations.push(BundleObservation {
                pose_idx,
                point_idx,
                position: in_camera.xy() / in_camera.z + noise,
                sigma: SIGMA,
            });
        }
    }
    let mut problem = truth.clone();
    for pose in problem.poses.iter_mut().filter(|pose| !pose.fixed) {
        let error = Transform::<Camera, Camera>::exp(&step(&mut rng, error));
        pose.camera_from_map = error * pose.camera_from_map;
    }
    for point in &mut problem.points {
        *point += uniform(&mut rng, 3.0 * error);
    }
    Walk {
        truth,
        problem,
        rng,
    }
}

fn thorough() -> BundleSettings {
    BundleSettings {
        iteration_count_max: 50,
        cost_decrease_min: 1e-9,
        pose_covariances: true,
        ..BundleSettings::default()
    }
}

#[test]
fn gradient_matches_differences_of_the_cost() {
    let Walk { problem, .. } = walk(1, 4, 8, 0.02);
    let kernel = RobustKernel::Huber { threshold: 2.0 };
    let mut workspace = Workspace::default();
    workspace.prepare(&problem);
    linearise(&problem, &mut workspace, kernel);
    let cost_of = |problem: &BundleProblem| {
        let mut workspace = Workspace::default();
        workspace.prepare(problem);
        cost(problem, &workspace.sorted, &workspace.current, kernel)
    };
    let width = 1e-6;
    let check = |expected: f64, high: &BundleProblem, low: &BundleProblem| {
        // The gradient is that of half the cost.
        let numeric = (cost_of(high) - cost_of(low)) / (4.0 * width);
        let tolerance = 1e-4 * (1.0 + expected.abs());
        assert!(
            (numeric - expected).abs() < tolerance,
            "{numeric} {expected}"
        );
    };
    for axis in 0..6 {
        let moved = |width: f64| {
            let mut moved = problem.clone();
            let mut delta = Vector6::zeros();
            delta[axis] = width;
            let pose = &mut moved.poses[3].camera_from_map;
            *pose = pose.inverse().perturbed(&delta).inverse();
            moved
        };
        check(
            workspace.pose_blocks[1].gradient[axis],
            &moved(width),
            &moved(-width),
        );
    }
    for axis in 0..3 {
        let moved = |width: f64| {
            let mut moved = problem.clone();
            moved.points[5][axis] += width;
            moved
        };
        check(
            workspace.point_blocks[5].gradient[axis],
            &moved(width),
            &moved(-width),
        );
    }
}

#[test]
fn residuals_and_covariances_are_what_the_noise_makes_them() {
    // 24 runs × 4 free poses: the mean of eᵀP⁻¹e / 6 is 1 ± 0.06, and neighbours are correlated.
    let (mut pose_nees, mut pose_count) = (0.0, 0.0);
    for seed in 0..24 {
        let Walk {
            truth, mut problem, ..
        } = walk(seed, 6, 60, 0.02);
        let report = adjust(&mut problem, &thorough(), &mut Workspace::default());
        assert!(report.converged && report.cost_after < report.cost_before);
        let factor = report.variance_factor.unwrap();
        // 576 residuals less 204 unknowns: one standard deviation is 0.07.
        assert!((0.75..1.25).contains(&factor), "seed {seed}: {factor}");
        let poses = truth
            .poses
            .iter()
            .zip(&problem.poses)
            .zip(&report.pose_covariances);
        for ((truth, found), covariance) in poses {
            assert_eq!(found.fixed, covariance.is_none());
            let Some(covariance) = covariance else {
                assert_eq!(found, truth);
                continue;
            };
            let error = (truth.camera_from_map * found.camera_from_map.inverse()).log();
            pose_nees += error.dot(&covariance.cholesky().unwrap().solve(&error)) / 6.0;
            pose_count += 1.0;
        }
    }
    let pose_nees_mean = pose_nees / pose_count;
    assert!((0.75..1.3).contains(&pose_nees_mean), "{pose_nees_mean}");
}

#[test]
fn point_covariances_are_calibrated_given_the_poses() {
    let (mut nees, mut count) = (0.0, 0.0);
    for seed in 0..5 {
        let Walk {
            truth, mut problem, ..
        } = walk(seed, 5, 60, 0.02);
        for (pose, truth) in problem.poses.iter_mut().zip(&truth.poses) {
            *pose = BundlePose {
                fixed: true,
                ..*truth
            };
        }
        let report = adjust(&mut problem, &thorough(), &mut Workspace::default());
        for (idx, covariance) in report.point_covariances.iter().enumerate() {
            let Some(covariance) = covariance else {
                continue;
            };
            let error = problem.points[idx] - truth.points[idx];
            nees += error.dot(&covariance.cholesky().unwrap().solve(&error)) / 3.0;
            count += 1.0;
        }
    }
    // 300 points: one standard deviation is 0.05; dropped outliers and curvature add a little.
    assert!((0.85..1.2).contains(&(nees / count)), "{}", nees / count);
}

#[test]
fn outliers_are_flagged_and_do_not_bend_the_poses() {
    let Walk {
        truth,
        mut problem,
        mut rng,
    } = walk(3, 6, 100, 0.02);
    let mut outlier_count = 0;
    let mut outliers = vec![false; problem.observations.len()];
    for (observation, outlier) in problem.observations.iter_mut().zip(&mut outliers) {
        *outlier = rng.random_bool(0.05);
        if *outlier {
            outlier_count += 1;
            observation.position += uniform(&mut rng, 0.3).xy();
        }
    }
    let settings = BundleSettings {
        refit_iteration_count_max: 20,
        ..thorough()
    };
    let report = adjust(&mut problem, &settings, &mut Workspace::default());
    let both = |wanted: bool| {
        let pairs = report.inliers.iter().zip(&outliers);
        pairs
            .filter(|(inlier, outlier)| **inlier == wanted && **outlier)
            .count()
    };
    assert!(
        both(false) * 10 >= outlier_count * 9,
        "{} of {outlier_count}",
        both(false)
    );
    assert!(report.inlier_count * 100 >= problem.observations.len() * 85);
    for (found, truth) in problem.poses.iter().zip(&truth.poses) {
        let error = (truth.camera_from_map * found.camera_from_map.inverse()).log();
        assert!(error.norm() < 0.05, "{error}");
    }
}

#[test]
fn a_workspace_used_before_gives_the_same_result() {
    let solve = |workspace: &mut Workspace| {
        let mut problem = walk(5, 5, 40, 0.02).problem;
        let report = adjust(&mut problem, &thorough(), workspace);
        (problem, report)
    };
    let mut used = Workspace::default();
    adjust(&mut walk(6, 9, 80, 0.01).problem, &thorough(), &mut used);
    assert_eq!(solve(&mut used), solve(&mut Workspace::default()));
}

#[test]
fn a_point_seen_twice_by_one_pose_is_counted_twice() {
    let Walk { mut problem, .. } = walk(7, 4, 30, 0.02);
    let mut halved = problem.clone();
    problem.observations.extend(problem.observations.clone());
    for observation in &mut halved.observations {
        observation.sigma /= 2.0_f64.sqrt();
    }
    // Without outliers the kernel does not tell the two apart.
    let settings = BundleSettings {
        chi_squared_max: 1e3,
        ..thorough()
    };
    adjust(&mut problem, &settings, &mut Workspace::default());
    adjust(&mut halved, &settings, &mut Workspace::default());
    for (twice, once) in problem.poses.iter().zip(&halved.poses) {
        let difference = (twice.camera_from_map * once.camera_from_map.inverse()).log();
        assert!(difference.norm() < 1e-7, "{difference}");
    }
}

#[test]
fn with_one_fixed_pose_the_scale_stays_near_its_start() {
    let Walk {
        truth, mut problem, ..
    } = walk(8, 5, 60, 0.01);
    problem.poses[1].fixed = false;
    let report = adjust(&mut problem, &thorough(), &mut Workspace::default());
    assert!((0.75..1.25).contains(&report.variance_factor.unwrap()));
    let centre = |problem: &BundleProblem| {
        *problem.poses[4].camera_from_map.inverse().translation()
            - problem.poses[0].camera_from_map.inverse().translation()
    };
    let scale = centre(&problem).norm() / centre(&truth).norm();
    assert!((0.9..1.1).contains(&scale), "{scale}");
}

#[test]
fn bad_observations_are_outliers_and_lonely_points_stay() {
    let Walk { mut problem, .. } = walk(9, 4, 30, 0.01);
    problem
        .observations
        .retain(|o| o.point_idx != 3 || o.pose_idx == 2);
    problem.observations[0].position.x = f64::NAN;
    problem.observations[1].sigma = 0.0;
    problem.observations[2].sigma = f64::INFINITY;
    problem.points[7].z = f64::NAN;
    let lonely = problem.points[3];
    let report = adjust(&mut problem, &thorough(), &mut Workspace::default());
    assert_eq!(problem.points[3], lonely);
    assert!(report.inliers[..3].iter().all(|inlier| !inlier));
    assert!(report.cost_after.is_finite() && report.converged);
    let seven = problem.observations.iter().zip(&report.inliers);
    assert!(
        seven
            .filter(|(o, _)| o.point_idx == 7)
            .all(|(_, inlier)| !inlier)
    );
    let poses_finite = problem.poses.iter().all(|pose| {
        pose.camera_from_map
            .translation()
            .iter()
            .all(|c| c.is_finite())
    });
    assert!(poses_finite);
    assert!(report.point_covariances[3].is_none() && report.point_covariances[7].is_none());
}

#[test]
fn an_empty_problem_is_no_problem() {
    let mut empty = BundleProblem::default();
    let report = adjust(&mut empty, &thorough(), &mut Workspace::default());
    assert_eq!(report.inlier_count, 0);
    let Walk { mut problem, .. } = walk(1, 3, 5, 0.01);
    problem.observations.clear();
    let before = problem.clone();
    adjust(&mut problem, &thorough(), &mut Workspace::default());
    assert_eq!(problem, before);
}

#[test]
fn a_point_that_starts_behind_a_camera_does_no_harm() {
    let Walk {
        truth, mut problem, ..
    } = walk(10, 5, 60, 0.01);
    problem.points[0].z = -3.0;
    adjust(&mut problem, &thorough(), &mut Workspace::default());
    for (found, truth) in problem.poses.iter().zip(&truth.poses) {
        let error = (truth.camera_from_map * found.camera_from_map.inverse()).log();
        assert!(error.norm() < 0.05, "{error}");
    }
}

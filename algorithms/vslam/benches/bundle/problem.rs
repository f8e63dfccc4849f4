//! The window of a tracker, as the benches of bundle adjustment solve it.

use geometry::{Camera, Map, Transform, so3};
use nalgebra::{Vector2, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vslam::bundle::{BundleObservation, BundlePose, BundleProblem};

const POSE_COUNT: usize = 10;
const POINT_COUNT: usize = 1500;
/// How many observations there are.
pub const OBSERVATION_COUNT: usize = 11_000;
/// One pixel, on the ideal plane.
pub const SIGMA: f64 = 1.0 / 480.0;

fn uniform(rng: &mut ChaCha8Rng, limit: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-limit..limit))
}

/// The sum of twelve uniform numbers is close enough to normal.
fn noise(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * SIGMA
}

/// A walk of two metres along a wall, as a window looks after tracking: poses off by
/// centimetres, points by some percent of their distance. The first two poses are fixed.
pub fn problem() -> BundleProblem {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let truth: Vec<Transform<Map, Camera>> = (0..POSE_COUNT)
        .map(|i| {
            let turn = uniform(&mut rng, 0.1);
            let place = Vector3::new(0.2 * i as f64, 0.0, 0.0) + uniform(&mut rng, 0.05);
            Transform::new(so3::exp(&turn), place)
        })
        .collect();
    let mut problem = BundleProblem::default();
    for (i, map_from_camera) in truth.iter().enumerate() {
        let fixed = i < 2;
        let (turn, shift) = (uniform(&mut rng, 0.02), uniform(&mut rng, 0.02));
        let error = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        let moved = if fixed {
            *map_from_camera
        } else {
            map_from_camera.perturbed(&error)
        };
        problem.poses.push(BundlePose {
            camera_from_map: moved.inverse(),
            fixed,
        });
    }
    let mut points = Vec::new();
    for _ in 0..POINT_COUNT {
        let wide = uniform(&mut rng, 1.0);
        points.push(Vector3::new(
            1.0 + 2.0 * wide.x,
            1.3 * wide.y,
            4.5 + 1.5 * wide.z,
        ));
    }
    let mut chosen = 0;
    for k in 0..POSE_COUNT * POINT_COUNT {
        // Spreads the observations evenly over the pairs of pose and point.
        let due = (k + 1) * OBSERVATION_COUNT / (POSE_COUNT * POINT_COUNT);
        if due == chosen {
            continue;
        }
        chosen = due;
        let (point_idx, pose_idx) = (k / POSE_COUNT, k % POSE_COUNT);
        let in_camera = truth[pose_idx].inverse() * points[point_idx];
        let position = in_camera.xy() / in_camera.z;
        let position = Vector2::new(position.x + noise(&mut rng), position.y + noise(&mut rng));
        problem.observations.push(BundleObservation {
            pose_idx,
            point_idx,
            position,
            sigma: SIGMA,
        });
    }
    problem.points = points
        .iter()
        .map(|point| point + uniform(&mut rng, 0.1))
        .collect();
    problem
}

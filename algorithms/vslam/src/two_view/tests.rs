//! Two synthetic cameras: general scenes, planes, rotations, outliers, many seeds.

use geometry::{Camera, Transform, so3};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::five_point::essential_matrices;
use super::*;

const SIGMA: f64 = 1.0 / 480.0;

fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

fn uniform(rng: &mut ChaCha8Rng, limits: [f64; 3]) -> Vector3<f64> {
    Vector3::from(limits.map(|limit| rng.random_range(-limit..=limit)))
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    /// Depths between 2 and 8.
    General,
    /// One plane, tilted by up to 45°.
    Plane,
}

struct Scene {
    second_from_first: Transform<Camera, Camera>,
    correspondences: Vec<Correspondence>,
    rng: ChaCha8Rng,
}

impl Scene {
    /// `baseline` in a random, mostly sideways direction, between views 15° apart at most.
    fn new(seed: u64, shape: Shape, baseline: f64, outlier_share: f64, noise: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let rotation = so3::exp(&uniform(&mut rng, [0.1, 0.15, 0.15]));
        let direction = loop {
            let direction = uniform(&mut rng, [1.0, 0.6, 0.6]);
            if direction.norm() > 0.3 {
                break direction.normalize();
            }
        };
        let second_from_first = Transform::new(rotation, direction * baseline);
        let tilt = uniform(&mut rng, [0.7, 0.7, 0.0]);
        let normal = (Vector3::z() + tilt).normalize();
        let mut correspondences = Vec::new();
        while correspondences.len() < 200 {
            let ray = uniform(&mut rng, [0.66, 0.45, 1.0]).xy().push(1.0);
            let depth = match shape {
                Shape::General => rng.random_range(2.0..8.0),
                Shape::Plane => 4.0 * normal.z / normal.dot(&ray),
            };
            let in_second = second_from_first * (ray * depth);
            let second = in_second.xy() / in_second.z;
            let visible = (1.0..20.0).contains(&depth)
                && in_second.z > 0.5
                && second.x.abs() < 0.7
                && second.y.abs() < 0.5;
            if !visible {
                continue;
            }
            let outlier = rng.random_bool(outlier_share);
            let mut noisy =
                |position: Vector2<f64>| position.map(|c| c + gaussian(&mut rng) * noise);
            let first = noisy(ray.xy());
            let second = noisy(second);
            correspondences.push(Correspondence {
                first,
                second: if outlier {
                    uniform(&mut rng, [0.66, 0.45, 1.0]).xy()
                } else {
                    second
                },
            });
        }
        Self {
            second_from_first,
            correspondences,
            rng,
        }
    }

    fn reconstruct(&mut self) -> Result<TwoView, TwoViewRefusal> {
        let settings = TwoViewSettings {
            sigma: SIGMA,
            ..TwoViewSettings::default()
        };
        reconstruct(&self.correspondences, &settings, &mut self.rng)
    }

    /// Errors of rotation and direction of translation [degrees].
    fn errors_degrees(&self, found: &TwoView) -> (f64, f64) {
        let truth = &self.second_from_first;
        let rotation = found
            .second_from_first
            .rotation()
            .angle_to(truth.rotation());
        let direction = found
            .second_from_first
            .translation()
            .angle(truth.translation());
        (rotation.to_degrees(), direction.to_degrees())
    }
}

/// Counts of right, refused and wrong starts.
#[derive(Debug, Default)]
struct Tally {
    right: usize,
    refused: usize,
    wrong: usize,
    refusals: Vec<TwoViewRefusal>,
}

fn tally(shape: Shape, outlier_share: f64, seed_count: u64) -> Tally {
    let mut tally = Tally::default();
    for seed in 0..seed_count {
        let mut scene = Scene::new(seed, shape, 0.5, outlier_share, SIGMA);
        match scene.reconstruct() {
            Err(refusal) => {
                tally.refused += 1;
                tally.refusals.push(refusal);
            }
            Ok(found) => {
                let (rotation, direction) = scene.errors_degrees(&found);
                let right = rotation < 1.5 && direction < 10.0;
                tally.right += usize::from(right);
                tally.wrong += usize::from(!right);
            }
        }
    }
    tally
}

#[test]
fn five_points_give_the_true_essential_matrix() {
    let mut found_count = 0;
    let mut solutions = Vec::new();
    for seed in 0..500 {
        let scene = Scene::new(seed, Shape::General, 0.5, 0.0, 0.0);
        let first = std::array::from_fn(|i| scene.correspondences[i].first.push(1.0));
        let second = std::array::from_fn(|i| scene.correspondences[i].second.push(1.0));
        solutions.clear();
        essential_matrices(&first, &second, &mut solutions);
        for essential in &solutions {
            let worst = (0..5)
                .map(|i: usize| second[i].dot(&(essential * first[i])).abs())
                .fold(0.0, f64::max);
            assert!(worst < 1e-9, "seed {seed}: {worst}");
            // A few samples are nearly degenerate and lose digits.
            assert!(essential.determinant().abs() < 1e-4, "seed {seed}");
        }
        let truth = essential::Essential::of_pose(&scene.second_from_first)
            .0
            .normalize();
        let distance = |e: &Matrix3<f64>| (e - truth).norm().min((e + truth).norm());
        found_count += usize::from(solutions.iter().any(|e| distance(e) < 1e-5));
    }
    assert!(found_count >= 495, "{found_count} of 500");
}

#[test]
fn general_scenes_are_reconstructed_among_outliers() {
    for outlier_share in [0.0, 0.2, 0.5] {
        let tally = tally(Shape::General, outlier_share, 40);
        assert!(
            tally.right >= 38 && tally.wrong == 0,
            "{outlier_share}: {tally:?}"
        );
    }
}

#[test]
fn planes_are_reconstructed_or_refused_as_ambiguous() {
    for outlier_share in [0.0, 0.4] {
        let tally = tally(Shape::Plane, outlier_share, 40);
        assert!(
            tally.right >= 15 && tally.wrong == 0,
            "{outlier_share}: {tally:?}"
        );
    }
}

#[test]
fn pure_rotation_is_refused() {
    for seed in 0..40 {
        let outlier_share = if seed % 2 == 0 { 0.0 } else { 0.4 };
        let mut scene = Scene::new(seed, Shape::General, 0.0, outlier_share, SIGMA);
        let refusal = scene.reconstruct().unwrap_err();
        assert_eq!(refusal, TwoViewRefusal::PureRotation, "seed {seed}");
    }
}

#[test]
fn a_short_baseline_is_refused() {
    for seed in 0..40 {
        let mut scene = Scene::new(seed, Shape::General, 0.03, 0.2, SIGMA);
        let refusal = scene.reconstruct().unwrap_err();
        let named = matches!(
            refusal,
            TwoViewRefusal::PureRotation | TwoViewRefusal::LowParallax { .. }
        );
        assert!(named, "seed {seed}: {refusal:?}");
    }
}

#[test]
fn nonsense_is_refused() {
    let mut scene = Scene::new(1, Shape::General, 0.5, 1.0, SIGMA);
    let refusal = scene.reconstruct().unwrap_err();
    assert!(
        matches!(refusal, TwoViewRefusal::TooFewInliers { .. }),
        "{refusal:?}"
    );
    scene.correspondences.truncate(20);
    let refusal = scene.reconstruct().unwrap_err();
    assert!(
        matches!(refusal, TwoViewRefusal::TooFewMatches { .. }),
        "{refusal:?}"
    );
    let nan = Vector2::repeat(f64::NAN);
    scene.correspondences = vec![
        Correspondence {
            first: nan,
            second: nan
        };
        100
    ];
    assert!(scene.reconstruct().is_err());
    let same = Vector2::new(0.1, 0.2);
    scene.correspondences = vec![
        Correspondence {
            first: same,
            second: same
        };
        100
    ];
    assert!(scene.reconstruct().is_err());
}

#[test]
fn the_same_seed_gives_the_same_start() {
    let found = || Scene::new(3, Shape::General, 0.5, 0.3, SIGMA).reconstruct();
    assert_eq!(found(), found());
}

#[test]
fn points_are_where_they_were_seen() {
    let mut scene = Scene::new(2, Shape::General, 0.5, 0.0, SIGMA);
    let found = scene.reconstruct().unwrap();
    assert_eq!(found.points_in_first.len(), scene.correspondences.len());
    assert_eq!(
        found.points_in_first.iter().flatten().count(),
        found.point_count
    );
    for (point, seen) in found.points_in_first.iter().zip(&scene.correspondences) {
        let Some(point) = point else { continue };
        let in_second = found.second_from_first * *point;
        assert!(point.z > 0.0 && in_second.z > 0.0);
        assert!((point.xy() / point.z - seen.first).norm() < 4.0 * SIGMA);
        assert!((in_second.xy() / in_second.z - seen.second).norm() < 4.0 * SIGMA);
    }
}

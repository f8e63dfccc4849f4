//! One point and cameras around it: accuracy, calibration, and every refusal.

use geometry::{Camera, Map, Transform, so3};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const SIGMA: f64 = 1.0 / 480.0;

fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

fn camera_at(x: f64, turn_rad: f64) -> Transform<Camera, Map> {
    let map_from_camera: Transform<Map, Camera> =
        Transform::new(so3::exp(&(Vector3::y() * turn_rad)), Vector3::x() * x);
    map_from_camera.inverse()
}

fn sightings(point: &Vector3<f64>, xs: &[f64]) -> Vec<Sighting> {
    xs.iter()
        .map(|x| {
            let camera_from_map = camera_at(*x, -0.05 * x);
            let in_camera = camera_from_map * *point;
            Sighting {
                camera_from_map,
                position: in_camera.xy() / in_camera.z,
                sigma: SIGMA,
            }
        })
        .collect()
}

const POINT: Vector3<f64> = Vector3::new(0.4, -0.3, 4.0);

#[test]
fn exact_sightings_give_the_exact_point() {
    for xs in [&[0.0, 0.5][..], &[0.0, 0.2, 0.4, 0.6, 0.8, 1.0]] {
        let sightings = sightings(&POINT, xs);
        let found = triangulate(&sightings, &TriangulationSettings::default()).unwrap();
        assert!((found.point_in_map - POINT).norm() < 1e-9);
        let first = POINT - Vector3::x() * xs[0];
        let last = POINT - Vector3::x() * xs[xs.len() - 1];
        assert!((found.parallax_rad - first.angle(&last)).abs() < 1e-9);
    }
}

#[test]
fn covariance_is_that_of_the_error() {
    // 600 points: the mean of eᵀP⁻¹e / 3 is 1 ± 0.04, and curvature adds a little.
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let accept_all = TriangulationSettings {
        parallax_rad_min: 0.0,
        chi_squared_max: f64::INFINITY,
    };
    for xs in [&[0.0, 0.8][..], &[0.0, 0.3, 0.6, 0.9]] {
        let mut nees = 0.0;
        for _ in 0..600 {
            let mut sightings = sightings(&POINT, xs);
            for sighting in &mut sightings {
                sighting.position += Vector2::from_fn(|_, _| gaussian(&mut rng) * SIGMA);
            }
            let found = triangulate(&sightings, &accept_all).unwrap();
            let error = found.point_in_map - POINT;
            let factor = found.covariance_in_map.cholesky().unwrap();
            nees += error.dot(&factor.solve(&error)) / 3.0 / 600.0;
        }
        assert!((0.88..1.15).contains(&nees), "{xs:?}: {nees}");
    }
}

#[test]
fn point_jacobian_matches_differences() {
    let camera_from_map = camera_at(0.3, 0.4);
    let rotation: Matrix3<f64> = camera_from_map.rotation_matrix();
    let project = |point: Vector3<f64>| {
        let in_camera = camera_from_map * point;
        in_camera.xy() / in_camera.z
    };
    let depth = (camera_from_map * POINT).z;
    let rows = d_position_d_point(&rotation, &project(POINT), 1.0 / depth);
    for axis in 0..3 {
        let mut delta = Vector3::zeros();
        delta[axis] = 1e-6;
        let numeric = (project(POINT + delta) - project(POINT - delta)) / 2e-6;
        let ours = Vector2::new(rows[0][axis], rows[1][axis]);
        assert!((numeric - ours).norm() < 1e-9, "axis {axis}");
    }
}

#[test]
fn every_refusal_has_its_reason() {
    let settings = TriangulationSettings::default();
    let refusal = |sightings: &[Sighting]| triangulate(sightings, &settings).unwrap_err();
    let good = sightings(&POINT, &[0.0, 0.5]);
    assert_eq!(refusal(&good[..1]), TriangulationRefusal::TooFewViews);

    let near = sightings(&POINT, &[0.0, 0.02]);
    assert!(matches!(
        refusal(&near),
        TriangulationRefusal::LowParallax { .. }
    ));

    let behind = sightings(&-POINT, &[0.0, 0.5]);
    assert_eq!(refusal(&behind), TriangulationRefusal::BehindCamera);

    let mut skew = good.clone();
    skew[0].position.y += 0.05;
    assert!(matches!(
        refusal(&skew),
        TriangulationRefusal::Inaccurate { .. }
    ));

    let same = vec![good[0]; 3];
    assert!(matches!(
        refusal(&same),
        TriangulationRefusal::Degenerate | TriangulationRefusal::LowParallax { .. }
    ));

    let mut bad = good.clone();
    bad[1].position.x = f64::NAN;
    assert_eq!(refusal(&bad), TriangulationRefusal::Degenerate);
    let mut bad = good;
    bad[1].sigma = 0.0;
    assert_eq!(refusal(&bad), TriangulationRefusal::Degenerate);
}

#[test]
fn random_sightings_never_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..2000 {
        let sightings: Vec<Sighting> = (0..3)
            .map(|_| Sighting {
                camera_from_map: camera_at(
                    rng.random_range(-1.0..1.0),
                    rng.random_range(-3.0..3.0),
                ),
                position: Vector2::from_fn(|_, _| rng.random_range(-1.0..1.0)),
                sigma: SIGMA,
            })
            .collect();
        if let Ok(found) = triangulate(&sightings, &TriangulationSettings::default()) {
            assert!(found.point_in_map.iter().all(|c| c.is_finite()));
        }
    }
}

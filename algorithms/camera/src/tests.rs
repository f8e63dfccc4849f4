//! Every camera model passes the same checks.

use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

use crate::{CameraModel, Distortion, ImplausibleCamera, Intrinsics};

const INTRINSICS: Intrinsics = Intrinsics {
    fx: 458.654,
    fy: 457.296,
    cx: 367.215,
    cy: 248.375,
};

fn cameras() -> Vec<CameraModel> {
    [
        Distortion::None,
        Distortion::RadialTangential {
            k1: -0.28340811,
            k2: 0.07395907,
            p1: 0.00019359,
            p2: 1.76187114e-05,
            k3: 0.0,
        },
        Distortion::RadialTangential {
            k1: 0.1,
            k2: -0.05,
            p1: 1e-3,
            p2: -2e-3,
            k3: 0.01,
        },
        Distortion::Equidistant {
            k1: -0.0137,
            k2: 0.0207,
            k3: -0.0128,
            k4: 0.0025,
        },
        // A common depth camera's, as its driver publishes it.
        Distortion::Rational {
            radial: [0.6733, -2.8418, 1.6289, 0.5515, -2.6596, 1.5529],
            p1: 1e-3,
            p2: -2e-4,
        },
        Distortion::FieldOfView { omega_rad: 0.92 },
        Distortion::DoubleSphere {
            xi: -0.25,
            alpha: 0.57,
        },
        Distortion::DoubleSphere {
            xi: 0.3,
            alpha: 0.4,
        },
        Distortion::DoubleSphere {
            xi: 1.2,
            alpha: 0.0,
        },
    ]
    .into_iter()
    .map(|distortion| CameraModel::new(752, 480, INTRINSICS, distortion).unwrap())
    .collect()
}

proptest! {
    #[test]
    fn unproject_undoes_project(x in 0.0_f64..751.0, y in 0.0_f64..479.0, depth in 0.1_f64..50.0) {
        for camera in cameras() {
            let pixel = Vector2::new(x, y);
            let ray = camera.unproject(&pixel).unwrap();
            prop_assert!((ray.norm() - 1.0).abs() < 1e-12);
            let again = camera.project(&(ray * depth)).unwrap();
            prop_assert!((again - pixel).norm() < 1e-6, "{camera:?} {again} {pixel}");
            let plane = camera.undistort(&pixel).unwrap();
            prop_assert!((plane - ray.xy() / ray.z).norm() < 1e-8);
        }
    }

    #[test]
    fn derivative_matches_differences(x in -0.7_f64..0.7, y in -0.5_f64..0.5, z in 0.3_f64..9.0) {
        for camera in cameras() {
            let point = Vector3::new(x * z, y * z, z);
            let (pixel, d_pixel_d_point) = camera.project_with_derivative(&point).unwrap();
            prop_assert!((pixel - camera.project(&point).unwrap()).norm() < 1e-12);
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-6 * z;
                let after = camera.project(&(point + step)).unwrap();
                let before = camera.project(&(point - step)).unwrap();
                let slope = (after - before) / (2e-6 * z);
                let error = (slope - d_pixel_d_point.column(axis)).norm();
                prop_assert!(error < 1e-4 * (1.0 + slope.norm()), "{camera:?} {error}");
            }
        }
    }
}

#[test]
fn points_behind_or_not_finite_have_no_pixel() {
    for camera in cameras() {
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, 0.0)), None);
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, f64::NAN)), None);
    }
}

#[test]
fn rays_beyond_the_fold_of_the_polynomial_have_no_pixel() {
    // With k1 = -0.28 the radial polynomial turns at r = sqrt(1 / 0.84) = 1.09.
    let distortion = Distortion::RadialTangential {
        k1: -0.28,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    };
    let intrinsics = Intrinsics {
        cx: 250.0,
        ..INTRINSICS
    };
    let camera = CameraModel::new(500, 480, intrinsics, distortion).unwrap();
    assert!(camera.project(&Vector3::new(1.0, 0.0, 1.0)).is_some());
    assert_eq!(camera.project(&Vector3::new(1.2, 0.0, 1.0)), None);
}

#[test]
fn matches_the_projection_of_an_independent_implementation() {
    // Hand-evaluated from the formulas of the OpenCV manual for EuRoC's cam0 at (0.3, -0.2, 1).
    let camera = &cameras()[1];
    let (x, y, r2) = (0.3, -0.2, 0.13);
    let radial = 1.0 - 0.28340811 * r2 + 0.07395907 * r2 * r2;
    let u = 458.654 * (x * radial + 2.0 * 0.00019359 * x * y + 1.76187114e-05 * (r2 + 2.0 * x * x))
        + 367.215;
    let v = 457.296 * (y * radial + 0.00019359 * (r2 + 2.0 * y * y) + 2.0 * 1.76187114e-05 * x * y)
        + 248.375;
    let pixel = camera.project(&Vector3::new(x, y, 1.0)).unwrap();
    assert!((pixel - Vector2::new(u, v)).norm() < 1e-9);
}

#[test]
fn every_model_leaves_the_neighbourhood_of_the_centre_as_it_is() {
    for camera in cameras() {
        let distortion = camera.distortion();
        for ideal in [Vector2::new(1e-6, 0.0), Vector2::new(-3e-7, 4e-7)] {
            let (bent, d_bent_d_ideal) = distortion.distort_with_derivative(&ideal);
            assert!((bent - ideal).norm() < 1e-8 * 1e-6 + 0.01 * ideal.norm());
            let error = (d_bent_d_ideal - nalgebra::Matrix2::identity()).norm();
            assert!(error < 1e-5, "{distortion:?} {d_bent_d_ideal}");
        }
        assert_eq!(
            distortion.distort(&Vector2::zeros()),
            Vector2::zeros(),
            "{distortion:?}"
        );
    }
}

#[test]
fn the_derivative_of_distortion_matches_differences_out_to_the_limit() {
    for camera in cameras() {
        let distortion = camera.distortion();
        let radius_max = distortion.radius_limit().min(3.5);
        for step in 1..40 {
            let radius = radius_max * f64::from(step) / 40.0;
            let ideal = Vector2::new(radius * 0.6, -radius * 0.8);
            let (_, derivative) = distortion.distort_with_derivative(&ideal);
            for axis in 0..2 {
                let mut step = Vector2::zeros();
                step[axis] = 1e-6;
                let after = distortion.distort(&(ideal + step));
                let slope = (after - distortion.distort(&(ideal - step))) / 2e-6;
                let error = (slope - derivative.column(axis)).norm();
                assert!(error < 1e-6, "{distortion:?} at {radius}: {error}");
            }
        }
    }
}

#[test]
fn wide_models_hold_out_to_the_rays_that_are_used() {
    // 74 degrees off the axis, the widest that any estimator here looks at.
    let ray = Vector3::new(3.5_f64.atan().sin(), 0.0, 3.5_f64.atan().cos());
    for distortion in [
        Distortion::FieldOfView { omega_rad: 0.92 },
        Distortion::DoubleSphere {
            xi: -0.25,
            alpha: 0.57,
        },
        Distortion::Equidistant {
            k1: -0.0137,
            k2: 0.0207,
            k3: -0.0128,
            k4: 0.0025,
        },
    ] {
        let intrinsics = Intrinsics {
            fx: 220.0,
            fy: 220.0,
            cx: 320.0,
            cy: 240.0,
        };
        let camera = CameraModel::new(640, 480, intrinsics, distortion).unwrap();
        let pixel = camera.project(&ray).unwrap();
        assert!((camera.unproject(&pixel).unwrap() - ray).norm() < 1e-9);
        let plane = camera.undistort(&pixel).unwrap();
        assert!((plane - Vector2::new(3.5, 0.0)).norm() < 1e-8, "{plane}");
    }
}

#[test]
fn pixels_of_rays_that_do_not_point_forward_have_no_place_on_the_ideal_plane() {
    let intrinsics = Intrinsics {
        fx: 200.0,
        fy: 200.0,
        cx: 320.0,
        cy: 240.0,
    };
    // A ray 100 degrees off the axis, by the formula of the paper: xi = -0.2, alpha = 0.6.
    let (xi, alpha) = (-0.2, 0.6);
    let angle = 100_f64.to_radians();
    let (x, z) = (angle.sin(), angle.cos());
    let shifted = xi + z;
    let bent = x / (alpha * x.hypot(shifted) + (1.0 - alpha) * shifted);
    let distortion = Distortion::DoubleSphere { xi, alpha };
    let camera = CameraModel::new(640, 480, intrinsics, distortion).unwrap();
    let pixel = Vector2::new(320.0 + 200.0 * (1.0 + xi) * bent, 240.0);
    let ray = camera.unproject(&pixel).unwrap();
    assert!((ray - Vector3::new(x, 0.0, z)).norm() < 1e-9, "{ray}");
    assert_eq!(camera.undistort(&pixel), None);
    // Outside the image of the whole sphere there is nothing: bent radius 1/sqrt(2 alpha - 1).
    let beyond = Vector2::new(320.0 + 200.0 * (1.0 + xi) * 2.24, 240.0);
    assert_eq!(camera.unproject(&beyond), None);
    let omega_rad = 1.0;
    let fov = CameraModel::new(640, 480, intrinsics, Distortion::FieldOfView { omega_rad });
    // Half a turn of the arctangent: r_d = (pi/2) / (2 tan(omega/2)) = 1.44.
    let fov = fov.unwrap_err();
    assert!(matches!(fov, ImplausibleCamera::FoldedDistortion { .. }));
}

#[test]
fn projects_as_the_papers_write_it() {
    let point = Vector3::new(0.7, -0.4, 1.3);
    let (fx, fy, cx, cy) = (200.0, 201.0, 320.0, 240.0);
    let check = |distortion: Distortion, bent: Vector2<f64>| {
        let slope = distortion.customary_slope();
        let intrinsics = Intrinsics {
            fx: fx * slope,
            fy: fy * slope,
            cx,
            cy,
        };
        let camera = CameraModel::new(640, 480, intrinsics, distortion).unwrap();
        let expected = Vector2::new(fx * bent.x + cx, fy * bent.y + cy);
        let pixel = camera.project(&point).unwrap();
        assert!((pixel - expected).norm() < 1e-9, "{distortion:?} {pixel}");
    };
    // Devernay and Faugeras, eq. 13.
    let ideal = point.xy() / point.z;
    let omega_rad: f64 = 0.8;
    let bent = (2.0 * ideal.norm() * (omega_rad / 2.0).tan()).atan() / omega_rad;
    check(
        Distortion::FieldOfView { omega_rad },
        ideal / ideal.norm() * bent,
    );
    // Usenko et al., eq. 40–45.
    let (xi, alpha) = (-0.17, 0.59);
    let shifted = xi * point.norm() + point.z;
    let d2 = point.xy().norm().hypot(shifted);
    let bent = point.xy() / (alpha * d2 + (1.0 - alpha) * shifted);
    check(Distortion::DoubleSphere { xi, alpha }, bent);
    // OpenCV's manual, with eight coefficients.
    let [k1, k2, k3, k4, k5, k6] = [0.1, -0.02, 0.003, 0.05, -0.01, 0.002];
    let (p1, p2) = (0.001, -0.002);
    let (x, y, r2) = (ideal.x, ideal.y, ideal.norm_squared());
    let radial = (1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3))
        / (1.0 + k4 * r2 + k5 * r2.powi(2) + k6 * r2.powi(3));
    let bent = Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let radial = [k1, k2, k3, k4, k5, k6];
    check(Distortion::Rational { radial, p1, p2 }, bent);
}

#[test]
fn refuses_numbers_that_are_no_camera() {
    let check = |intrinsics: Intrinsics, distortion: Distortion, expected: &str| {
        let error = CameraModel::new(752, 480, intrinsics, distortion).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    };
    let narrow = Intrinsics {
        fx: 10_000.0,
        fy: 10_000.0,
        ..INTRINSICS
    };
    check(narrow, Distortion::None, "only 4.30° wide");
    let stretched = Intrinsics {
        fy: 1000.0,
        ..INTRINSICS
    };
    check(stretched, Distortion::None, "differ by more than a factor");
    let aside = Intrinsics {
        cx: 20.0,
        ..INTRINSICS
    };
    check(aside, Distortion::None, "far off the centre");
    let sphere = |xi, alpha| Distortion::DoubleSphere { xi, alpha };
    check(INTRINSICS, sphere(-1.5, 0.5), "xi = -1.5: expected");
    check(INTRINSICS, sphere(0.1, 1.5), "alpha = 1.5: expected");
    check(INTRINSICS, sphere(f64::NAN, 0.5), "xi = NaN");
    let omega = |omega_rad| Distortion::FieldOfView { omega_rad };
    check(INTRINSICS, omega(0.0), "omega = 0: expected");
    check(INTRINSICS, omega(3.0), "folds back");
    assert!(matches!(
        CameraModel::new(0, 480, INTRINSICS, Distortion::None),
        Err(ImplausibleCamera::ImageSize { .. })
    ));
}

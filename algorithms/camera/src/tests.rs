//! Every camera model passes the same checks.

use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

use crate::{
    Calibration, CalibrationError, CameraModel, Distortion, ImplausibleCamera, Intrinsics,
};

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

const SENSOR: &str = "
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, -0.02, 1.0, 0.0, 0.0, -0.06, 0.0, 0.0, 1.0, 0.01, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] # fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
";

#[test]
fn reads_a_sensor_yaml() {
    let calibration = Calibration::from_euroc_yaml(SENSOR).unwrap();
    assert_eq!(calibration.camera, cameras()[1]);
    assert_eq!(calibration.rate_hz, Some(20.0));
    let forward = calibration.body_from_camera * Vector3::x();
    assert!((forward - Vector3::new(-0.02, 0.94, 0.01)).norm() < 1e-9);
}

#[test]
fn without_a_pose_only_the_axes_turn() {
    let start = SENSOR.find("T_BS").unwrap();
    let end = SENSOR.find("rate_hz").unwrap();
    let text = format!("{}{}", &SENSOR[..start], &SENSOR[end..]);
    let body_from_camera = Calibration::from_euroc_yaml(&text)
        .unwrap()
        .body_from_camera;
    assert!((body_from_camera * Vector3::z() - Vector3::x()).norm() < 1e-12);
    assert!((body_from_camera * Vector3::x() + Vector3::y()).norm() < 1e-12);
    assert!((body_from_camera * Vector3::y() + Vector3::z()).norm() < 1e-12);
}

#[test]
fn refuses_calibrations_that_do_not_fit() {
    let check = |from: &str, to: &str, expected: &str| {
        assert!(SENSOR.contains(from), "{from}");
        let error = Calibration::from_euroc_yaml(&SENSOR.replace(from, to)).unwrap_err();
        assert!(error.to_string().contains(expected), "{to}: {error}");
    };
    check("[458.654,", "[", "intrinsics has 3 numbers");
    check("458.654", "4.0", "fx = 4 px for an image 752 px wide");
    check("458.654", ".nan", "fx = NaN");
    check("367.215", "900.0", "principal point");
    check("[752, 480]", "[752]", "resolution has 1 numbers");
    check("[752, 480]", "[7520000, 480]", "image size");
    check("radial-tangential", "fov", "distortion_model is \"fov\"");
    check("pinhole", "omni", "camera_model is \"omni\"");
    check(
        "1.76187114e-05]",
        "1.0, 2.0, 3.0]",
        "distortion_coefficients has 6 numbers",
    );
    check("-0.28340811", "-3.0", "folds back");
    check("rate_hz: 20", "rate_hz: -1", "rate_hz is -1");
    check(
        "[0.0, -1.0, 0.0, -0.02",
        "[0.0, -2.0, 0.0, -0.02",
        "not a rigid transform",
    );
    assert!(matches!(
        Calibration::from_euroc_yaml("{ not yaml ]"),
        Err(CalibrationError::Syntax(_))
    ));
    assert!(matches!(
        Calibration::from_euroc_yaml(""),
        Err(CalibrationError::Syntax(_))
    ));
    assert!(matches!(
        CameraModel::new(0, 480, INTRINSICS, Distortion::None),
        Err(ImplausibleCamera::ImageSize { .. })
    ));
}

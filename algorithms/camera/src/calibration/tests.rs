use nalgebra::Vector3;

use super::*;
use crate::{Distortion, Intrinsics};

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
    assert_eq!(
        lens(&calibration.camera),
        [458.654, 457.296, 367.215, 248.375]
    );
    let distortion = Distortion::RadialTangential {
        k1: -0.28340811,
        k2: 0.07395907,
        p1: 0.00019359,
        p2: 1.76187114e-05,
        k3: 0.0,
    };
    assert_eq!(*calibration.camera.distortion(), distortion);
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
    check(
        "458.654",
        ".nan",
        "intrinsics holds NaN, expected finite numbers",
    );
    check("367.215", "900.0", "principal point");
    check("[752, 480]", "[752]", "resolution has 1 numbers");
    check("[752, 480]", "[7520000, 480]", "image size");
    check("radial-tangential", "lens", "distortion_model is \"lens\"");
    check("pinhole", "eyes", "camera_model is \"eyes\"");
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
        Calibration::from_yaml(""),
        Err(CalibrationError::UnknownKind)
    ));
}

fn lens(camera: &CameraModel) -> [f64; 4] {
    let Intrinsics { fx, fy, cx, cy } = *camera.intrinsics();
    [fx, fy, cx, cy]
}

#[test]
fn reads_kalibrs_camchains() {
    let text = include_str!("tests/kalibr_radtan.yaml");
    let calibration = Calibration::from_yaml(text).unwrap();
    let camera = &calibration.camera;
    assert_eq!((camera.width(), camera.height()), (752, 480));
    assert_eq!(lens(camera), [461.2, 459.8, 363.1, 248.2]);
    let radial_tangential = Distortion::RadialTangential {
        k1: -0.2874,
        k2: 0.0785,
        p1: 0.0002,
        p2: -0.0001,
        k3: 0.0,
    };
    assert_eq!(*camera.distortion(), radial_tangential);
    // The camera looks along the body's x, and its centre is at -R' t.
    let centre = calibration.body_from_camera * Vector3::zeros();
    assert!((centre - Vector3::new(-0.01, 0.05, -0.02)).norm() < 1e-9);
    let ahead = calibration.body_from_camera * Vector3::z() - centre;
    assert!((ahead - Vector3::x()).norm() < 1e-9);

    let camera = Calibration::from_yaml(include_str!("tests/kalibr_ds.yaml"))
        .unwrap()
        .camera;
    let sphere = Distortion::DoubleSphere {
        xi: -0.1721,
        alpha: 0.5931,
    };
    assert_eq!(*camera.distortion(), sphere);
    let slope = 1.0 / (1.0 - 0.1721);
    assert_eq!(lens(&camera), [158.3 * slope, 158.5 * slope, 254.6, 257.2]);

    let camera = Calibration::from_yaml(include_str!("tests/kalibr_fov.yaml"))
        .unwrap()
        .camera;
    let fov = Distortion::FieldOfView { omega_rad: 0.917 };
    assert_eq!(*camera.distortion(), fov);
    let slope = 2.0 * (0.917_f64 / 2.0).tan() / 0.917;
    assert_eq!(lens(&camera), [256.1 * slope, 255.9 * slope, 318.7, 242.3]);
}

#[test]
fn an_omnidirectional_camera_needs_to_be_bent_once_only() {
    let text = include_str!("tests/kalibr_omni.yaml");
    let error = Calibration::from_yaml(text).unwrap_err().to_string();
    assert!(
        error.starts_with("cam0.distortion_coeffs should be zeros"),
        "{error}"
    );
    let text = text.replace("[-0.21, 0.04, 0.0003, -0.0005]", "[0, 0, 0, 0]");
    let camera = Calibration::from_yaml(&text).unwrap().camera;
    let unified = Distortion::DoubleSphere {
        xi: 1.51,
        alpha: 0.0,
    };
    assert_eq!(*camera.distortion(), unified);
    // Mei's model by its own formula: x / (z + xi |p|).
    let point = Vector3::new(0.4, 0.1, 0.8);
    let pixel = camera.project(&point).unwrap();
    let u = 811.0 * 0.4 / (0.8 + 1.51 * point.norm()) + 371.2;
    assert!((pixel.x - u).abs() < 1e-9, "{pixel} {u}");
}

#[test]
fn reads_camera_info_as_a_file_and_as_an_echoed_message() {
    let text = include_str!("tests/ros_camera_info.yaml");
    let camera = Calibration::from_yaml(text).unwrap().camera;
    assert_eq!((camera.width(), camera.height()), (640, 480));
    assert_eq!(lens(&camera), [541.2, 540.9, 322.4, 236.1]);
    let plumb_bob = Distortion::RadialTangential {
        k1: 0.0831,
        k2: -0.1724,
        p1: -0.0011,
        p2: 0.0004,
        k3: 0.0,
    };
    assert_eq!(*camera.distortion(), plumb_bob);

    let text = include_str!("tests/ros_echo_rational.yaml");
    let camera = Calibration::from_yaml(text).unwrap().camera;
    assert_eq!((camera.width(), camera.height()), (1280, 720));
    let rational = Distortion::Rational {
        radial: [0.6733, -2.8418, 1.6289, 0.5515, -2.6596, 1.5529],
        p1: 0.0004,
        p2: -0.0002,
    };
    assert_eq!(*camera.distortion(), rational);
}

#[test]
fn reads_opencvs_files_in_both_spellings() {
    let text = include_str!("tests/opencv.yaml");
    let camera = Calibration::from_yaml(text).unwrap().camera;
    assert_eq!((camera.width(), camera.height()), (1280, 720));
    assert_eq!(lens(&camera), [912.34, 911.98, 639.51, 359.49]);
    let distortion = Distortion::RadialTangential {
        k1: 0.11,
        k2: -0.25,
        p1: 5.0e-4,
        p2: -7.0e-4,
        k3: 0.09,
    };
    assert_eq!(*camera.distortion(), distortion);

    let text = include_str!("tests/opencv_short.yaml");
    let camera = Calibration::from_yaml(text).unwrap().camera;
    let rational = Distortion::Rational {
        radial: [0.1, -0.05, 0.0, 0.01, 0.0, 0.0],
        p1: 0.0,
        p2: 0.0,
    };
    assert_eq!(*camera.distortion(), rational);

    let fisheye = include_str!("tests/opencv.yaml")
        .replace("fisheye_model: 0", "fisheye_model: 1")
        .replace(", 9.0e-02 ]", " ]");
    let camera = Calibration::from_yaml(&fisheye).unwrap().camera;
    assert!(matches!(
        camera.distortion(),
        Distortion::Equidistant { .. }
    ));
}

#[test]
fn every_kind_names_what_is_wrong_with_it() {
    let check = |text: &str, from: &str, to: &str, expected: &str| {
        assert!(text.contains(from), "{from}");
        let error = Calibration::from_yaml(&text.replace(from, to)).unwrap_err();
        assert!(error.to_string().contains(expected), "{to}: {error}");
    };
    let kalibr = include_str!("tests/kalibr_ds.yaml");
    check(kalibr, "ds", "eucm", "cam0.camera_model is \"eucm\"");
    check(kalibr, "-0.1721, ", "", "cam0.intrinsics has 5 numbers");
    check(kalibr, "0.5931", "5.931", "alpha = 5.931: expected 0 to 1");
    check(kalibr, "resolution", "size", "cam0.resolution is missing");
    let radtan = include_str!("tests/kalibr_radtan.yaml");
    let model = "distortion_model: radtan";
    let expected = "cam0.distortion_model is \"eyes\"";
    check(radtan, model, "distortion_model: eyes", expected);
    let expected = "cam0.distortion_coeffs has 4 numbers, expected 1";
    check(radtan, model, "distortion_model: fov", expected);
    let rotation = "[0.0, -1.0, 0.0, 0.05]";
    let expected = "T_cam_imu is not a rigid transform";
    check(radtan, rotation, "[1.0, -1.0, 0.0, 0.05]", expected);
    check(radtan, rotation, "[1e200, -1e200, 1e200, 0.05]", expected);
    let ros = include_str!("tests/ros_camera_info.yaml");
    check(ros, "image_width", "image_with", "image_width is missing");
    for size in ["image_width: 640.7", "image_width: -640"] {
        check(ros, "image_width: 640", size, "image_width");
    }
    check(ros, "plumb_bob", "lens", "distortion_model is \"lens\"");
    check(ros, "[541.2, 0,", "[541.2, 9,", "expected [fx, 0, cx");
    check(ros, "[541.2, 0,", "[541.2,", "camera_matrix has 8 numbers");
    for (number, got) in [(".nan", "NaN"), ("-.inf", "-inf"), ("1e400", "inf")] {
        let holds = |field: &str| format!("{field} holds {got}, expected finite numbers");
        let with = |before: &str| format!("{before}{number}, ");
        let field = holds("distortion_coefficients");
        check(ros, "[0.0831, ", &with("["), &field);
        check(ros, "[541.2, ", &with("["), &holds("camera_matrix"));
        let field = holds("cam0.resolution");
        check(kalibr, "resolution: [", &with("resolution: ["), &field);
        check(kalibr, "-0.1721, ", &with(""), &holds("cam0.intrinsics"));
        check(radtan, "[0.0, -1.0, ", &with("[0.0, "), &holds("T_cam_imu"));
    }
    check(
        ros,
        "image_width: 640",
        "image_width: .nan",
        "image_width holds NaN",
    );
    check(ros, "[0.0831, ", "[wide, ", "should hold numbers");
    let opencv = include_str!("tests/opencv.yaml");
    check(opencv, "1.1e-01", "-9.0", "folds back");
    check(opencv, "9.1234e+02", "9.1234e+04", "fx = 91234 px");
    check(opencv, "nframes: 23", "bayer: RGB", "bayer is \"RGB\"");
    let error = Calibration::from_yaml("width: 3\n").unwrap_err();
    assert!(matches!(error, CalibrationError::UnknownKind), "{error}");
}

#[test]
fn region_and_binning_make_the_camera_of_the_images() {
    let text = include_str!("tests/ros_camera_info.yaml");
    let read = |readout: &str| Calibration::from_yaml(&format!("{text}\n{readout}"));
    let camera_of = |readout: &str| {
        let camera = read(readout).unwrap().camera;
        ((camera.width(), camera.height()), lens(&camera))
    };
    let whole = ((640, 480), [541.2, 540.9, 322.4, 236.1]);
    let no_region = "roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}\n";
    assert_eq!(camera_of(no_region), whole);
    assert_eq!(
        camera_of(&format!("binning_x: 1\nbinning_y: 1\n{no_region}")),
        whole
    );
    let expected = ((320, 240), [270.6, 270.45, 161.2, 118.05]);
    assert_eq!(camera_of("binning_x: 2\nbinning_y: 2\n"), expected);
    // The region is chosen before its pixels are binned.
    let region = "roi: {x_offset: 160, y_offset: 120, height: 240, width: 320}\n";
    let (size, [fx, fy, cx, cy]) = camera_of(&format!("binning_x: 2\nbinning_y: 2\n{region}"));
    assert_eq!(size, (160, 120));
    let expected = [270.6, 270.45, (322.4 - 160.0) / 2.0, (236.1 - 120.0) / 2.0];
    for (got, expected) in [fx, fy, cx, cy].into_iter().zip(expected) {
        assert!((got - expected).abs() < 1e-9, "{got} {expected}");
    }
    let error = read("roi: {x_offset: 400, y_offset: 0, height: 480, width: 320}\n").unwrap_err();
    let expected = "region of interest of 320×480 at (400, 0) is not inside";
    assert!(error.to_string().contains(expected), "{error}");
}

#[test]
fn a_mosaic_is_said_by_its_pattern() {
    let text = format!("{SENSOR}bayer: grbg\n");
    assert!(Calibration::from_yaml(&text).unwrap().is_mosaic);
    assert!(!Calibration::from_yaml(SENSOR).unwrap().is_mosaic);
}

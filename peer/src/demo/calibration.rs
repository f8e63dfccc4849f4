//! A simulated camera's calibration as a file, as a vehicle's own would be.

use camera::{CameraModel, Distortion};
use geometry::{Body, Camera, Transform};

/// The text of a EuRoC `sensor.yaml`.
pub fn sensor_yaml(camera: &CameraModel, body_from_camera: &Transform<Body, Camera>) -> String {
    let lens = camera.intrinsics();
    let slope = camera.distortion().customary_slope();
    let mut intrinsics = vec![lens.fx / slope, lens.fy / slope, lens.cx, lens.cy];
    let mut camera_model = "pinhole";
    let (distortion_model, coefficients) = match *camera.distortion() {
        Distortion::None => ("none", Vec::new()),
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => {
            ("radial-tangential", vec![k1, k2, p1, p2, k3])
        }
        Distortion::Rational { radial, p1, p2 } => {
            let [k1, k2, k3, k4, k5, k6] = radial;
            ("rational_polynomial", vec![k1, k2, p1, p2, k3, k4, k5, k6])
        }
        Distortion::Equidistant { k1, k2, k3, k4 } => ("equidistant", vec![k1, k2, k3, k4]),
        Distortion::FieldOfView { omega_rad } => ("fov", vec![omega_rad]),
        Distortion::DoubleSphere { xi, alpha } => {
            camera_model = "ds";
            intrinsics.splice(0..0, [xi, alpha]);
            ("none", Vec::new())
        }
    };
    let matrix = body_from_camera.to_matrix();
    let rows: Vec<f64> = matrix.transpose().iter().copied().collect();
    format!(
        "# EuRoC sensor.yaml fields\n\
         sensor_type: camera\n\
         camera_model: {camera_model}\n\
         intrinsics: {intrinsics:?}\n\
         distortion_model: {distortion_model}\n\
         distortion_coefficients: {coefficients:?}\n\
         resolution: [{}, {}]\n\
         T_BS:\n  cols: 4\n  rows: 4\n  data: {rows:?}\n",
        camera.width(),
        camera.height(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_simulated_camera_reads_back_as_it_is() {
        for vehicle in sim::ScenarioName::Lab.vehicles() {
            let text = sensor_yaml(&vehicle.camera, &vehicle.body_from_camera);
            let calibration = camera::Calibration::from_euroc_yaml(&text).unwrap();
            assert_eq!(calibration.camera, vehicle.camera, "{}", vehicle.id);
            let error = calibration.body_from_camera.inverse() * vehicle.body_from_camera;
            assert!(error.log().norm() < 1e-9, "{}: {error:?}", vehicle.id);
        }
    }

    #[test]
    fn every_kind_of_lens_reads_back_as_it_is() {
        let mut vehicle = sim::ScenarioName::Lab.vehicles().remove(0);
        for distortion in [
            Distortion::None,
            Distortion::Rational {
                radial: [0.3, -0.1, 0.02, 0.2, -0.05, 0.01],
                p1: 0.001,
                p2: -0.002,
            },
            Distortion::Equidistant {
                k1: 0.01,
                k2: 0.0,
                k3: 0.0,
                k4: 0.0,
            },
            Distortion::FieldOfView { omega_rad: 0.9 },
            Distortion::DoubleSphere {
                xi: -0.2,
                alpha: 0.6,
            },
        ] {
            let [width, height] = [vehicle.camera.width(), vehicle.camera.height()];
            let intrinsics = *vehicle.camera.intrinsics();
            vehicle.camera =
                camera::CameraModel::new(width, height, intrinsics, distortion).unwrap();
            let text = sensor_yaml(&vehicle.camera, &vehicle.body_from_camera);
            let read = camera::Calibration::from_euroc_yaml(&text).unwrap();
            assert_eq!(read.camera.distortion(), vehicle.camera.distortion());
            let (got, expected) = (read.camera.intrinsics(), vehicle.camera.intrinsics());
            assert!((got.fx - expected.fx).abs() < 1e-9 * expected.fx, "{got:?}");
        }
    }
}

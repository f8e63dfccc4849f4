//! A simulated camera's calibration as a file, as a vehicle's own would be.

use camera::Distortion;
use sim::VehicleDescription;

/// The text of a EuRoC `sensor.yaml`.
pub fn sensor_yaml(vehicle: &VehicleDescription) -> String {
    let camera = &vehicle.camera;
    let lens = camera.intrinsics();
    let (model, coefficients) = match *camera.distortion() {
        Distortion::None => ("none", Vec::new()),
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => {
            ("radial-tangential", vec![k1, k2, p1, p2, k3])
        }
        Distortion::Equidistant { k1, k2, k3, k4 } => ("equidistant", vec![k1, k2, k3, k4]),
    };
    let matrix = vehicle.body_from_camera.to_matrix();
    let rows: Vec<f64> = matrix.transpose().iter().copied().collect();
    format!(
        "# EuRoC sensor.yaml fields\n\
         sensor_type: camera\n\
         camera_model: pinhole\n\
         intrinsics: [{}, {}, {}, {}]\n\
         distortion_model: {model}\n\
         distortion_coefficients: {coefficients:?}\n\
         resolution: [{}, {}]\n\
         T_BS:\n  cols: 4\n  rows: 4\n  data: {rows:?}\n",
        lens.fx,
        lens.fy,
        lens.cx,
        lens.cy,
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
            let text = sensor_yaml(&vehicle);
            let calibration = camera::Calibration::from_euroc_yaml(&text).unwrap();
            assert_eq!(calibration.camera, vehicle.camera, "{}", vehicle.id);
            let error = calibration.body_from_camera.inverse() * vehicle.body_from_camera;
            assert!(error.log().norm() < 1e-9, "{}: {error:?}", vehicle.id);
        }
    }
}

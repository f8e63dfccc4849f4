//! One camera as EuRoC's `sensor.yaml` describes it, or Kalibr's camchain under `cam0`.

use super::lens::{self, Coefficients};
use super::node::Node;
use super::{Calibration, CalibrationError, Field, Place, optical_axes, rigid};
use crate::{CameraModel, Distortion};

/// - `place`: of the camera's entries in the file.
pub fn read(node: &Node, place: Place) -> Result<Calibration, CalibrationError> {
    let intrinsics = numbers(node, place.field("intrinsics"))?;
    let (lens, distortion) = match node.get("camera_model").map(Node::text) {
        None | Some(Some("pinhole")) => {
            let lens = exactly(&intrinsics, place.field("intrinsics"), "4")?;
            (lens, pinhole_distortion(node, place)?)
        }
        Some(Some("ds" | "double-sphere" | "double_sphere")) => {
            let [xi, alpha, lens @ ..] = exactly::<6>(&intrinsics, place.field("intrinsics"), "6")?;
            check_undistorted(node, place)?;
            (lens, Distortion::DoubleSphere { xi, alpha })
        }
        // The unified model is the double sphere whose second sphere has no part.
        Some(Some("omni")) => {
            let [xi, lens @ ..] = exactly::<5>(&intrinsics, place.field("intrinsics"), "5")?;
            check_undistorted(node, place)?;
            (lens, Distortion::DoubleSphere { xi, alpha: 0.0 })
        }
        Some(got) => {
            return Err(CalibrationError::CameraModel {
                field: place.field("camera_model").to_string(),
                got: got.unwrap_or("no text").to_owned(),
            });
        }
    };
    let resolution = numbers(node, place.field("resolution"))?;
    let size: [f64; 2] = exactly(&resolution, place.field("resolution"), "2")?;
    let [width, height] = size.map(|side| side as usize);
    let intrinsics = lens::intrinsics(lens, &distortion);
    Ok(Calibration {
        camera: CameraModel::new(width, height, intrinsics, distortion)?,
        body_from_camera: match (node.get("T_BS"), node.get("T_cam_imu")) {
            (Some(matrix), _) => rigid::read(matrix, "T_BS")?,
            (None, Some(matrix)) => rigid::read(matrix, "T_cam_imu")?.inverse(),
            (None, None) => optical_axes(),
        },
        rate_hz: rate(node)?,
        is_mosaic: super::is_mosaic(node)?,
    })
}

fn pinhole_distortion(node: &Node, place: Place) -> Result<Distortion, CalibrationError> {
    let names = ["distortion_coefficients", "distortion_coeffs"];
    let present = names.into_iter().find(|name| node.get(name).is_some());
    let field = place.field(present.unwrap_or(names[0]));
    let values = match present {
        Some(_) => numbers(node, field)?,
        None => Vec::new(),
    };
    let model = node.get("distortion_model").and_then(Node::text);
    let model = model.map(|name| (name, place.field("distortion_model")));
    let coefficients = Coefficients {
        field,
        values: &values,
    };
    if model.is_none() && values.iter().all(|value| *value == 0.0) {
        return Ok(Distortion::None);
    }
    lens::distortion(model, &coefficients)
}

/// Kalibr bends the picture of an omnidirectional camera once more.
fn check_undistorted(node: &Node, place: Place) -> Result<(), CalibrationError> {
    match pinhole_distortion(node, place)? {
        Distortion::None => Ok(()),
        distortion if is_zero(&distortion) => Ok(()),
        _ => Err(CalibrationError::BentTwice {
            field: place.field("distortion_coeffs").to_string(),
        }),
    }
}

fn is_zero(distortion: &Distortion) -> bool {
    let zero = Distortion::RadialTangential {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    };
    *distortion == zero
}

fn numbers(node: &Node, field: Field) -> Result<Vec<f64>, CalibrationError> {
    let Some(entry) = node.get(field.name) else {
        let field = field.to_string();
        return Err(CalibrationError::Missing { field });
    };
    super::numbers(entry, field)
}

fn exactly<const COUNT: usize>(
    values: &[f64],
    field: Field,
    expected: &'static str,
) -> Result<[f64; COUNT], CalibrationError> {
    values.try_into().map_err(|_| CalibrationError::Count {
        field: field.to_string(),
        got: values.len(),
        expected,
    })
}

fn rate(node: &Node) -> Result<Option<f64>, CalibrationError> {
    let Some(entry) = node.get("rate_hz") else {
        return Ok(None);
    };
    let got = entry.number().unwrap_or(f64::NAN);
    if got > 0.0 && got.is_finite() {
        Ok(Some(got))
    } else {
        Err(CalibrationError::Rate { got })
    }
}

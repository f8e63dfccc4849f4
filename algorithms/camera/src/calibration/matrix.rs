//! A camera as ROS `camera_info` and OpenCV describe it: a camera matrix, coefficients, a size.

use super::lens::{self, Coefficients};
use super::node::Node;
use super::{Calibration, CalibrationError, Place};
use crate::CameraModel;

/// What `camera_info` says, in a file or in a message.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    pub width: usize,
    pub height: usize,
    /// `None` where only the number of coefficients tells.
    pub distortion_model: Option<String>,
    pub coefficients: Vec<f64>,
    /// Row by row.
    pub camera_matrix: Vec<f64>,
}

const PLACE: Place = Place::ROOT;

const CAMERA_MATRIX: &[&str] = &["cameramatrix", "k", "intrinsicmatrix"];
const COEFFICIENTS: &[&str] = &["distortioncoefficients", "distcoeffs", "distcoeff", "d"];
const WIDTH: &[&str] = &["imagewidth", "width"];
const HEIGHT: &[&str] = &["imageheight", "height"];

pub fn is_this(node: &Node) -> bool {
    node.find(CAMERA_MATRIX).is_some()
}

pub fn read(node: &Node) -> Result<Calibration, CalibrationError> {
    let distortion_model = node.get("distortion_model").and_then(Node::text);
    let is_fisheye = node
        .find(&["fisheyemodel", "fisheye"])
        .is_some_and(|(_, flag)| flag.number() == Some(1.0));
    let info = CameraInfo {
        width: side(node, WIDTH, "image_width")?,
        height: side(node, HEIGHT, "image_height")?,
        distortion_model: match distortion_model {
            None if is_fisheye => Some("fisheye".to_owned()),
            model => model.map(str::to_owned),
        },
        coefficients: match node.find(COEFFICIENTS) {
            Some((name, entry)) => numbers(name, entry)?,
            None => Vec::new(),
        },
        camera_matrix: match node.find(CAMERA_MATRIX) {
            Some((name, entry)) => numbers(name, entry)?,
            None => Vec::new(),
        },
    };
    let mut calibration = info.calibration()?;
    calibration.is_mosaic = super::is_mosaic(node)?;
    Ok(calibration)
}

impl CameraInfo {
    /// ROS leaves the focal length zero where a camera was never calibrated.
    pub fn is_calibrated(&self) -> bool {
        self.camera_matrix.first().is_some_and(|fx| *fx != 0.0)
    }

    /// The camera at the body's origin, looking forward.
    pub fn calibration(&self) -> Result<Calibration, CalibrationError> {
        let field = |name| PLACE.field(name);
        let &[fx, skew, cx, zero_0, fy, cy, zero_1, zero_2, one] = self.camera_matrix.as_slice()
        else {
            return Err(CalibrationError::Count {
                field: field("camera_matrix").to_string(),
                got: self.camera_matrix.len(),
                expected: "9",
            });
        };
        let no_zeros = [skew, zero_0, zero_1, zero_2].map(|value| value.abs() > 1e-3);
        if no_zeros.contains(&true) || (one - 1.0).abs() > 1e-9 {
            return Err(CalibrationError::CameraMatrix {
                got: self.camera_matrix.clone(),
            });
        }
        let model = self.distortion_model.as_deref();
        let coefficients = Coefficients {
            field: field("distortion_coefficients"),
            values: &self.coefficients,
        };
        let model = model.map(|name| (name, field("distortion_model")));
        let distortion = lens::distortion(model, &coefficients)?;
        let intrinsics = lens::intrinsics([fx, fy, cx, cy], &distortion);
        let camera = CameraModel::new(self.width, self.height, intrinsics, distortion)?;
        Ok(Calibration::looking_forward(camera))
    }
}

fn side(node: &Node, names: &[&str], expected: &str) -> Result<usize, CalibrationError> {
    let missing = || CalibrationError::Missing {
        field: expected.to_owned(),
    };
    let (name, entry) = node.find(names).ok_or_else(missing)?;
    let number = entry.number().ok_or_else(|| CalibrationError::NoNumbers {
        field: name.to_owned(),
    })?;
    Ok(number as usize)
}

fn numbers(name: &str, entry: &Node) -> Result<Vec<f64>, CalibrationError> {
    entry.numbers().ok_or_else(|| CalibrationError::NoNumbers {
        field: name.to_owned(),
    })
}

//! Calibration files.

mod euroc;
mod lens;
mod matrix;
mod node;
mod rigid;

use std::fmt;

use geometry::{Body, Camera, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::{CameraModel, ImplausibleCamera};
pub use matrix::{CameraInfo, Readout};
use node::Node;

/// A camera, where it sits on its vehicle, and how it takes images.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    pub camera: CameraModel,
    /// `T_BS` of the file, or the inverse of `T_cam_imu`; where both are absent the body's origin
    /// is the camera and only the axes turn.
    pub body_from_camera: Transform<Body, Camera>,
    pub rate_hz: Option<f64>,
    /// Grey images of one channel are mosaics of colours; in which order does not matter for the
    /// grey that becomes of them.
    pub is_mosaic: bool,
}

/// Why a calibration file is refused.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    #[error("no YAML: {0}")]
    Syntax(String),
    #[error(
        "no kind of calibration that is known; expected `intrinsics` (EuRoC's sensor.yaml), \
         `cam0` (Kalibr) or `camera_matrix` (ROS camera_info, OpenCV)"
    )]
    UnknownKind,
    #[error("{field} is missing")]
    Missing { field: String },
    #[error("{field} should hold numbers")]
    NoNumbers { field: String },
    #[error("{field} holds {got}, expected finite numbers")]
    NotFinite { field: String, got: f64 },
    #[error(
        "the region of interest of {width}×{height} at ({x}, {y}) is not inside the image of \
         {image_width}×{image_height}"
    )]
    Region {
        width: usize,
        height: usize,
        x: usize,
        y: usize,
        image_width: usize,
        image_height: usize,
    },
    #[error("{field} is {got:?}, expected \"pinhole\", \"ds\" or \"omni\"")]
    CameraModel { field: String, got: String },
    #[error(
        "{field} is {got:?}, expected \"radial-tangential\", \"rational_polynomial\", \
         \"equidistant\", \"fov\" or \"none\""
    )]
    DistortionModel { field: String, got: String },
    #[error(
        "{field} should be zeros: an omnidirectional model is supported without further distortion"
    )]
    BentTwice { field: String },
    #[error("{field} has {got} numbers, expected {expected}")]
    Count {
        field: String,
        got: usize,
        expected: &'static str,
    },
    #[error("camera_matrix is {got:?}, expected [fx, 0, cx, 0, fy, cy, 0, 0, 1]")]
    CameraMatrix { got: Vec<f64> },
    #[error("rate_hz is {got}, expected a positive number")]
    Rate { got: f64 },
    #[error("bayer is {got:?}, expected RGGB, BGGR, GRBG or GBRG")]
    Bayer { got: String },
    #[error("{field} is not a rigid transform: its rotation is off by {error:.3}")]
    NotRigid { field: &'static str, error: f64 },
    #[error(transparent)]
    Implausible(#[from] ImplausibleCamera),
}

impl Calibration {
    /// A camera at the body's origin that looks forward.
    pub fn looking_forward(camera: CameraModel) -> Self {
        Self {
            camera,
            body_from_camera: optical_axes(),
            rate_hz: None,
            is_mosaic: false,
        }
    }

    /// Reads the text of any kind of calibration, told apart by what is in it: EuRoC's
    /// `sensor.yaml`, the first camera of Kalibr's camchain, ROS `camera_info`, OpenCV's YAML.
    ///
    /// Fields that are not about the camera are ignored.
    pub fn from_yaml(text: &str) -> Result<Self, CalibrationError> {
        let node = Node::parse(text)?;
        if let Some(first) = node.get("cam0") {
            euroc::read(first, Place::in_parent("cam0"))
        } else if matrix::is_this(&node) {
            matrix::read(&node)
        } else if node.get("intrinsics").is_some() || node.get("resolution").is_some() {
            euroc::read(&node, Place::ROOT)
        } else {
            Err(CalibrationError::UnknownKind)
        }
    }

    /// Reads the text of a EuRoC `sensor.yaml`.
    pub fn from_euroc_yaml(text: &str) -> Result<Self, CalibrationError> {
        euroc::read(&Node::parse(text)?, Place::ROOT)
    }
}

/// `body_from_camera` of a camera at the body's origin that looks forward.
fn optical_axes() -> Transform<Body, Camera> {
    // Columns: the camera's right, down and forward axes in forward, left, up.
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Transform::new(rotation, Vector3::zeros())
}

fn is_mosaic(node: &Node) -> Result<bool, CalibrationError> {
    let Some(entry) = node.get("bayer") else {
        return Ok(false);
    };
    let got = entry.text().unwrap_or_default();
    match got.to_ascii_uppercase().as_str() {
        "RGGB" | "BGGR" | "GRBG" | "GBRG" => Ok(true),
        _ => Err(CalibrationError::Bayer {
            got: got.to_owned(),
        }),
    }
}

/// The numbers of an entry, all of them finite.
fn numbers(entry: &Node, field: impl fmt::Display) -> Result<Vec<f64>, CalibrationError> {
    let field = || field.to_string();
    let numbers = entry.numbers();
    let numbers = numbers.ok_or_else(|| CalibrationError::NoNumbers { field: field() })?;
    check_finite(&numbers, field)?;
    Ok(numbers)
}

fn check_finite(numbers: &[f64], field: impl Fn() -> String) -> Result<(), CalibrationError> {
    match numbers.iter().find(|number| !number.is_finite()) {
        Some(got) => Err(CalibrationError::NotFinite {
            field: field(),
            got: *got,
        }),
        None => Ok(()),
    }
}

/// Where in the file the entries of a camera are.
#[derive(Clone, Copy)]
struct Place {
    parent: Option<&'static str>,
}

impl Place {
    const ROOT: Self = Self { parent: None };

    fn in_parent(parent: &'static str) -> Self {
        Self {
            parent: Some(parent),
        }
    }

    fn field<'a>(&self, name: &'a str) -> Field<'a> {
        Field {
            parent: self.parent,
            name,
        }
    }
}

/// An entry as errors name it.
#[derive(Clone, Copy)]
struct Field<'a> {
    parent: Option<&'static str>,
    name: &'a str,
}

impl fmt::Display for Field<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.parent {
            Some(parent) => write!(f, "{parent}.{}", self.name),
            None => f.write_str(self.name),
        }
    }
}

#[cfg(test)]
mod tests;

//! Calibration files.

use geometry::{Body, Camera, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::{CameraModel, Distortion, ImplausibleCamera, Intrinsics};

/// A camera, where it sits on its vehicle, and how fast it takes images.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    pub camera: CameraModel,
    /// `T_BS` of the file; where it is absent the body's origin is the camera and only the axes
    /// turn.
    pub body_from_camera: Transform<Body, Camera>,
    pub rate_hz: Option<f64>,
}

/// Why a calibration file is refused.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    #[error("not a sensor.yaml: {0}")]
    Syntax(String),
    #[error("camera_model is {got:?}, expected \"pinhole\"")]
    CameraModel { got: String },
    #[error(
        "distortion_model is {got:?}, expected \"radial-tangential\", \"equidistant\" or \"none\""
    )]
    DistortionModel { got: String },
    #[error("{field} has {got} numbers, expected {expected}")]
    Count {
        field: &'static str,
        got: usize,
        expected: &'static str,
    },
    #[error("rate_hz is {got}, expected a positive number")]
    Rate { got: f64 },
    #[error("T_BS is not a rigid transform: its rotation is off by {error:.3}")]
    NotRigid { error: f64 },
    #[error(transparent)]
    Implausible(#[from] ImplausibleCamera),
}

/// EuRoC's `sensor.yaml`; fields that are not about the camera are ignored.
#[derive(Deserialize)]
struct SensorYaml {
    #[serde(default)]
    camera_model: Option<String>,
    intrinsics: Vec<f64>,
    #[serde(default)]
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coefficients: Vec<f64>,
    resolution: Vec<usize>,
    #[serde(default)]
    rate_hz: Option<f64>,
    #[serde(rename = "T_BS", default)]
    body_from_sensor: Option<MatrixYaml>,
}

#[derive(Deserialize)]
struct MatrixYaml {
    data: Vec<f64>,
}

impl Calibration {
    /// A camera at the body's origin that looks forward.
    pub fn looking_forward(camera: CameraModel) -> Self {
        Self {
            camera,
            body_from_camera: optical_axes(),
            rate_hz: None,
        }
    }

    /// Reads the text of a EuRoC `sensor.yaml`.
    pub fn from_euroc_yaml(text: &str) -> Result<Self, CalibrationError> {
        let yaml: SensorYaml = serde_saphyr::from_str(text)
            .map_err(|error| CalibrationError::Syntax(first_line(&error.to_string())))?;
        if let Some(got) = yaml
            .camera_model
            .as_deref()
            .filter(|name| *name != "pinhole")
        {
            return Err(CalibrationError::CameraModel {
                got: got.to_owned(),
            });
        }
        let &[fx, fy, cx, cy] = yaml.intrinsics.as_slice() else {
            let got = yaml.intrinsics.len();
            return Err(CalibrationError::Count {
                field: "intrinsics",
                got,
                expected: "4",
            });
        };
        let &[width, height] = yaml.resolution.as_slice() else {
            let got = yaml.resolution.len();
            return Err(CalibrationError::Count {
                field: "resolution",
                got,
                expected: "2",
            });
        };
        if let Some(got) = yaml
            .rate_hz
            .filter(|rate| !(*rate > 0.0 && rate.is_finite()))
        {
            return Err(CalibrationError::Rate { got });
        }
        let distortion = read_distortion(
            yaml.distortion_model.as_deref(),
            &yaml.distortion_coefficients,
        )?;
        let intrinsics = Intrinsics { fx, fy, cx, cy };
        Ok(Self {
            camera: CameraModel::new(width, height, intrinsics, distortion)?,
            body_from_camera: match yaml.body_from_sensor {
                Some(matrix) => read_rigid(&matrix.data)?,
                None => optical_axes(),
            },
            rate_hz: yaml.rate_hz,
        })
    }
}

/// `body_from_camera` of a camera at the body's origin that looks forward.
fn optical_axes() -> Transform<Body, Camera> {
    // Columns: the camera's right, down and forward axes in forward, left, up.
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Transform::new(rotation, Vector3::zeros())
}

fn read_distortion(model: Option<&str>, values: &[f64]) -> Result<Distortion, CalibrationError> {
    let count_error = |expected| CalibrationError::Count {
        field: "distortion_coefficients",
        got: values.len(),
        expected,
    };
    match model {
        None | Some("none") if values.iter().all(|value| *value == 0.0) => Ok(Distortion::None),
        None | Some("radial-tangential" | "radtan" | "plumb_bob") => match *values {
            [] => Ok(Distortion::None),
            [k1, k2, p1, p2] => Ok(Distortion::RadialTangential {
                k1,
                k2,
                p1,
                p2,
                k3: 0.0,
            }),
            [k1, k2, p1, p2, k3] => Ok(Distortion::RadialTangential { k1, k2, p1, p2, k3 }),
            _ => Err(count_error("4 or 5")),
        },
        Some("none") => Err(count_error("0")),
        Some("equidistant") => match *values {
            [k1, k2, k3, k4] => Ok(Distortion::Equidistant { k1, k2, k3, k4 }),
            _ => Err(count_error("4")),
        },
        Some(got) => Err(CalibrationError::DistortionModel {
            got: got.to_owned(),
        }),
    }
}

fn read_rigid(data: &[f64]) -> Result<Transform<Body, Camera>, CalibrationError> {
    if data.len() != 16 {
        return Err(CalibrationError::Count {
            field: "T_BS",
            got: data.len(),
            expected: "16",
        });
    }
    let matrix = nalgebra::Matrix4::from_row_slice(data);
    let linear: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let error = (linear * linear.transpose() - Matrix3::identity()).norm()
        + (linear.determinant() - 1.0).abs();
    let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    if error.is_nan() || error >= 1e-2 || !translation.iter().all(|value| value.is_finite()) {
        return Err(CalibrationError::NotRigid { error });
    }
    // The nearest rotation in closed form: nalgebra's iterative `from_matrix` stays where it
    // starts for rotations by a half turn.
    let svd = linear.svd(true, true);
    let nearest = svd.u.unwrap_or_default() * svd.v_t.unwrap_or_default();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest));
    Ok(Transform::new(rotation, translation))
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_owned()
}

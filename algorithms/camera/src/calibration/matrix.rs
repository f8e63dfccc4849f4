//! A camera as ROS `camera_info` and OpenCV describe it: a camera matrix, coefficients, a size.

use super::lens::{self, Coefficients};
use super::node::Node;
use super::{Calibration, CalibrationError, Place, check_finite, numbers};
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
    pub readout: Readout,
}

/// Which part of the sensor the images show, and how coarsely. The calibration is that of the
/// whole sensor, as `sensor_msgs/CameraInfo` has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Readout {
    /// So many columns and rows become one pixel; 0 is as good as 1.
    pub binning: [usize; 2],
    /// Column and row of the region's first pixel, before binning.
    pub offset: [usize; 2],
    /// Width and height of the region, before binning; zeros for the whole sensor.
    pub size: [usize; 2],
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
            Some((name, entry)) => numbers(entry, name)?,
            None => Vec::new(),
        },
        camera_matrix: match node.find(CAMERA_MATRIX) {
            Some((name, entry)) => numbers(entry, name)?,
            None => Vec::new(),
        },
        readout: readout(node)?,
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
        check_finite(&self.camera_matrix, || field("camera_matrix").to_string())?;
        let coefficients_field = field("distortion_coefficients");
        check_finite(&self.coefficients, || coefficients_field.to_string())?;
        let model = self.distortion_model.as_deref();
        let coefficients = Coefficients {
            field: coefficients_field,
            values: &self.coefficients,
        };
        let model = model.map(|name| (name, field("distortion_model")));
        let distortion = lens::distortion(model, &coefficients)?;
        let (lens, [width, height]) = self.read_out([fx, fy, cx, cy])?;
        let intrinsics = lens::intrinsics(lens, &distortion);
        let camera = CameraModel::new(width, height, intrinsics, distortion)?;
        Ok(Calibration::looking_forward(camera))
    }

    /// Focal lengths and principal point in the images that are read out, and their size: what
    /// `image_geometry` of ROS makes of region and binning, in this order.
    fn read_out(
        &self,
        [fx, fy, cx, cy]: [f64; 4],
    ) -> Result<([f64; 4], [usize; 2]), CalibrationError> {
        let Readout {
            binning,
            offset: [x, y],
            size,
        } = self.readout;
        let whole = [self.width, self.height];
        let [width, height] = if size == [0, 0] { whole } else { size };
        let ends = x.checked_add(width).zip(y.checked_add(height));
        let is_inside = ends.is_some_and(|(right, bottom)| {
            width > 0 && height > 0 && right <= self.width && bottom <= self.height
        });
        if !is_inside {
            return Err(CalibrationError::Region {
                width,
                height,
                x,
                y,
                image_width: self.width,
                image_height: self.height,
            });
        }
        let [across, down] = binning.map(|count| count.max(1));
        let lens = [
            fx / across as f64,
            fy / down as f64,
            (cx - x as f64) / across as f64,
            (cy - y as f64) / down as f64,
        ];
        Ok((lens, [width / across, height / down]))
    }
}

fn readout(node: &Node) -> Result<Readout, CalibrationError> {
    let region = node.find(&["roi"]).map(|(_, region)| region);
    let count = |parent: Option<&Node>, name: &'static str| {
        let found = parent.and_then(|parent| parent.find(&[name]));
        found.map_or(Ok(0), |(name, entry)| whole_number(name, entry))
    };
    let pair = |parent: Option<&Node>, [first, second]: [&'static str; 2]| {
        Ok::<_, CalibrationError>([count(parent, first)?, count(parent, second)?])
    };
    Ok(Readout {
        binning: pair(Some(node), ["binningx", "binningy"])?,
        offset: pair(region, ["xoffset", "yoffset"])?,
        size: pair(region, ["width", "height"])?,
    })
}

fn side(node: &Node, names: &[&str], expected: &str) -> Result<usize, CalibrationError> {
    let missing = || CalibrationError::Missing {
        field: expected.to_owned(),
    };
    let (name, entry) = node.find(names).ok_or_else(missing)?;
    whole_number(name, entry)
}

fn whole_number(name: &str, entry: &Node) -> Result<usize, CalibrationError> {
    match numbers(entry, name)?.as_slice() {
        [number] if *number >= 0.0 && number.fract() == 0.0 => Ok(*number as usize),
        _ => Err(CalibrationError::NoNumbers {
            field: name.to_owned(),
        }),
    }
}

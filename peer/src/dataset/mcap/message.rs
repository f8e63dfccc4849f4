//! Messages with images and calibrations.

use camera::{CameraInfo, Readout};

use super::cdr::{MessageEnds, RosEncoding, RosReader};
use super::protobuf::{Value, fields};
use crate::dataset::decode::{self, ImageError, Raster, RawImage};

/// What the messages of a channel are, and how they are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageType {
    pub content: Content,
    wire: Wire,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    CompressedImage,
    RawImage,
    CameraInfo,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Ros(RosEncoding),
    /// Foxglove's schemas in protobuf.
    Foxglove,
}

/// A message's calibration, and the matrix of the image after rectification.
#[derive(Clone, Debug, PartialEq)]
pub struct PublishedCamera {
    pub info: CameraInfo,
    /// 3×4, row by row.
    projection_matrix: Vec<f64>,
}

/// So many bytes of a message hold its stamp.
pub const HEAD_BYTES: usize = 64;

impl MessageType {
    /// `None` if it is of no use here.
    pub fn of(schema: &str, message_encoding: &str) -> Option<Self> {
        let (content, wire) = match (schema, message_encoding) {
            (_, "protobuf") => {
                let content = match schema {
                    "foxglove.CompressedImage" => Content::CompressedImage,
                    "foxglove.RawImage" => Content::RawImage,
                    "foxglove.CameraCalibration" => Content::CameraInfo,
                    _ => return None,
                };
                (content, Wire::Foxglove)
            }
            (_, "cdr" | "ros1") => {
                let content = match schema {
                    "sensor_msgs/msg/CompressedImage" | "sensor_msgs/CompressedImage" => {
                        Content::CompressedImage
                    }
                    "sensor_msgs/msg/Image" | "sensor_msgs/Image" => Content::RawImage,
                    "sensor_msgs/msg/CameraInfo" | "sensor_msgs/CameraInfo" => Content::CameraInfo,
                    _ => return None,
                };
                let encoding = match message_encoding {
                    "cdr" => RosEncoding::Cdr,
                    _ => RosEncoding::Ros1,
                };
                (content, Wire::Ros(encoding))
            }
            _ => return None,
        };
        Some(Self { content, wire })
    }

    pub fn is_image(&self) -> bool {
        self.content != Content::CameraInfo
    }

    /// When the image was captured; `None` if nobody said so.
    ///
    /// - `head`: the first [`HEAD_BYTES`] suffice.
    pub fn stamp_ns(&self, head: &[u8]) -> Option<i64> {
        let stamp = match self.wire {
            Wire::Ros(encoding) => {
                let mut reader = RosReader::new(encoding, head).ok()?;
                reader.header_stamp_ns().ok()?
            }
            Wire::Foxglove => {
                let stamp = fields(head).find_map(|field| match field {
                    (1, Value::Bytes(bytes)) => Some(bytes),
                    _ => None,
                })?;
                let number = |wanted| {
                    fields(stamp).find_map(|field| match field {
                        (key, Value::Number(number)) if key == wanted => Some(number as i64),
                        _ => None,
                    })
                };
                number(1).unwrap_or(0).checked_mul(1_000_000_000)? + number(2).unwrap_or(0)
            }
        };
        (stamp != 0).then_some(stamp)
    }

    /// The image of a whole message.
    pub fn image(&self, bytes: &[u8]) -> Result<Raster, ImageError> {
        let ends = |_: MessageEnds| ImageError::Message("it ends too early".to_owned());
        match (self.content, self.wire) {
            (Content::CompressedImage, Wire::Ros(encoding)) => {
                let data = ros_compressed(encoding, bytes).map_err(ends)?;
                decode::decode(data)
            }
            (Content::CompressedImage, Wire::Foxglove) => {
                let data = fields(bytes).find_map(|field| match field {
                    (2, Value::Bytes(data)) => Some(data),
                    _ => None,
                });
                decode::decode(data.ok_or(MessageEnds).map_err(ends)?)
            }
            (Content::RawImage, Wire::Ros(encoding)) => {
                decode::decode_raw(&ros_raw(encoding, bytes).map_err(ends)?)
            }
            (Content::RawImage, Wire::Foxglove) => decode::decode_raw(&foxglove_raw(bytes)),
            (Content::CameraInfo, _) => Err(ImageError::UnknownFormat),
        }
    }

    /// The calibration of a whole message; `None` if it is damaged.
    pub fn camera(&self, bytes: &[u8]) -> Option<PublishedCamera> {
        match self.wire {
            Wire::Ros(encoding) => ros_camera(encoding, bytes).ok(),
            Wire::Foxglove => Some(foxglove_camera(bytes)),
        }
    }
}

impl PublishedCamera {
    /// The pinhole that remains after rectification.
    pub fn rectified(&self) -> CameraInfo {
        let camera_matrix = match self.projection_matrix.as_slice() {
            &[fx, skew, cx, _, zero, fy, cy, _, ..] => {
                vec![fx, skew, cx, zero, fy, cy, 0.0, 0.0, 1.0]
            }
            _ => Vec::new(),
        };
        CameraInfo {
            distortion_model: Some("none".to_owned()),
            coefficients: Vec::new(),
            camera_matrix,
            ..self.info.clone()
        }
    }
}

fn ros_compressed(encoding: RosEncoding, bytes: &[u8]) -> Result<&[u8], MessageEnds> {
    let mut reader = RosReader::new(encoding, bytes)?;
    reader.header_stamp_ns()?;
    let _frame_id = reader.text()?;
    let _format = reader.text()?;
    reader.bytes()
}

fn ros_raw(encoding: RosEncoding, bytes: &[u8]) -> Result<RawImage<'_>, MessageEnds> {
    let mut reader = RosReader::new(encoding, bytes)?;
    reader.header_stamp_ns()?;
    let _frame_id = reader.text()?;
    Ok(RawImage {
        height: reader.u32()? as usize,
        width: reader.u32()? as usize,
        encoding: reader.text()?,
        is_big_endian: reader.u8()? != 0,
        step: reader.u32()? as usize,
        pixels: reader.bytes()?,
    })
}

fn ros_camera(encoding: RosEncoding, bytes: &[u8]) -> Result<PublishedCamera, MessageEnds> {
    let mut reader = RosReader::new(encoding, bytes)?;
    reader.header_stamp_ns()?;
    let _frame_id = reader.text()?;
    let height = reader.u32()? as usize;
    let width = reader.u32()? as usize;
    let distortion_model = reader.text()?.to_owned();
    let coefficient_count = reader.u32()? as usize;
    let coefficients = reader.f64s(coefficient_count)?;
    let camera_matrix = reader.f64s(9)?;
    let _rectification = reader.f64s(9)?;
    let projection_matrix = reader.f64s(12)?;
    // Some write no more than this; then the images show the whole sensor.
    let mut next = || reader.u32().map_or(0, |number| number as usize);
    let (binning, offset) = ([next(), next()], [next(), next()]);
    let (roi_height, roi_width) = (next(), next());
    Ok(PublishedCamera {
        info: CameraInfo {
            width,
            height,
            distortion_model: Some(distortion_model),
            coefficients,
            camera_matrix,
            readout: Readout {
                binning,
                offset,
                size: [roi_width, roi_height],
            },
        },
        projection_matrix,
    })
}

fn foxglove_raw(bytes: &[u8]) -> RawImage<'_> {
    let mut image = RawImage {
        width: 0,
        height: 0,
        step: 0,
        encoding: "",
        is_big_endian: false,
        pixels: &[],
    };
    for field in fields(bytes) {
        match field {
            (2, Value::Number(width)) => image.width = width as usize,
            (3, Value::Number(height)) => image.height = height as usize,
            (4, Value::Bytes(text)) => image.encoding = std::str::from_utf8(text).unwrap_or(""),
            (5, Value::Number(step)) => image.step = step as usize,
            (6, Value::Bytes(pixels)) => image.pixels = pixels,
            _ => {}
        }
    }
    image
}

fn foxglove_camera(bytes: &[u8]) -> PublishedCamera {
    let mut info = CameraInfo {
        width: 0,
        height: 0,
        distortion_model: Some(String::new()),
        coefficients: Vec::new(),
        camera_matrix: Vec::new(),
        readout: Readout::default(),
    };
    let mut projection_matrix = Vec::new();
    for field in fields(bytes) {
        match field {
            (2, Value::Number(width)) => info.width = width as usize,
            (3, Value::Number(height)) => info.height = height as usize,
            (4, Value::Bytes(name)) => {
                info.distortion_model = Some(String::from_utf8_lossy(name).into_owned());
            }
            (5, value) => append(&mut info.coefficients, value),
            (6, value) => append(&mut info.camera_matrix, value),
            (8, value) => append(&mut projection_matrix, value),
            _ => {}
        }
    }
    PublishedCamera {
        info,
        projection_matrix,
    }
}

/// Repeated numbers come packed or one by one.
fn append(numbers: &mut Vec<f64>, value: Value) {
    match value {
        Value::Number(bits) => numbers.push(f64::from_bits(bits)),
        Value::Bytes(bytes) => {
            let packed = bytes.as_chunks().0.iter().copied();
            numbers.extend(packed.map(f64::from_le_bytes));
        }
    }
}

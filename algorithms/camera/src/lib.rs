#![doc = include_str!("../README.md")]

mod calibration;
mod distortion;
mod image;
mod model;

pub use calibration::{Calibration, CalibrationError, CameraInfo, Readout};
pub use distortion::Distortion;
pub use image::{Image, ImageSizeMismatch};
pub use model::{CameraModel, ImplausibleCamera, Intrinsics};

#[cfg(test)]
mod tests;

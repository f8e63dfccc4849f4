//! Why recordings and images are refused.

use std::fmt;
use std::path::PathBuf;

use camera::CalibrationError;

use super::mcap::McapRefusal;
use super::video::VideoRefusal;
use super::{FrameRange, ImageError};
use crate::files::FileError;

/// Why a recording is refused as a whole.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error("no such file or folder: {path}")]
    Nothing { path: PathBuf },
    #[error(
        "found none of rgb.txt (TUM RGB-D), mav0/cam0/data.csv (EuRoC), image_0 (KITTI), nor one \
         MCAP file; images need a list with their time stamps, in {folder}"
    )]
    UnknownLayout { folder: PathBuf },
    #[error("{what}: {path}")]
    UnknownFile { what: &'static str, path: PathBuf },
    /// A list or a calibration beside the images.
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{error}: {path}")]
    Mcap { error: McapRefusal, path: PathBuf },
    #[error("{error}: {path}")]
    Video { error: VideoRefusal, path: PathBuf },
    #[error("--topic {topic:?} is given, but only MCAP files have topics: {path}")]
    NoTopics { topic: String, path: PathBuf },
    #[error("lists no images: {path}")]
    NoImages { path: PathBuf },
    #[error("frames {range} of a recording of {frame_count}: {path}")]
    EmptyRange {
        range: FrameRange,
        frame_count: usize,
        path: PathBuf,
    },
    #[error("no calibration; expected one of {expected}, or --calibration FILE: {path}")]
    NoCalibration { expected: String, path: PathBuf },
    #[error("calibration refused: {error}: {path}")]
    Calibration {
        error: CalibrationError,
        path: PathBuf,
    },
    #[error(
        "the calibration is for {}×{}, the images have {}×{}{}: {calibration} and {image}",
        expected_px.0, expected_px.1, got_px.0, got_px.1, scale_hint(*expected_px, *got_px)
    )]
    CalibrationSize {
        expected_px: (usize, usize),
        got_px: (usize, usize),
        calibration: PathBuf,
        image: PathBuf,
    },
    #[error("no image could be decoded, of {frame_count}; the first: {first}")]
    NoImageDecodes {
        frame_count: usize,
        first: UnreadableImage,
    },
}

/// One image that is skipped, and why.
#[derive(Debug, thiserror::Error)]
pub struct UnreadableImage {
    pub reason: ImageError,
    /// Of the image, or of the recording that it is in.
    pub path: PathBuf,
    /// Which image of the recording.
    pub frame_idx: Option<usize>,
}

impl fmt::Display for UnreadableImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.display();
        match self.frame_idx {
            Some(frame_idx) => write!(f, "{}: frame {frame_idx} of {path}", self.reason),
            None => write!(f, "{}: {path}", self.reason),
        }
    }
}

/// Whole multiples and fractions are the same camera's other resolutions.
fn scale_hint(calibrated: (usize, usize), images: (usize, usize)) -> &'static str {
    let is_multiple = |large: (usize, usize), small: (usize, usize)| {
        let factor = large.0 / small.0.max(1);
        factor > 1 && (small.0 * factor, small.1 * factor) == large
    };
    if is_multiple(calibrated, images) || is_multiple(images, calibrated) {
        " (it looks like another resolution of the same camera: scale its numbers, or the images)"
    } else if (calibrated.1, calibrated.0) == images {
        " (turned by a quarter)"
    } else {
        ""
    }
}

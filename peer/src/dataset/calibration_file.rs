//! A calibration, and which file it is from.

use std::path::{Path, PathBuf};

use camera::{Calibration, CalibrationError, CameraModel, Distortion, Intrinsics};

use super::DatasetError;
use super::layout::read_text;
use super::mcap::TopicCalibration;
use crate::files::FileError;

/// What errors about the calibration name.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    pub calibration: Calibration,
    pub path: PathBuf,
}

/// A calibration that does not say for which size of images it is: KITTI's `calib.txt`.
#[derive(Clone, Debug)]
pub struct SizelessCalibration {
    intrinsics: Intrinsics,
    path: PathBuf,
}

/// What `--calibration` names.
#[derive(Clone, Debug)]
pub enum GivenCalibration {
    Whole(CalibrationFile),
    Sizeless(SizelessCalibration),
}

/// Calibrations are short: nothing longer is read.
const CALIBRATION_BYTES_MAX: u64 = 1 << 20;

impl CalibrationFile {
    /// Reads a file of any kind that says it all: see [`Calibration::from_yaml`].
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        Self::parse(&read_short(path)?, path)
    }

    fn parse(text: &str, path: &Path) -> Result<Self, DatasetError> {
        let path = path.to_owned();
        match Calibration::from_yaml(text) {
            Err(error) => Err(DatasetError::Calibration { error, path }),
            Ok(calibration) => Ok(Self { calibration, path }),
        }
    }

    /// - `recording`: which holds the topic.
    pub fn from_topic(found: &TopicCalibration, recording: &Path) -> Result<Self, DatasetError> {
        let path = PathBuf::from(format!("{} in {}", found.topic, recording.display()));
        match found.info.calibration() {
            Err(error) => Err(DatasetError::Calibration { error, path }),
            Ok(calibration) => Ok(Self { calibration, path }),
        }
    }

    /// Width and height of the images that it is for.
    pub fn size_px(&self) -> (usize, usize) {
        let camera = &self.calibration.camera;
        (camera.width(), camera.height())
    }
}

impl GivenCalibration {
    /// Reads a file of any kind that is known.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let text = read_short(path)?;
        if text.lines().any(|line| line.starts_with(KITTI_MATRIX)) {
            SizelessCalibration::parse(&text, path).map(Self::Sizeless)
        } else {
            CalibrationFile::parse(&text, path).map(Self::Whole)
        }
    }

    /// - `image_size_px`: width and height, where the file does not say them.
    pub fn for_images(
        self,
        image_size_px: (usize, usize),
    ) -> Result<CalibrationFile, DatasetError> {
        match self {
            Self::Whole(file) => Ok(file),
            Self::Sizeless(sizeless) => sizeless.for_images(image_size_px),
        }
    }
}

/// The first camera's 3×4 projection matrix stands behind it, row by row.
const KITTI_MATRIX: &str = "P0:";

impl SizelessCalibration {
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        Self::parse(&read_short(path)?, path)
    }

    fn parse(text: &str, path: &Path) -> Result<Self, DatasetError> {
        let refused = |reason: String, line| FileError::Line {
            reason,
            path: path.to_owned(),
            line,
        };
        let (line_idx, numbers) = text
            .lines()
            .enumerate()
            .find_map(|(line_idx, line)| Some((line_idx, line.strip_prefix(KITTI_MATRIX)?)))
            .ok_or_else(|| refused(format!("no line `{KITTI_MATRIX}`"), 1))?;
        let numbers: Vec<f64> = numbers
            .split_whitespace()
            .map_while(|number| number.parse().ok())
            .collect();
        let &[fx, _, cx, _, _, fy, cy, _, _, _, _, _] = numbers.as_slice() else {
            let reason = format!("P0 has {} numbers, expected 12", numbers.len());
            return Err(refused(reason, line_idx + 1).into());
        };
        Ok(Self {
            intrinsics: Intrinsics { fx, fy, cx, cy },
            path: path.to_owned(),
        })
    }

    pub fn for_images(
        self,
        (width, height): (usize, usize),
    ) -> Result<CalibrationFile, DatasetError> {
        let path = self.path;
        match CameraModel::new(width, height, self.intrinsics, Distortion::None) {
            Err(error) => Err(DatasetError::Calibration {
                error: CalibrationError::Implausible(error),
                path,
            }),
            Ok(camera) => Ok(CalibrationFile {
                calibration: Calibration::looking_forward(camera),
                path,
            }),
        }
    }
}

fn read_short(path: &Path) -> Result<String, DatasetError> {
    if std::fs::metadata(path).is_ok_and(|file| file.len() > CALIBRATION_BYTES_MAX) {
        let reason = format!("longer than {CALIBRATION_BYTES_MAX} bytes, no calibration");
        let path = path.to_owned();
        return Err(FileError::Content { reason, path }.into());
    }
    read_text(path)
}

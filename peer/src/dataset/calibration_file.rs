//! A calibration, and which file it is from.

use std::path::{Path, PathBuf};

use camera::Calibration;

use super::DatasetError;
use super::mcap::TopicCalibration;
use crate::files::FileError;

/// What errors about the calibration name.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    pub calibration: Calibration,
    pub path: PathBuf,
}

/// Calibrations are short: nothing longer is read.
const CALIBRATION_BYTES_MAX: u64 = 1 << 20;

impl CalibrationFile {
    /// Reads a file of any kind that is known: see [`Calibration::from_yaml`].
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let path = path.to_owned();
        if std::fs::metadata(&path).is_ok_and(|file| file.len() > CALIBRATION_BYTES_MAX) {
            let reason = format!("longer than {CALIBRATION_BYTES_MAX} bytes, no calibration");
            return Err(FileError::Content { reason, path }.into());
        }
        match std::fs::read_to_string(&path) {
            Err(error) => Err(FileError::Read { error, path }.into()),
            Ok(text) => match Calibration::from_yaml(&text) {
                Err(error) => Err(DatasetError::Calibration { error, path }),
                Ok(calibration) => Ok(Self { calibration, path }),
            },
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

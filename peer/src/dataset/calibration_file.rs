//! A calibration, and which file it is from.

use std::path::{Path, PathBuf};

use camera::Calibration;

use super::DatasetError;
use crate::files::FileError;

/// What errors about the calibration name.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    pub calibration: Calibration,
    pub path: PathBuf,
}

impl CalibrationFile {
    /// Reads a file with the fields of EuRoC's `sensor.yaml`.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let path = path.to_owned();
        match std::fs::read_to_string(&path) {
            Err(error) => Err(FileError::Read { error, path }.into()),
            Ok(text) => match Calibration::from_euroc_yaml(&text) {
                Err(error) => Err(DatasetError::Calibration { error, path }),
                Ok(calibration) => Ok(Self { calibration, path }),
            },
        }
    }

    /// Width and height of the images that it is for.
    pub fn size_px(&self) -> (usize, usize) {
        let camera = &self.calibration.camera;
        (camera.width(), camera.height())
    }
}

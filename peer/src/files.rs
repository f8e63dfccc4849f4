//! Files that other tools read and write: trajectories and point clouds.

mod cloud;
mod covariance;
mod pcd;
mod ply;
mod stamp;
mod tum;
mod xyz;

use std::path::{Path, PathBuf};

pub use cloud::{PointCloud, read_cloud, write_cloud};
pub use covariance::{
    COVARIANCE_HEADER, format_covariance_line, read_covariances, write_covariances,
};
pub use stamp::parse_seconds;
pub use tum::{StampedPose, format_tum_line, parse_tum_line, read_tum, write_tum};

/// Why a file is not read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    #[error("cannot read: {error}: {path}")]
    Read {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error("cannot write: {error}: {path}")]
    Write {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error("{reason} at {path}:{line}")]
    Line {
        reason: String,
        path: PathBuf,
        line: usize,
    },
    #[error("{reason}: {path}")]
    Content { reason: String, path: PathBuf },
}

/// Makes the folder that a file will be written to, before the work that fills it.
pub fn create_folder_of(path: &Path) -> Result<(), FileError> {
    let Some(folder) = path.parent() else {
        return Ok(());
    };
    std::fs::create_dir_all(folder).map_err(|error| FileError::Write {
        error,
        path: folder.to_owned(),
    })
}

#[cfg(test)]
mod tests;

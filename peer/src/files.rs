//! Files that other tools read and write: trajectories and point clouds.

mod cloud;
mod covariance;
mod destination;
mod pcd;
mod ply;
mod stamp;
mod tum;
mod xyz;

use std::path::PathBuf;

pub use cloud::{PointCloud, check_cloud_name, read_cloud, write_cloud};
pub use covariance::{
    COVARIANCE_HEADER, format_covariance_line, read_covariances, write_covariances,
};
pub use destination::{check_destination, create_folder};
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

#[cfg(test)]
mod tests;

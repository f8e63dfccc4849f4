//! Point clouds, in whichever format their name says.

use std::fs;
use std::path::Path;

use super::error::{FileError, Refused};
use super::point_cloud::PointCloud;
use super::{npz, pcd, ply, xyz};

/// The formats by the extension of a file's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CloudFormat {
    Ply,
    Pcd,
    Text,
    /// Only read.
    Npz,
}

impl CloudFormat {
    fn of(path: &Path) -> Result<Self, FileError> {
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        match extension.to_ascii_lowercase().as_str() {
            "ply" => Ok(Self::Ply),
            "pcd" => Ok(Self::Pcd),
            "xyz" | "csv" | "txt" => Ok(Self::Text),
            "npz" => Ok(Self::Npz),
            _ => Err(unknown_name(path, ".ply, .pcd, .xyz, .csv, .txt or .npz")),
        }
    }

    fn to_write(path: &Path) -> Result<Self, FileError> {
        match Self::of(path) {
            Ok(Self::Npz) | Err(_) => Err(unknown_name(path, ".ply, .pcd, .xyz, .csv or .txt")),
            known => known,
        }
    }
}

fn unknown_name(path: &Path, known: &str) -> FileError {
    FileError::Content {
        reason: format!("expected a name that ends with {known}"),
        path: path.to_owned(),
    }
}

/// Whether the extension names a format that clouds are written in.
pub fn check_cloud_name(path: &Path) -> Result<(), FileError> {
    CloudFormat::to_write(path).map(drop)
}

/// Reads PLY, PCD, NPZ, or text with one point a line. A file without a point is refused.
pub fn read_cloud(path: &Path) -> Result<PointCloud, FileError> {
    let format = CloudFormat::of(path)?;
    let bytes = fs::read(path).map_err(|error| FileError::Read {
        error,
        path: path.to_owned(),
    })?;
    let cloud = match format {
        CloudFormat::Ply => ply::parse(&bytes),
        CloudFormat::Pcd => pcd::parse(&bytes),
        CloudFormat::Text => xyz::parse(&bytes),
        CloudFormat::Npz => npz::parse(&bytes),
    }
    .and_then(|cloud| {
        if cloud.points.is_empty() {
            Err(Refused::whole("holds no points"))
        } else {
            Ok(cloud)
        }
    });
    cloud.map_err(|refused| refused.into_error(path))
}

/// Writes binary PLY, binary PCD, or text.
pub fn write_cloud(path: &Path, cloud: &PointCloud) -> Result<(), FileError> {
    let bytes = match CloudFormat::to_write(path)? {
        CloudFormat::Ply => ply::format(cloud, ply::Encoding::BinaryLittleEndian),
        CloudFormat::Pcd => pcd::format(cloud),
        CloudFormat::Text | CloudFormat::Npz => xyz::format(cloud),
    };
    fs::write(path, bytes).map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

//! Trajectories in the TUM format: `timestamp tx ty tz qx qy qz qw`, one pose a line.

use std::fs;
use std::io::Write;
use std::path::Path;

use geometry::{Camera, Timestamp, Transform};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::error::FileError;
use super::stamp::parse_seconds;

/// Where a camera was at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose<Target> {
    pub captured_at: Timestamp,
    pub target_from_camera: Transform<Target, Camera>,
}

/// A quaternion in a file may be off the unit sphere by its rounding, not by more than this.
const QUATERNION_NORM_ERROR_MAX: f64 = 1e-2;

/// Reads a trajectory. `#` starts a comment; the order of the lines is kept.
pub fn read_tum<Target>(path: &Path) -> Result<Vec<StampedPose<Target>>, FileError> {
    let text = fs::read_to_string(path).map_err(|error| FileError::Read {
        error,
        path: path.to_owned(),
    })?;
    let mut poses = Vec::new();
    for (line_idx, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        poses.push(parse_tum_line(line).map_err(|reason| FileError::Line {
            reason,
            path: path.to_owned(),
            line: line_idx + 1,
        })?);
    }
    Ok(poses)
}

/// Writes a trajectory, the time stamps exactly.
pub fn write_tum<Target>(
    path: &Path,
    poses: impl IntoIterator<Item = StampedPose<Target>>,
) -> Result<(), FileError> {
    let write = || -> std::io::Result<()> {
        let mut file = std::io::BufWriter::new(fs::File::create(path)?);
        for pose in poses {
            writeln!(file, "{}", format_tum_line(&pose))?;
        }
        file.flush()
    };
    write().map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

/// One line, without its end.
pub fn format_tum_line<Target>(pose: &StampedPose<Target>) -> String {
    let position = pose.target_from_camera.translation();
    let rotation = pose.target_from_camera.rotation();
    format!(
        "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
        pose.captured_at,
        position.x,
        position.y,
        position.z,
        rotation.i,
        rotation.j,
        rotation.k,
        rotation.w
    )
}

/// Reads one line, or says what is wrong with it.
pub fn parse_tum_line<Target>(line: &str) -> Result<StampedPose<Target>, String> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    if fields.len() != 8 {
        return Err(format!(
            "expected 8 numbers (timestamp tx ty tz qx qy qz qw), got {}",
            fields.len()
        ));
    }
    let captured_at = parse_seconds(fields[0])
        .ok_or_else(|| format!("{:?} is no time stamp in seconds", fields[0]))?;
    let mut numbers = [0.0; 7];
    for (number, field) in numbers.iter_mut().zip(&fields[1..]) {
        *number = field
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| format!("{field:?} is no finite number"))?;
    }
    let [x, y, z, i, j, k, w] = numbers;
    let quaternion = Quaternion::new(w, i, j, k);
    if (quaternion.norm() - 1.0).abs() > QUATERNION_NORM_ERROR_MAX {
        return Err(format!(
            "the quaternion's norm is {:.4}, expected 1",
            quaternion.norm()
        ));
    }
    Ok(StampedPose {
        captured_at,
        target_from_camera: Transform::new(
            UnitQuaternion::from_quaternion(quaternion),
            Vector3::new(x, y, z),
        ),
    })
}

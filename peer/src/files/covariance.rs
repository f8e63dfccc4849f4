//! `{id}.cov.csv`: the upper entries of a position covariance for each line of a trajectory.

use std::fs;
use std::path::Path;

use geometry::Timestamp;
use nalgebra::Matrix3;

use super::error::FileError;
use super::stamp::parse_seconds;

/// The first line: square metres, in the axes of the trajectory.
pub const COVARIANCE_HEADER: &str = "timestamp,xx,xy,xz,yy,yz,zz";

/// One line, without its end.
pub fn format_covariance_line(captured_at: Timestamp, covariance: &Matrix3<f64>) -> String {
    let entry = |row: usize, column: usize| covariance[(row, column)];
    format!(
        "{captured_at},{:e},{:e},{:e},{:e},{:e},{:e}",
        entry(0, 0),
        entry(0, 1),
        entry(0, 2),
        entry(1, 1),
        entry(1, 2),
        entry(2, 2)
    )
}

/// Writes the header and a line for each covariance.
pub fn write_covariances(
    path: &Path,
    covariances: impl IntoIterator<Item = (Timestamp, Matrix3<f64>)>,
) -> Result<(), FileError> {
    let mut text = format!("{COVARIANCE_HEADER}\n");
    for (captured_at, covariance) in covariances {
        text += &format_covariance_line(captured_at, &covariance);
        text.push('\n');
    }
    fs::write(path, text).map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

/// Reads what [`write_covariances`] wrote.
pub fn read_covariances(path: &Path) -> Result<Vec<(Timestamp, Matrix3<f64>)>, FileError> {
    let text = fs::read_to_string(path).map_err(|error| FileError::Read {
        error,
        path: path.to_owned(),
    })?;
    let mut covariances = Vec::new();
    for (line_idx, line) in text.lines().enumerate() {
        if line.is_empty() || line == COVARIANCE_HEADER {
            continue;
        }
        covariances.push(parse_line(line).ok_or_else(|| FileError::Line {
            reason: format!("expected {COVARIANCE_HEADER}, got {line:?}"),
            path: path.to_owned(),
            line: line_idx + 1,
        })?);
    }
    Ok(covariances)
}

fn parse_line(line: &str) -> Option<(Timestamp, Matrix3<f64>)> {
    let mut fields = line.split(',');
    let captured_at = parse_seconds(fields.next()?)?;
    let entries: Vec<f64> = fields
        .map(|field| field.trim().parse().ok())
        .collect::<Option<_>>()?;
    let &[xx, xy, xz, yy, yz, zz] = entries.as_slice() else {
        return None;
    };
    let covariance = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    covariance
        .iter()
        .all(|entry| entry.is_finite())
        .then_some((captured_at, covariance))
}

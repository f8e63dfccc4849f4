//! Text with one point a line: XYZ, and CSV with or without names of columns.

use std::fmt::Write;

use nalgebra::Vector3;

use super::error::Refused;
use super::point_cloud::PointCloud;

/// Reads numbers separated by blanks, commas or semicolons.
///
/// The first line may name the columns, then `x`, `y` and `z` are looked for; otherwise they are
/// the first three. Every line must have as many columns as the first.
pub(super) fn parse(bytes: &[u8]) -> Result<PointCloud, Refused> {
    let text = std::str::from_utf8(bytes).map_err(|_| Refused::whole("the text is not UTF-8"))?;
    let mut axes = [0, 1, 2];
    let mut column_count = None;
    let mut points = Vec::new();
    for (line_idx, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with(['#', '/']) {
            continue;
        }
        let refused = |reason| Refused::at(line_idx + 1, reason);
        let columns: Vec<&str> = line
            .split([',', ';', ' ', '\t'])
            .filter(|column| !column.is_empty())
            .collect();
        let expected = *column_count.get_or_insert(columns.len());
        if columns.len() != expected || columns.len() < 3 {
            return Err(refused(format!(
                "{} columns, expected {}",
                columns.len(),
                expected.max(3)
            )));
        }
        if points.is_empty() && columns[0].parse::<f64>().is_err() {
            axes = find_axes(&columns).map_err(refused)?;
            continue;
        }
        let mut position = Vector3::zeros();
        for (coordinate, &axis) in position.iter_mut().zip(&axes) {
            *coordinate = columns[axis]
                .parse()
                .map_err(|_| refused(format!("{:?} is no number", columns[axis])))?;
        }
        points.push(position);
    }
    Ok(PointCloud::from_points(points))
}

fn find_axes(names: &[&str]) -> Result<[usize; 3], String> {
    let find = |axis: &str| {
        names
            .iter()
            .position(|name| name.trim_matches('"').eq_ignore_ascii_case(axis))
            .ok_or_else(|| {
                format!("expected numbers, or names of columns with x, y, z, got {names:?}")
            })
    };
    Ok([find("x")?, find("y")?, find("z")?])
}

/// One point a line, `x y z`.
pub(super) fn format(cloud: &PointCloud) -> Vec<u8> {
    let mut text = String::new();
    for point in &cloud.points {
        writeln!(text, "{} {} {}", point.x, point.y, point.z)
            .expect("writing to a string does not fail");
    }
    text.into_bytes()
}

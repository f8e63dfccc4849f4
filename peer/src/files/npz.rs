//! Archives of NumPy (`numpy.savez`, `numpy.savez_compressed`) as clouds.
//!
//! Points are the array `xyz`, `points` or `positions`, or else the only one of three floating
//! columns. Descriptors are the only array of bytes with 32 or 128 columns, whatever its name.
//! Colours are `rgb` or `colors`, in bytes. Other arrays are skipped.

mod npy;
mod zip;

use nalgebra::Vector3;
use registration::Descriptors;

use super::error::Refused;
use super::point_cloud::{PointCloud, typed_descriptors};
use npy::Array;

const POINT_NAMES: [&str; 3] = ["xyz", "points", "positions"];
const COLOR_NAMES: [&str; 2] = ["rgb", "colors"];
/// Bytes of a binary descriptor and of a gradient histogram.
const DESCRIPTOR_SIZES: [usize; 2] = [32, 128];

/// Reads a whole file.
pub(super) fn parse(bytes: &[u8]) -> Result<PointCloud, Refused> {
    let mut arrays = Vec::new();
    for member in zip::members(bytes).map_err(Refused::whole)? {
        let Some(name) = member.name.strip_suffix(".npy") else {
            continue;
        };
        let refused = |reason: String| Refused::whole(format!("array {name:?}: {reason}"));
        let content = member.content(bytes).map_err(refused)?;
        if let Some(array) = Array::parse(&content).map_err(refused)? {
            arrays.push((name.to_owned(), array));
        }
    }
    let points = find_points(&arrays)?;
    let point_count = points.row_count();
    let descriptors = find_descriptors(&arrays, point_count)?;
    let colors = COLOR_NAMES
        .iter()
        .find_map(|name| named(&arrays, name))
        .filter(|array| array.is_bytes() && array.has_shape(point_count, 3));
    let floats = |row: usize| std::array::from_fn(|axis| points.value(row, axis));
    Ok(PointCloud {
        points: (0..point_count)
            .map(|row| Vector3::from(floats(row)))
            .collect(),
        colors: colors.map(|array| {
            let color = |row| std::array::from_fn(|channel| array.value(row, channel) as u8);
            (0..point_count).map(color).collect()
        }),
        descriptors,
    })
}

type Named = (String, Array);

fn named<'a>(arrays: &'a [Named], wanted: &str) -> Option<&'a Array> {
    let found = arrays.iter().find(|(name, _)| name == wanted);
    found.map(|(_, array)| array)
}

fn find_points(arrays: &[Named]) -> Result<&Array, Refused> {
    let is_points = |array: &Array| array.column_count() == Some(3);
    for name in POINT_NAMES {
        match named(arrays, name) {
            Some(array) if is_points(array) => return Ok(array),
            Some(array) => {
                let shape = array.shape();
                let reason = format!("array {name:?} has shape {shape:?}, expected (points, 3)");
                return Err(Refused::whole(reason));
            }
            None => {}
        }
    }
    let unnamed = arrays
        .iter()
        .filter(|(_, array)| is_points(array) && array.is_floating());
    only(unnamed.collect())
        .map_err(|names| format!("several arrays may be the points: {names}; name one `xyz`"))
        .and_then(|found| {
            found.ok_or_else(|| {
                let names: Vec<&str> = arrays.iter().map(|(name, _)| name.as_str()).collect();
                format!("no array `xyz` of shape (points, 3) among {names:?}")
            })
        })
        .map_err(Refused::whole)
}

fn find_descriptors(arrays: &[Named], point_count: usize) -> Result<Descriptors, Refused> {
    let is_descriptors = |array: &Array| {
        array.is_bytes()
            && array
                .column_count()
                .is_some_and(|count| DESCRIPTOR_SIZES.contains(&count))
    };
    let found = arrays.iter().filter(|(_, array)| is_descriptors(array));
    let found = only(found.collect())
        .map_err(|names| format!("several arrays may be the descriptors: {names}; keep one"))
        .map_err(Refused::whole)?;
    let Some(array) = found else {
        return Ok(Descriptors::None);
    };
    let row_count = array.row_count();
    if row_count != point_count {
        let reason = format!("{row_count} descriptors for {point_count} points");
        return Err(Refused::whole(reason));
    }
    let column_count = array.column_count().unwrap_or(0);
    let rows = (0..row_count).map(|row| {
        (0..column_count)
            .map(|column| array.value(row, column) as u8)
            .collect()
    });
    typed_descriptors(rows.collect())
}

/// The only one, or the names of all.
fn only(found: Vec<&Named>) -> Result<Option<&Array>, String> {
    match found.as_slice() {
        [] => Ok(None),
        [(_, array)] => Ok(Some(array)),
        several => {
            let names: Vec<&str> = several.iter().map(|(name, _)| name.as_str()).collect();
            Err(names.join(", "))
        }
    }
}

#[cfg(test)]
mod tests;

//! Parts that several wire forms share, and the checks of what comes in.

use std::fmt;
use std::marker::PhantomData;

use geodesy::{Datum, Geodetic};
use geometry::{Matrix7, Similarity};
use nalgebra::{Matrix6, Quaternion, SMatrix, UnitQuaternion, Vector3};
use serde::de::{Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crate::arrays::{self, Float64Array};
use crate::{ChunkNumber, MapId, Ranges, VehicleId};

/// How many runs of chunk numbers a message carries at most; older runs are left out.
pub(crate) const RUN_COUNT_MAX: usize = 4096;

/// How many sources a registered map names at most; one that rests on more is not published.
pub const PROVENANCE_COUNT_MAX: usize = 64;

/// How a map came to its global position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reference {
    /// From position fixes of its own.
    #[default]
    Fixed,
    /// From registration against the maps named in `provenance`: never independent evidence.
    Registered,
}

impl fmt::Display for Reference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fixed => "fixed",
            Self::Registered => "registered",
        })
    }
}

impl Reference {
    /// Whether it has a vote on where the Earth is.
    pub fn is_fixed(&self) -> bool {
        *self == Self::Fixed
    }
}

/// `s`, quaternion `x, y, z, w`, translation.
pub(crate) type SimilarityWire = [f64; 8];

pub(crate) fn similarity_to_wire<T, S>(similarity: &Similarity<T, S>) -> SimilarityWire {
    let (q, t) = (similarity.rotation(), similarity.translation());
    [similarity.scale(), q.i, q.j, q.k, q.w, t.x, t.y, t.z]
}

pub(crate) fn similarity_from_wire<T, S>(
    [s, qx, qy, qz, qw, tx, ty, tz]: SimilarityWire,
) -> Result<Similarity<T, S>, String> {
    // Wide enough for any map of vehicles on this planet, and far from overflow.
    if !(1e-6..=1e6).contains(&s) {
        return Err(format!("a scale of {s}, expected 1e-6 to 1e6"));
    }
    let translation = point_from_wire([tx, ty, tz])?;
    Ok(Similarity::new(
        s,
        rotation_from_wire([qx, qy, qz, qw])?,
        translation,
    ))
}

pub(crate) fn rotation_from_wire([x, y, z, w]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if norm.is_nan() || (norm - 1.0).abs() > 1e-3 {
        return Err(format!("a quaternion of length {norm}, expected 1"));
    }
    // An exact unit keeps its bits, so that a message survives the round trip unchanged.
    if (norm - 1.0).abs() < 1e-12 {
        return Ok(UnitQuaternion::new_unchecked(quaternion));
    }
    Ok(UnitQuaternion::new_normalize(quaternion))
}

pub(crate) fn point_from_wire(point: [f64; 3]) -> Result<Vector3<f64>, String> {
    if point.iter().all(|value| value.abs() <= 1e9) {
        return Ok(Vector3::from(point));
    }
    Err(format!(
        "a position of {point:?}, expected at most 1e9 in each axis"
    ))
}

pub(crate) fn covariance7_from_wire(array: &Float64Array) -> Result<Matrix7, String> {
    covariance_from_wire::<7>(array)
}

pub(crate) fn covariance6_from_wire(array: &Float64Array) -> Result<Matrix6<f64>, String> {
    covariance_from_wire::<6>(array)
}

/// Row-major; finite, symmetric, no negative variance along any axis or pair of axes.
fn covariance_from_wire<const N: usize>(
    array: &Float64Array,
) -> Result<SMatrix<f64, N, N>, String> {
    let values = arrays::to_f64(array)?;
    if values.len() != N * N {
        return Err(format!(
            "a covariance of {} numbers, expected {}",
            values.len(),
            N * N
        ));
    }
    let matrix = SMatrix::<f64, N, N>::from_row_slice(&values);
    if !matrix.iter().all(|value| value.abs() <= 1e18) {
        return Err("a covariance that is not finite".to_owned());
    }
    let symmetric = |row: usize, column: usize| {
        let bound = (matrix[(row, row)] * matrix[(column, column)])
            .max(0.0)
            .sqrt();
        (matrix[(row, column)] - matrix[(column, row)]).abs() <= 1e-9 * bound + 1e-15
    };
    if !(0..N).all(|row| (0..row).all(|column| symmetric(row, column))) {
        return Err("a covariance that is not symmetric".to_owned());
    }
    if !positive_semidefinite(&matrix) {
        return Err("a covariance with a negative variance in some direction".to_owned());
    }
    Ok(matrix)
}

/// Whether the Cholesky decomposition of the correlations exists, a millionth of slack included.
fn positive_semidefinite<const N: usize>(matrix: &SMatrix<f64, N, N>) -> bool {
    let sigma: [f64; N] = std::array::from_fn(|axis| matrix[(axis, axis)].max(0.0).sqrt());
    let mut factor = SMatrix::<f64, N, N>::zeros();
    for row in 0..N {
        for column in 0..=row {
            let scale = sigma[row] * sigma[column];
            let value = matrix[(row, column)];
            let correlation = if scale > 0.0 {
                value / scale
            } else {
                value * 1e15
            };
            let known: f64 = (0..column)
                .map(|k| factor[(row, k)] * factor[(column, k)])
                .sum();
            let rest = correlation - known;
            if row != column {
                factor[(row, column)] = rest / factor[(column, column)];
            } else if rest + 1e-6 > 0.0 {
                factor[(row, row)] = (rest + 1e-6).sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

pub(crate) fn covariance_to_wire<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Float64Array {
    arrays::from_f64(matrix.transpose().iter().copied())
}

/// A datum: `["wgs84", latitude_deg, longitude_deg, height_m]` or `["site", name]`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum DatumWire {
    Wgs84(Wgs84Tag, f64, f64, f64),
    Site(SiteTag, String),
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) enum Wgs84Tag {
    #[serde(rename = "wgs84")]
    Wgs84,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) enum SiteTag {
    #[serde(rename = "site")]
    Site,
}

pub(crate) fn datum_to_wire(datum: &Datum) -> DatumWire {
    match datum {
        Datum::Wgs84(origin) => DatumWire::Wgs84(
            Wgs84Tag::Wgs84,
            origin.latitude_deg(),
            origin.longitude_deg(),
            origin.height_m(),
        ),
        Datum::Site(name) => DatumWire::Site(SiteTag::Site, name.as_str().to_owned()),
    }
}

pub(crate) fn datum_from_wire(wire: &DatumWire) -> Result<Datum, String> {
    let datum = match wire {
        DatumWire::Wgs84(_, latitude, longitude, height) => {
            Geodetic::from_degrees(*latitude, *longitude, *height).map(Datum::Wgs84)
        }
        DatumWire::Site(_, name) => Datum::site(name),
    };
    datum.map_err(|error| error.to_string())
}

pub(crate) fn map_from_wire(anchor: &str, epoch: &str) -> Result<MapId, String> {
    Ok(MapId {
        anchor: VehicleId::new(anchor).map_err(|error| error.to_string())?,
        epoch: epoch
            .parse()
            .map_err(|error: crate::IdError| error.to_string())?,
    })
}

pub(crate) fn vehicles_from_wire(names: &[String]) -> Result<Vec<VehicleId>, String> {
    let parse = |name: &String| VehicleId::new(name).map_err(|error| error.to_string());
    names.iter().map(parse).collect()
}

pub(crate) fn names(vehicles: &[VehicleId]) -> Vec<String> {
    vehicles.iter().map(VehicleId::to_string).collect()
}

/// First and last of each run, flat: `[0, 41, 43, 50]`.
pub(crate) fn ranges_to_wire(ranges: &Ranges) -> Vec<u32> {
    let skipped = ranges.run_count().saturating_sub(RUN_COUNT_MAX);
    let runs = ranges.runs().skip(skipped);
    runs.flat_map(|(first, last)| [first.0, last.0]).collect()
}

pub(crate) fn ranges_from_wire(flat: &[u32]) -> Result<Ranges, String> {
    let (pairs, rest) = flat.as_chunks::<2>();
    let mut ranges = Ranges::new();
    let mut end: Option<u32> = None;
    for &[first, last] in pairs {
        let ascending = end.is_none_or(|end| end < first && end + 1 < first);
        if !ascending || last < first {
            return Err(format!("a run from {first} to {last} out of order"));
        }
        end = Some(last);
        ranges.insert_run(ChunkNumber(first), ChunkNumber(last));
    }
    if rest.is_empty() {
        return Ok(ranges);
    }
    Err("a run without an end".to_owned())
}

/// Reads a list of at most `MAX` items without trusting the length that it states.
pub(crate) fn list<'de, D, T, const MAX: usize>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct ListVisitor<T, const MAX: usize>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>, const MAX: usize> Visitor<'de> for ListVisitor<T, MAX> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a list of at most {MAX} items")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Vec<T>, A::Error> {
            let mut list = Vec::new();
            while let Some(item) = items.next_element()? {
                if list.len() == MAX {
                    return Err(serde::de::Error::invalid_length(MAX + 1, &self));
                }
                list.push(item);
            }
            Ok(list)
        }
    }

    deserializer.deserialize_seq(ListVisitor::<T, MAX>(PhantomData))
}

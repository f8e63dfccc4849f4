//! The keys under which messages travel: printed, parsed, refused with a reason.
//!
//! The one table of the key space; everything that names a key goes through [`Key`].

use std::fmt;
use std::str::FromStr;

use crate::ids::{decimal, start};
use crate::{ChunkId, ChunkNumber, Epoch, IdError, MapId, VehicleId};

/// What every vehicle's one queryable for maps is declared on.
pub const MAP_QUERYABLE: &str = "anchor/*/map/**";
/// What every vehicle's one queryable for placements is declared on.
pub const PLACEMENT_QUERYABLE: &str = "anchor/*/placement/**";
/// All manifests: the question that lists maps.
pub const ALL_MANIFESTS: &str = "anchor/*/map";
/// All chunks, without manifests.
pub const ALL_CHUNKS: &str = "anchor/*/map/*/*";
/// All placements and placement pages.
pub const ALL_PLACEMENTS: &str = "anchor/*/placement/**";
/// All beacons.
pub const ALL_HAVES: &str = "vehicle/*/have";
/// All poses.
pub const ALL_POSES: &str = "vehicle/*/pose";
/// All liveliness tokens.
pub const ALL_ALIVE: &str = "vehicle/*/alive";

/// One concrete key.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// `anchor/{id}/map`: the manifest.
    Manifest(VehicleId),
    /// `anchor/{id}/map/{epoch}/{n}`: a chunk.
    Chunk(ChunkId),
    /// `anchor/{id}/placement/{epoch}`: where a map stands.
    Placement(MapId),
    /// `anchor/{id}/placement/{epoch}/{page}`: where 256 chunks stand in their map.
    PlacementPage(MapId, u32),
    /// `vehicle/{holder}/chunk/{anchor}/{epoch}/{n}`: a chunk from one holder alone.
    HeldChunk(VehicleId, ChunkId),
    /// `vehicle/{id}/have`: the beacon.
    Have(VehicleId),
    /// `vehicle/{id}/pose`: the pose.
    Pose(VehicleId),
    /// `vehicle/{id}/alive`: the liveliness token.
    Alive(VehicleId),
}

/// Why a text is no key of ours.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// No key has this shape.
    #[error("no key has the shape of {got:?}")]
    Shape {
        /// The text, at most its first 40 characters.
        got: String,
    },
    /// The shape fits but a part does not.
    #[error("{id}, in the key {got:?}")]
    Id {
        /// What is wrong with the part.
        id: IdError,
        /// The text, at most its first 40 characters.
        got: String,
    },
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Manifest(anchor) => write!(f, "anchor/{anchor}/map"),
            Self::Chunk(ChunkId { map, number }) => {
                write!(f, "anchor/{}/map/{}/{number}", map.anchor, map.epoch)
            }
            Self::Placement(map) => write!(f, "anchor/{}/placement/{}", map.anchor, map.epoch),
            Self::PlacementPage(map, page) => {
                write!(f, "anchor/{}/placement/{}/{page}", map.anchor, map.epoch)
            }
            Self::HeldChunk(holder, chunk) => write!(f, "vehicle/{holder}/chunk/{chunk}"),
            Self::Have(vehicle) => write!(f, "vehicle/{vehicle}/have"),
            Self::Pose(vehicle) => write!(f, "vehicle/{vehicle}/pose"),
            Self::Alive(vehicle) => write!(f, "vehicle/{vehicle}/alive"),
        }
    }
}

impl FromStr for Key {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        let shape = || KeyError::Shape { got: start(text) };
        if text.len() > 256 {
            return Err(shape());
        }
        let parts: Vec<&str> = text.split('/').collect();
        parse_parts(&parts)
            .ok_or_else(shape)?
            .map_err(|id| KeyError::Id {
                id,
                got: start(text),
            })
    }
}

fn parse_parts(parts: &[&str]) -> Option<Result<Key, IdError>> {
    let key = match *parts {
        ["anchor", anchor, "map"] => VehicleId::new(anchor).map(Key::Manifest),
        ["anchor", anchor, "map", epoch, number] => chunk(anchor, epoch, number).map(Key::Chunk),
        ["anchor", anchor, "placement", epoch] => map(anchor, epoch).map(Key::Placement),
        ["anchor", anchor, "placement", epoch, page] => map(anchor, epoch).and_then(|map| {
            let number: ChunkNumber = page.parse()?;
            Ok(Key::PlacementPage(map, number.0))
        }),
        ["vehicle", holder, "chunk", anchor, epoch, number] => VehicleId::new(holder)
            .and_then(|holder| Ok(Key::HeldChunk(holder, chunk(anchor, epoch, number)?))),
        ["vehicle", vehicle, "have"] => VehicleId::new(vehicle).map(Key::Have),
        ["vehicle", vehicle, "pose"] => VehicleId::new(vehicle).map(Key::Pose),
        ["vehicle", vehicle, "alive"] => VehicleId::new(vehicle).map(Key::Alive),
        _ => return None,
    };
    Some(key)
}

fn map(anchor: &str, epoch: &str) -> Result<MapId, IdError> {
    Ok(MapId {
        anchor: VehicleId::new(anchor)?,
        epoch: epoch.parse()?,
    })
}

fn chunk(anchor: &str, epoch: &str, number: &str) -> Result<ChunkId, IdError> {
    Ok(ChunkId {
        map: map(anchor, epoch)?,
        number: number.parse()?,
    })
}

/// What a question about maps is limited to: `?bbox=…;since=…`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapParameters {
    /// Only chunks that stand in this box of the manifest's datum.
    pub area: Option<Area>,
    /// Only chunks after this one: of this epoch with a higher number, or of a newer epoch.
    pub since: Option<(Epoch, ChunkNumber)>,
}

/// A horizontal box (m) in the datum of the manifest that it is compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    east_min_m: f64,
    north_min_m: f64,
    east_max_m: f64,
    north_max_m: f64,
}

/// Why a question's parameters are refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParameterError {
    /// The box is malformed.
    #[error("bbox is east_min,north_min,east_max,north_max in metres, got {got:?}")]
    Area {
        /// The value, at most its first 40 characters.
        got: String,
    },
    /// The lower limit is malformed.
    #[error("since is {{epoch}}:{{n}}, got {got:?}")]
    Since {
        /// The value, at most its first 40 characters.
        got: String,
    },
}

impl MapParameters {
    /// Parses zenoh's parameter text (`name=value;name=value`); unknown names are for others.
    pub fn parse(text: &str) -> Result<Self, ParameterError> {
        let mut parameters = Self::default();
        for part in text.split(';') {
            match part.split_once('=') {
                Some(("bbox", value)) => parameters.area = Some(parse_area(value)?),
                Some(("since", value)) => parameters.since = Some(parse_since(value)?),
                _ => {}
            }
        }
        Ok(parameters)
    }

    /// Whether `chunk` comes after the `since` that was asked for.
    pub fn admits_number(&self, epoch: Epoch, number: ChunkNumber) -> bool {
        self.since.is_none_or(|since| (epoch, number) > since)
    }

    /// Whether a box overlaps the area that was asked for.
    pub fn admits_area(&self, min: (f64, f64), max: (f64, f64)) -> bool {
        self.area.is_none_or(|area| {
            min.0 <= area.east_max_m
                && max.0 >= area.east_min_m
                && min.1 <= area.north_max_m
                && max.1 >= area.north_min_m
        })
    }
}

impl fmt::Display for MapParameters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(area) = &self.area {
            let (east, north) = (area.east_min_m, area.north_min_m);
            write!(
                f,
                "bbox={east},{north},{},{}",
                area.east_max_m, area.north_max_m
            )?;
        }
        if let Some((epoch, number)) = self.since {
            let separator = if self.area.is_some() { ";" } else { "" };
            write!(f, "{separator}since={epoch}:{number}")?;
        }
        Ok(())
    }
}

impl Area {
    /// The box between two corners `(east, north)` (m); `None` if not finite or turned inside out.
    pub fn new(min: (f64, f64), max: (f64, f64)) -> Option<Self> {
        let finite = [min.0, min.1, max.0, max.1].iter().all(|v| v.is_finite());
        (finite && min.0 <= max.0 && min.1 <= max.1).then_some(Self {
            east_min_m: min.0,
            north_min_m: min.1,
            east_max_m: max.0,
            north_max_m: max.1,
        })
    }
}

fn parse_area(value: &str) -> Result<Area, ParameterError> {
    let refuse = || ParameterError::Area { got: start(value) };
    let numbers: Option<Vec<f64>> = value.splitn(5, ',').map(|n| n.parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[east_min, north_min, east_max, north_max]) => {
            Area::new((east_min, north_min), (east_max, north_max)).ok_or_else(refuse)
        }
        _ => Err(refuse()),
    }
}

fn parse_since(value: &str) -> Result<(Epoch, ChunkNumber), ParameterError> {
    let refuse = || ParameterError::Since { got: start(value) };
    let (epoch, number) = value.split_once(':').ok_or_else(refuse)?;
    let number = decimal(number).ok_or_else(refuse)?;
    Ok((epoch.parse().map_err(|_| refuse())?, ChunkNumber(number)))
}

#[cfg(test)]
mod tests;

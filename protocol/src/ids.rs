//! Names of vehicles, maps and chunks.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// How many chunks share one placement page.
pub const CHUNKS_PER_PAGE: u32 = 256;

/// Why a text is no id.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IdError {
    /// The text is no vehicle id.
    #[error("a vehicle id has 1 to 32 letters, digits, '-', '_' or '.', got {got:?}")]
    Vehicle {
        /// The text, at most its first 40 characters.
        got: String,
    },
    /// The text is no epoch.
    #[error("an epoch is a counter, '-' and 8 lower-case hex digits, got {got:?}")]
    Epoch {
        /// The text, at most its first 40 characters.
        got: String,
    },
    /// The text is no chunk number.
    #[error("a chunk number is a decimal without leading zeros below 2^32, got {got:?}")]
    Number {
        /// The text, at most its first 40 characters.
        got: String,
    },
}

/// A vehicle's name in the team: 1 to 32 ASCII letters, digits, `-`, `_` or `.`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VehicleId(Arc<str>);

impl VehicleId {
    /// The id with this text, or why it is none.
    pub fn new(text: &str) -> Result<Self, IdError> {
        let legal = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
        if text.is_empty() || text.len() > 32 || !text.bytes().all(legal) {
            return Err(IdError::Vehicle { got: start(text) });
        }
        Ok(Self(text.into()))
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for VehicleId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for VehicleId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VehicleId({})", self.0)
    }
}

impl FromStr for VehicleId {
    type Err = IdError;

    fn from_str(text: &str) -> Result<Self, IdError> {
        Self::new(text)
    }
}

/// One life of an anchor's map, printed `{counter}-{8 hex}`. The higher counter is the newer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Epoch {
    /// One above the highest known when the map was started.
    pub counter: u32,
    /// Random, so that two starts with the same counter differ.
    pub random: u32,
}

impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{:08x}", self.counter, self.random)
    }
}

impl FromStr for Epoch {
    type Err = IdError;

    fn from_str(text: &str) -> Result<Self, IdError> {
        let refuse = || IdError::Epoch { got: start(text) };
        let (counter, random) = text.split_once('-').ok_or_else(refuse)?;
        let hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        if random.len() != 8 || !random.bytes().all(hex) {
            return Err(refuse());
        }
        Ok(Self {
            counter: decimal(counter).ok_or_else(refuse)?,
            random: u32::from_str_radix(random, 16).map_err(|_| refuse())?,
        })
    }
}

/// The number of a chunk within its map's epoch, counted from zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChunkNumber(pub u32);

impl ChunkNumber {
    /// The placement page that says where this chunk stands.
    pub fn page(self) -> u32 {
        self.0 / CHUNKS_PER_PAGE
    }
}

impl fmt::Display for ChunkNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl FromStr for ChunkNumber {
    type Err = IdError;

    fn from_str(text: &str) -> Result<Self, IdError> {
        decimal(text)
            .map(Self)
            .ok_or_else(|| IdError::Number { got: start(text) })
    }
}

/// One map: an anchor's, in one epoch.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MapId {
    /// Whose map it is.
    pub anchor: VehicleId,
    /// Which life of it.
    pub epoch: Epoch,
}

impl fmt::Display for MapId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.anchor, self.epoch)
    }
}

/// One chunk, printed `{anchor}/{epoch}/{number}`. Its bytes never change.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChunkId {
    /// The map that it is part of.
    pub map: MapId,
    /// Its number in the map.
    pub number: ChunkNumber,
}

impl fmt::Display for ChunkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.map, self.number)
    }
}

/// A `u32` in its one canonical decimal form.
pub(crate) fn decimal(text: &str) -> Option<u32> {
    let canonical = text == "0" || !text.starts_with('0');
    let digits = !text.is_empty() && text.len() <= 10 && text.bytes().all(|b| b.is_ascii_digit());
    if canonical && digits {
        text.parse().ok()
    } else {
        None
    }
}

/// The start of a foreign text, short enough for a message.
pub(crate) fn start(text: &str) -> String {
    text.chars().take(40).collect()
}

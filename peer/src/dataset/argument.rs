//! How a recording, or a part of one, is named on the command line.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Half-open frame numbers `A..B`; either end may be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRange {
    pub start: usize,
    pub end: Option<usize>,
}

/// A text is no frame range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{got:?} is no frame range; expected A..B with A < B")]
pub struct MalformedRange {
    pub got: String,
}

/// A file or folder, and which of its frames: `DATASET` or `DATASET@A..B`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatasetArgument {
    pub path: PathBuf,
    pub range: Option<FrameRange>,
}

impl FrameRange {
    pub fn contains(&self, frame_idx: usize) -> bool {
        frame_idx >= self.start && self.end.is_none_or(|end| frame_idx < end)
    }
}

impl FromStr for FrameRange {
    type Err = MalformedRange;

    fn from_str(text: &str) -> Result<Self, MalformedRange> {
        let malformed = || MalformedRange {
            got: text.to_owned(),
        };
        let (start, end) = text.split_once("..").ok_or_else(malformed)?;
        let number = |digits: &str| digits.parse::<usize>().map_err(|_| malformed());
        let range = Self {
            start: if start.is_empty() { 0 } else { number(start)? },
            end: if end.is_empty() {
                None
            } else {
                Some(number(end)?)
            },
        };
        if range.end.is_some_and(|end| end <= range.start) {
            return Err(malformed());
        }
        Ok(range)
    }
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.end {
            Some(end) => write!(f, "{}..{end}", self.start),
            None => write!(f, "{}..", self.start),
        }
    }
}

impl FromStr for DatasetArgument {
    type Err = MalformedRange;

    fn from_str(text: &str) -> Result<Self, MalformedRange> {
        // A name may hold an `@`; only what looks like a range is taken as one.
        if let Some((path, range)) = text.rsplit_once('@')
            && range.contains("..")
            && !range.contains(std::path::MAIN_SEPARATOR)
        {
            return Ok(Self {
                path: path.into(),
                range: Some(range.parse()?),
            });
        }
        Ok(Self {
            path: text.into(),
            range: None,
        })
    }
}

impl fmt::Display for DatasetArgument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.range {
            Some(range) => write!(f, "{}@{range}", self.path.display()),
            None => write!(f, "{}", self.path.display()),
        }
    }
}

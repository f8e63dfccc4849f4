//! What is wrong with a file, and where.

use std::path::{Path, PathBuf};

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

/// What is wrong with a file's content, and in which line, before the path is known.
#[derive(Debug, PartialEq)]
pub(super) struct Refused {
    reason: String,
    line: Option<usize>,
}

impl Refused {
    pub fn whole(reason: impl Into<String>) -> Self {
        Self {
            reason: reason.into(),
            line: None,
        }
    }

    /// - `line`: counted from one.
    pub fn at(line: usize, reason: impl Into<String>) -> Self {
        Self {
            reason: reason.into(),
            line: Some(line),
        }
    }

    pub fn into_error(self, path: &Path) -> FileError {
        let path = path.to_owned();
        let reason = self.reason;
        match self.line {
            Some(line) => FileError::Line { reason, path, line },
            None => FileError::Content { reason, path },
        }
    }
}

//! A child process that says JSON, a line each, and does not outlive its owner.

use std::io::{BufRead, BufReader, Read};
use std::ops::{Deref, DerefMut};
use std::process::Child;

use serde::de::DeserializeOwned;

/// A child that is killed when this is dropped, if it still runs.
pub struct OwnedChild(pub Child);

impl Deref for OwnedChild {
    type Target = Child;

    fn deref(&self) -> &Child {
        &self.0
    }
}

impl DerefMut for OwnedChild {
    fn deref_mut(&mut self) -> &mut Child {
        &mut self.0
    }
}

impl Drop for OwnedChild {
    fn drop(&mut self) {
        if !matches!(self.try_wait(), Ok(Some(_))) {
            // It may have ended in this moment.
            let _ = self.kill();
            let _ = self.wait();
        }
    }
}

/// Reads until the child closes its pipe, or nobody wants more.
///
/// - `take`: false if it is the last that is wanted.
pub fn read_json_lines<T: DeserializeOwned>(said: impl Read, mut take: impl FnMut(T) -> bool) {
    for line in BufReader::new(said).lines().map_while(Result::ok) {
        match serde_json::from_str(&line) {
            Ok(value) => {
                if !take(value) {
                    return;
                }
            }
            Err(error) => tracing::warn!(%error, line, "a child's line ignored"),
        }
    }
}

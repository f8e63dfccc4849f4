//! What could not be written, counted.

use std::collections::BTreeSet;
use std::fmt::Display;

/// Named once for each kind, counted always.
#[derive(Debug, Default)]
pub struct Loss {
    count: u64,
    named: BTreeSet<&'static str>,
}

impl Loss {
    pub fn note<E: Display>(&mut self, what: &'static str, written: Result<(), E>) {
        let Err(error) = written else { return };
        self.count();
        if self.named.insert(what) {
            tracing::error!("{what}: {error:#}; the flight goes on, more is only counted");
        }
    }

    pub fn count(&mut self) {
        self.count += 1;
    }

    pub fn total(&self) -> u64 {
        self.count
    }
}

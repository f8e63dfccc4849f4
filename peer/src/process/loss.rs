//! What could not be written, counted.

use std::collections::BTreeSet;
use std::fmt::Display;

/// Named once for each kind, counted always.
#[derive(Debug, Default)]
pub struct Loss {
    count: u64,
    named: BTreeSet<&'static str>,
    first: Option<String>,
}

impl Loss {
    pub fn note<E: Display>(&mut self, what: &'static str, written: Result<(), E>) {
        let Err(error) = written else { return };
        self.count();
        let first = || format!("{what}: {error:#}");
        self.first.get_or_insert_with(first);
        if self.named.insert(what) {
            tracing::error!("{what}: {error:#}; the flight goes on, more is only counted");
        }
    }

    pub fn count(&mut self) {
        self.count += 1;
    }

    /// Takes over what another thread has lost.
    pub fn add(&mut self, other: Self) {
        self.count += other.count;
        self.first = self.first.take().or(other.first);
    }

    /// What was lost first, and why: a log on the same disk may hold nothing of it.
    pub fn first(&self) -> Option<&str> {
        self.first.as_deref()
    }

    pub fn total(&self) -> u64 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_is_counted_and_the_first_is_kept_with_its_cause() {
        let mut loss = Loss::default();
        loss.note::<&str>("the map", Ok(()));
        assert_eq!((loss.total(), loss.first()), (0, None));
        loss.note("the recording", Err("no room"));
        loss.note("the map", Err("no folder"));
        loss.count();
        assert_eq!(
            (loss.total(), loss.first()),
            (3, Some("the recording: no room"))
        );
    }
}

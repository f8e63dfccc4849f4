//! Time as integer nanoseconds: exact, ordered, and printed without rounding.

use std::fmt;
use std::ops::Sub;
use std::time::Duration;

/// An instant on one vehicle's clock, in nanoseconds since that clock's zero.
///
/// Instants of different vehicles are not comparable unless their offset is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(i64);

impl Timestamp {
    /// The instant `nanoseconds` after the clock's zero.
    pub const fn from_nanoseconds(nanoseconds: i64) -> Self {
        Self(nanoseconds)
    }

    /// The instant nearest to `seconds`, or `None` if that is not finite or beyond ±292 years.
    pub fn from_seconds(seconds: f64) -> Option<Self> {
        let nanoseconds = (seconds * 1e9).round();
        let representable = nanoseconds.is_finite() && nanoseconds.abs() < i64::MAX as f64;
        representable.then_some(Self(nanoseconds as i64))
    }

    /// Nanoseconds since the clock's zero.
    pub const fn nanoseconds(self) -> i64 {
        self.0
    }

    /// Seconds since the clock's zero, rounded to the nearest `f64`.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// The instant `duration` later, saturating at the end of the range.
    pub fn after(self, duration: Duration) -> Self {
        let nanoseconds = i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX);
        Self(self.0.saturating_add(nanoseconds))
    }

    /// How long after `earlier` this is; zero if it is not after it.
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(u64::try_from(self.0.saturating_sub(earlier.0)).unwrap_or(0))
    }
}

impl Sub for Timestamp {
    type Output = f64;

    /// The signed difference in seconds.
    fn sub(self, earlier: Self) -> f64 {
        (i128::from(self.0) - i128::from(earlier.0)) as f64 * 1e-9
    }
}

impl fmt::Display for Timestamp {
    /// Prints `seconds.nanoseconds` from integers, exactly.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let magnitude = self.0.unsigned_abs();
        write!(
            f,
            "{sign}{}.{:09}",
            magnitude / 1_000_000_000,
            magnitude % 1_000_000_000
        )
    }
}

//! How long somebody was waited for.

use std::time::{Duration, Instant};

/// Time spent waiting. A parent that was stopped itself, with its whole team or by a laptop that
/// slept, was not waiting; of any longer gap between two looks only this much counts.
const GAP_MAX: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug)]
pub struct Waited {
    total: Duration,
    looked_at: Instant,
}

impl Waited {
    pub fn from(now: Instant) -> Self {
        Self {
            total: Duration::ZERO,
            looked_at: now,
        }
    }

    /// All that was waited; to be called several times a second.
    pub fn until(&mut self, now: Instant) -> Duration {
        let gap = now.saturating_duration_since(self.looked_at);
        self.total += gap.min(GAP_MAX);
        self.looked_at = now;
        self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_in_which_the_parent_itself_stood_still_is_no_waiting() {
        let start = Instant::now();
        let at = |elapsed_ms| start + Duration::from_millis(elapsed_ms);
        let mut waited = Waited::from(start);
        assert_eq!(waited.until(at(200)), Duration::from_millis(200));
        assert_eq!(waited.until(at(400)), Duration::from_millis(400));
        assert_eq!(waited.until(at(90_400)), Duration::from_millis(1400));
        assert_eq!(waited.until(at(90_500)), Duration::from_millis(1500));
    }
}

//! Frames no faster than real time.

use std::thread;
use std::time::{Duration, Instant};

use super::Pace;

/// Lets one frame through per period. At most one period of lateness is made up for, so that a
/// vehicle that stalls slows the simulated clock and is not flooded afterwards.
pub struct Pacer {
    pace: Pace,
    period: Duration,
    next_at: Option<Instant>,
}

impl Pacer {
    pub fn new(pace: Pace, period_s: f64) -> Self {
        Self {
            pace,
            period: Duration::from_secs_f64(period_s),
            next_at: None,
        }
    }

    /// Sleeps until the next frame is due.
    pub fn wait(&mut self) {
        let now = Instant::now();
        let due_at = self.due_at(now);
        if self.pace == Pace::RealTime {
            thread::sleep(due_at.saturating_duration_since(now));
        }
        self.next_at = Some(due_at + self.period);
    }

    fn due_at(&self, now: Instant) -> Instant {
        let earliest = now.checked_sub(self.period).unwrap_or(now);
        self.next_at.map_or(now, |next_at| next_at.max(earliest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lateness_is_made_up_for_by_one_period_at_most() {
        let now = Instant::now() + Duration::from_secs(100);
        let period = Duration::from_millis(100);
        let due_in_s = |late_s: f64| {
            let pacer = Pacer {
                pace: Pace::RealTime,
                period,
                next_at: Some(now - Duration::from_secs_f64(late_s)),
            };
            pacer.due_at(now).duration_since(now - period).as_secs_f64() - 0.1
        };
        assert!((due_in_s(0.03) + 0.03).abs() < 1e-6);
        assert!((due_in_s(0.1) + 0.1).abs() < 1e-6);
        assert!((due_in_s(5.0) + 0.1).abs() < 1e-6);
    }
}

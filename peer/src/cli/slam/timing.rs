//! How long frames take.

use std::time::{Duration, Instant};

/// When what happened to a frame.
pub struct Timing {
    /// Its image was there, decoded; at real time it was due.
    pub came_at: Instant,
    /// Its keypoints were found.
    pub found_at: Instant,
    /// The map had grown by the frames before.
    pub taken_at: Instant,
    pub posed_at: Instant,
}

/// Times of all frames.
#[derive(Default)]
pub struct Times {
    /// Whether frames are taken up ahead, by a thread that has nothing else to do: what they wait
    /// then says nothing about their poses. At real time all that a frame waits for delays its
    /// pose, and one thread never lets it wait.
    pub is_ahead: bool,
    per_frame: Vec<Duration>,
    waiting: Vec<Duration>,
}

impl Times {
    pub fn push(&mut self, timing: &Timing) {
        let whole = timing.posed_at - timing.came_at;
        let waited = timing.taken_at - timing.found_at;
        if self.is_ahead {
            self.per_frame.push(whole.saturating_sub(waited));
            self.waiting.push(waited);
        } else {
            self.per_frame.push(whole);
        }
    }

    /// From an image to its pose.
    pub fn per_frame_ms(&self, share: f64) -> Option<f64> {
        percentile_ms(&self.per_frame, share)
    }

    /// What frames waited besides; `None` if they are not taken up ahead.
    pub fn waiting_ms(&self, share: f64) -> Option<f64> {
        percentile_ms(&self.waiting, share)
    }

    #[cfg(test)]
    pub fn frame_count(&self) -> usize {
        self.per_frame.len()
    }
}

/// The nearest-rank percentile.
fn percentile_ms(durations: &[Duration], share: f64) -> Option<f64> {
    let mut sorted = durations.to_vec();
    sorted.sort();
    let rank = (share * sorted.len() as f64).ceil() as usize;
    let duration = sorted.get(rank.saturating_sub(1))?;
    Some(duration.as_secs_f64() * 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let durations: Vec<Duration> = (1..=100).rev().map(Duration::from_millis).collect();
        assert_eq!(percentile_ms(&durations, 0.50), Some(50.0));
        assert_eq!(percentile_ms(&durations, 0.99), Some(99.0));
        assert_eq!(percentile_ms(&durations[..1], 0.99), Some(100.0));
        assert_eq!(percentile_ms(&[], 0.5), None);
    }

    #[test]
    fn what_a_frame_waits_does_not_count_if_it_was_taken_up_ahead() {
        let came_at = Instant::now();
        let after = |milliseconds| came_at + Duration::from_millis(milliseconds);
        let timing = Timing {
            came_at,
            found_at: after(10),
            taken_at: after(50),
            posed_at: after(53),
        };
        for (is_ahead, per_frame_ms, waiting_ms) in
            [(true, Some(13.0), Some(40.0)), (false, Some(53.0), None)]
        {
            let mut times = Times {
                is_ahead,
                ..Times::default()
            };
            times.push(&timing);
            assert_eq!(times.per_frame_ms(0.5), per_frame_ms);
            assert_eq!(times.waiting_ms(0.5), waiting_ms);
        }
    }
}

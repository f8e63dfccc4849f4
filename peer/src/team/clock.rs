//! One clock over recordings that each have their own.

/// A moment at which at least one vehicle has a frame, since the start of all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    pub elapsed_ns: i64,
}

/// Stamps of recordings at one rate differ by rounding; within this they are one tick.
const SAME_TICK_NS: i64 = 2_000_000;

/// The ticks of all recordings, each started at its own first stamp.
pub fn ticks(recordings: &[Vec<i64>]) -> Vec<Tick> {
    let mut elapsed: Vec<i64> = Vec::new();
    for stamps in recordings {
        let first = stamps.first().copied().unwrap_or(0);
        elapsed.extend(stamps.iter().map(|stamp| stamp - first));
    }
    elapsed.sort_unstable();
    let mut ticks: Vec<Tick> = Vec::new();
    let mut first_of_tick = i64::MIN;
    for elapsed_ns in elapsed {
        match ticks.last_mut() {
            // The latest of them, so that every vehicle's frame is due.
            Some(tick) if elapsed_ns - first_of_tick <= SAME_TICK_NS => {
                tick.elapsed_ns = elapsed_ns;
            }
            _ => {
                first_of_tick = elapsed_ns;
                ticks.push(Tick { elapsed_ns });
            }
        }
    }
    ticks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_that_differ_by_rounding_are_one_tick() {
        let recordings = [
            vec![0, 33_333_000, 66_667_000],
            vec![13_333_333_000, 13_366_667_000, 13_500_000_000],
        ];
        let elapsed: Vec<i64> = ticks(&recordings)
            .iter()
            .map(|tick| tick.elapsed_ns)
            .collect();
        assert_eq!(elapsed, [0, 33_334_000, 66_667_000, 166_667_000]);
    }
}

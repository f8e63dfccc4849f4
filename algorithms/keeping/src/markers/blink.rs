//! A code that marker lights blink, so that lamps on walls are not taken for neighbours.

/// Lights that are full for a one and dimmed for a zero, in a cycle.
///
/// Dimmed, not dark: a light that is always seen is followed without gaps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlinkCode {
    bits: u32,
    bit_count: u8,
    bit_s: f64,
}

/// How bright a track was at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Brightness {
    pub time_s: f64,
    pub log_flux: f64,
}

/// How many frames are remembered.
pub(super) const HISTORY_LEN: usize = 32;
/// The clock of the lights is unknown; it is tried in steps of this share of a bit.
const PHASES_PER_BIT: usize = 4;
/// Correlation of a code with itself under noise and with frames across changes.
const CORRELATION_MIN: f64 = 0.75;
/// A dimmed light has at most this share of the full one.
const LOG_SWING_MIN: f64 = 0.15;

impl BlinkCode {
    /// `bits`, the lowest first, each `bit_s` long; at least two frames. `None` if the code has no
    /// change, or more bits than 32.
    pub fn new(bits: u32, bit_count: u8, bit_s: f64) -> Option<Self> {
        let is_code = (2..=32).contains(&bit_count) && bit_s.is_finite() && bit_s > 0.0;
        let used = bits & (u32::MAX >> (32 - u32::from(bit_count.clamp(1, 32))));
        let ones = used.count_ones();
        (is_code && ones > 0 && ones < u32::from(bit_count)).then_some(Self {
            bits: used,
            bit_count,
            bit_s,
        })
    }

    /// How long one cycle takes.
    pub fn period_s(&self) -> f64 {
        f64::from(self.bit_count) * self.bit_s
    }

    /// Whether a light is full at this time of its own clock.
    pub fn is_full(&self, time_s: f64) -> bool {
        let bit = (time_s / self.bit_s)
            .floor()
            .rem_euclid(f64::from(self.bit_count));
        self.bits >> (bit as u32).min(31) & 1 == 1
    }

    /// Whether these brightnesses blink the code, or `None` if they are too short to tell.
    pub(super) fn is_shown_by(&self, history: &[Brightness]) -> Option<bool> {
        let (first, last) = (history.first()?, history.last()?);
        let is_long = last.time_s - first.time_s >= self.period_s();
        if !is_long || history.len() < usize::from(self.bit_count) {
            return None;
        }
        let count = history.len() as f64;
        let mean = history.iter().map(|sample| sample.log_flux).sum::<f64>() / count;
        let phase_count = PHASES_PER_BIT * usize::from(self.bit_count);
        let is_shown = (0..phase_count).any(|phase| {
            let offset_s = phase as f64 / PHASES_PER_BIT as f64 * self.bit_s - first.time_s;
            self.fits(history, mean, offset_s)
        });
        Some(is_shown)
    }

    fn fits(&self, history: &[Brightness], mean: f64, offset_s: f64) -> bool {
        let expected =
            |sample: &Brightness| f64::from(u8::from(self.is_full(sample.time_s + offset_s)));
        let count = history.len() as f64;
        let share = history.iter().map(expected).sum::<f64>() / count;
        let (mut product, mut squares) = (0.0, 0.0);
        for sample in history {
            let deviation = sample.log_flux - mean;
            product += deviation * (expected(sample) - share);
            squares += deviation * deviation;
        }
        let expected_squares = count * share * (1.0 - share);
        if expected_squares <= 0.0 || squares <= 0.0 {
            return false;
        }
        let correlation = product / (squares * expected_squares).sqrt();
        let swing = product / expected_squares;
        correlation >= CORRELATION_MIN && swing >= LOG_SWING_MIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 frames a second, two frames a bit, the clock of the lights a third of a bit off.
    fn history(full: impl Fn(f64) -> bool) -> Vec<Brightness> {
        let sample = |idx: usize| {
            let time_s = 5.0 + 0.05 * idx as f64;
            let log_flux = if full(time_s + 0.033) { 6.0 } else { 5.5 };
            Brightness { time_s, log_flux }
        };
        (0..HISTORY_LEN).map(sample).collect()
    }

    #[test]
    fn only_its_own_code_is_recognised() {
        let code = BlinkCode::new(0b0001_1101, 8, 0.1).unwrap();
        let other = BlinkCode::new(0b0101_0101, 8, 0.1).unwrap();
        assert_eq!(
            code.is_shown_by(&history(|time_s| code.is_full(time_s))),
            Some(true)
        );
        assert_eq!(
            code.is_shown_by(&history(|time_s| other.is_full(time_s))),
            Some(false)
        );
        assert_eq!(code.is_shown_by(&history(|_| true)), Some(false));
        assert_eq!(code.is_shown_by(&history(|_| true)[..10]), None);
    }

    #[test]
    fn a_light_that_never_changes_is_no_code() {
        for bits in [0, 0b1111, 0b1111_0000] {
            assert_eq!(BlinkCode::new(bits, 4, 0.1), None);
        }
        assert_eq!(BlinkCode::new(1, 33, 0.1), None);
        assert_eq!(BlinkCode::new(1, 4, f64::NAN), None);
    }
}

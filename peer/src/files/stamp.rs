//! Time stamps as text.

use geometry::Timestamp;

/// Reads decimal seconds exactly, digit by digit; digits beyond nanoseconds are cut off.
///
/// Also takes an exponent, as some tools print it, through `f64` and so to about 0.1 µs.
pub fn parse_seconds(text: &str) -> Option<Timestamp> {
    let text = text.trim();
    if text.contains(['e', 'E']) {
        return Timestamp::from_seconds(text.parse().ok()?);
    }
    let (magnitude, sign) = match text.strip_prefix('-') {
        Some(magnitude) => (magnitude, -1),
        None => (text, 1),
    };
    let (whole, fraction) = magnitude.split_once('.').unwrap_or((magnitude, ""));
    let is_number = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_digit());
    if (whole.is_empty() && fraction.is_empty()) || !is_number(whole) || !is_number(fraction) {
        return None;
    }
    let seconds: i64 = if whole.is_empty() {
        0
    } else {
        whole.parse().ok()?
    };
    let mut nanoseconds = 0_i64;
    for place in 0..9 {
        let digit = fraction.as_bytes().get(place).map_or(0, |byte| byte - b'0');
        nanoseconds = nanoseconds * 10 + i64::from(digit);
    }
    let total = seconds
        .checked_mul(1_000_000_000)?
        .checked_add(nanoseconds)?;
    Some(Timestamp::from_nanoseconds(sign * total))
}

//! When a link is cut, and how.

use std::str::FromStr;

use sim::Cut;

/// Half-open seconds since the start in which links are cut.
#[derive(Clone, Debug, PartialEq)]
pub struct Outage {
    /// Whose links; all if absent.
    pub vehicle: Option<String>,
    pub start_s: f64,
    pub end_s: f64,
    pub cut: Cut,
}

/// A text is no outage.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{got:?} is no outage; expected [VEHICLE:]A..B in seconds with A < B")]
pub struct MalformedOutage {
    pub got: String,
}

impl Outage {
    pub fn applies(&self, elapsed_s: f64) -> bool {
        elapsed_s >= self.start_s && elapsed_s < self.end_s
    }

    /// Whether a link between these two is cut by it.
    pub fn concerns(&self, ids: [&str; 2]) -> bool {
        self.vehicle
            .as_deref()
            .is_none_or(|vehicle| ids.contains(&vehicle))
    }
}

impl FromStr for Outage {
    type Err = MalformedOutage;

    /// Links break as by a reset; whoever wants silence sets `cut`.
    fn from_str(text: &str) -> Result<Self, MalformedOutage> {
        let malformed = || MalformedOutage {
            got: text.to_owned(),
        };
        let (vehicle, range) = match text.split_once(':') {
            Some((vehicle, range)) => (Some(vehicle.to_owned()), range),
            None => (None, text),
        };
        let (start, end) = range.split_once("..").ok_or_else(malformed)?;
        let seconds = |text: &str| {
            text.parse::<f64>()
                .ok()
                .filter(|s| s.is_finite() && *s >= 0.0)
        };
        let start_s = seconds(start).ok_or_else(malformed)?;
        let end_s = seconds(end).ok_or_else(malformed)?;
        if start_s >= end_s || vehicle.as_deref() == Some("") {
            return Err(malformed());
        }
        Ok(Self {
            vehicle,
            start_s,
            end_s,
            cut: Cut::Reset,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_whose_links_and_when() {
        let outage: Outage = "peer1:5..12.5".parse().unwrap();
        assert!(outage.concerns(["anchor1", "peer1"]) && !outage.concerns(["anchor1", "peer2"]));
        assert!(outage.applies(5.0) && !outage.applies(12.5));
        let everybody: Outage = "0..1".parse().unwrap();
        assert!(everybody.concerns(["a", "b"]));
        for text in ["", "5", "5..", "7..5", "a:..3", ":1..2", "nan..3", "-1..3"] {
            assert!(text.parse::<Outage>().is_err(), "{text}");
        }
    }
}

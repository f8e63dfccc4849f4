//! The paper's rule, exactly: sectors, nearest neighbours, fixed corrections (section 2.1).

use nalgebra::Vector3;

use crate::sectors::{PAIR_COUNT, Sector, Sectors};

/// The numbers of section 3.1.1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperRuleSettings {
    /// d_p, between neighbours abeam.
    pub preferred_m: f64,
    /// d_p^f, to the neighbour ahead.
    pub preferred_forward_m: f64,
    /// |Δv| of one correction.
    pub correction_mps: f64,
    /// ν: sectors reach this high and low.
    pub elevation_rad_max: f64,
    /// "Similar" is a log ratio of at most this; the paper gives no number. At zero the command
    /// chatters for ever, at 0.1 the spacing spreads.
    pub similar_log_ratio: f64,
    /// Neighbours farther away are not seen.
    pub visible_m: f64,
}

impl Default for PaperRuleSettings {
    fn default() -> Self {
        Self {
            preferred_m: 3.0,
            preferred_forward_m: 3.9,
            correction_mps: 0.1,
            elevation_rad_max: 80_f64.to_radians(),
            similar_log_ratio: 0.05,
            visible_m: 9.0,
        }
    }
}

/// A neighbour for the rule, in the heading frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Of length one.
    pub direction: Vector3<f64>,
    pub range_m: f64,
}

/// The rule has no memory: it is its settings, prepared.
#[derive(Clone, Copy, Debug)]
pub struct PaperRule {
    settings: PaperRuleSettings,
    sectors: Sectors,
    /// "More distant" by more than the dead band, as a ratio.
    more_distant: f64,
}

impl PaperRule {
    pub fn new(settings: PaperRuleSettings) -> Self {
        Self {
            settings,
            sectors: Sectors::new(settings.elevation_rad_max),
            more_distant: settings.similar_log_ratio.exp(),
        }
    }

    /// The sum of the corrections, to be added to the nominal velocity, in the heading frame.
    ///
    /// Discontinuous where a neighbour crosses from one sector into the next.
    /// Cost: below a microsecond at 16 neighbours, see `benches/keeping.rs`.
    pub fn correction(&self, neighbours: impl Iterator<Item = Placed>) -> Vector3<f64> {
        let mut left_m = [f64::INFINITY; PAIR_COUNT];
        let mut right_m = [f64::INFINITY; PAIR_COUNT];
        let mut forward_m = [f64::INFINITY; 2];
        for neighbour in neighbours {
            if neighbour.range_m > self.settings.visible_m {
                continue;
            }
            let nearest_m = match self.sectors.sector_of(&neighbour.direction) {
                Some(Sector::Left { pair }) => &mut left_m[pair],
                Some(Sector::Right { pair }) => &mut right_m[pair],
                Some(Sector::Forward { up }) => &mut forward_m[usize::from(!up)],
                None => continue,
            };
            *nearest_m = nearest_m.min(neighbour.range_m);
        }
        let mut sum = Vector3::zeros();
        for pair in 0..PAIR_COUNT {
            if left_m[pair].is_infinite() && right_m[pair].is_infinite() {
                continue;
            }
            let or_preferred = |range_m: f64| {
                if range_m.is_finite() {
                    range_m
                } else {
                    self.settings.preferred_m
                }
            };
            let sign = self.sign_of(or_preferred(left_m[pair]), or_preferred(right_m[pair]));
            sum += self.sectors.axis(pair) * sign;
        }
        for up in [true, false] {
            let range_m = forward_m[usize::from(!up)];
            if range_m.is_finite() {
                let sign = self.sign_of(range_m, self.settings.preferred_forward_m);
                sum += self.sectors.forward_axis(up) * sign;
            }
        }
        sum * self.settings.correction_mps
    }

    /// One if the first is more distant, minus one if the second is, zero if they are similar.
    fn sign_of(&self, first_m: f64, second_m: f64) -> f64 {
        if first_m > second_m * self.more_distant {
            1.0
        } else if second_m > first_m * self.more_distant {
            -1.0
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests;

//! A source of positions, as motion capture or UWB would be: fixes at their own times, with noise.

use std::ops::Range;

use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::stream::Fix;

/// How good the source is.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionSourceSettings {
    pub rate_hz: f64,
    /// Noise of each coordinate, metres; the stated covariance agrees with it.
    pub sigma_m: f64,
    /// The share of fixes that are wrong by a metre or more, and do not say so.
    pub outlier_share: f64,
    /// Times since the start without fixes, seconds.
    pub gaps_s: Vec<Range<f64>>,
}

impl Default for PositionSourceSettings {
    fn default() -> Self {
        Self {
            rate_hz: 5.0,
            sigma_m: 0.02,
            outlier_share: 0.0,
            gaps_s: Vec::new(),
        }
    }
}

/// Fixes come this long after a frame would, so that their stamps are their own.
const PHASE_S: f64 = 0.037;

impl PositionSourceSettings {
    /// The times since the start at which fixes come, up to `duration_s`.
    pub fn times_s(&self, duration_s: f64) -> impl Iterator<Item = f64> {
        let count = (duration_s * self.rate_hz).ceil().max(0.0) as usize;
        (0..count)
            .map(|idx| idx as f64 / self.rate_hz + PHASE_S)
            .filter(|time_s| !self.gaps_s.iter().any(|gap| gap.contains(time_s)))
    }

    /// The fix of a true position. Its noise follows from seed and time stamp alone, so that
    /// leaving fixes out changes no other.
    pub fn fix(&self, truth_in_site: &Vector3<f64>, captured_at: Timestamp, seed: u64) -> Fix {
        // Odd multipliers spread neighbouring seeds and stamps over all 64 bits.
        let stamp = captured_at.nanoseconds() as u64;
        let mixed =
            seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ stamp.wrapping_mul(0xd1b5_4a32_d192_ed03);
        let mut rng = ChaCha8Rng::seed_from_u64(mixed);
        let mut normal = || Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
        let noise = normal() * self.sigma_m;
        let direction = normal();
        let wrong = rng.random::<f64>() < self.outlier_share;
        let error_m = rng.random_range(1.0..3.0);
        let outlier = if wrong {
            direction.normalize() * error_m
        } else {
            Vector3::zeros()
        };
        Fix {
            captured_at,
            position_in_site: truth_in_site + noise + outlier,
            covariance_in_site: Matrix3::identity() * self.sigma_m.powi(2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(settings: &PositionSourceSettings, stamp: i64, seed: u64) -> Fix {
        let stamp = Timestamp::from_nanoseconds(stamp);
        settings.fix(&Vector3::new(1.0, 2.0, 3.0), stamp, seed)
    }

    #[test]
    fn noise_follows_from_seed_and_stamp_alone() {
        let settings = PositionSourceSettings::default();
        assert_eq!(fix(&settings, 5, 1), fix(&settings, 5, 1));
        assert_ne!(
            fix(&settings, 5, 1).position_in_site,
            fix(&settings, 6, 1).position_in_site
        );
        assert_ne!(
            fix(&settings, 5, 1).position_in_site,
            fix(&settings, 5, 2).position_in_site
        );
        // Where the vehicle is adds to the noise and does not change it.
        let stamp = Timestamp::from_nanoseconds(5);
        let here = settings.fix(&Vector3::zeros(), stamp, 1).position_in_site;
        let there = fix(&settings, 5, 1).position_in_site;
        assert!((there - here - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn noise_has_the_stated_covariance() {
        let settings = PositionSourceSettings::default();
        let truth = Vector3::new(1.0, 2.0, 3.0);
        let count = 4000;
        let mut mean = Vector3::zeros();
        let mut variance = Vector3::zeros();
        for stamp in 0..count {
            let error = fix(&settings, stamp * 200_000_000, 3).position_in_site - truth;
            mean += error / count as f64;
            variance += error.component_mul(&error) / count as f64;
        }
        // Three sigma of a mean and of a variance over 4000 draws: 5 % and 7 %.
        assert!(mean.amax() < 0.05 * settings.sigma_m);
        assert!(
            (variance / settings.sigma_m.powi(2))
                .add_scalar(-1.0)
                .amax()
                < 0.09
        );
    }

    #[test]
    fn outliers_and_gaps_come_as_asked() {
        let settings = PositionSourceSettings {
            outlier_share: 0.1,
            gaps_s: vec![10.0..15.0],
            ..Default::default()
        };
        let truth = Vector3::new(1.0, 2.0, 3.0);
        let far = |stamp: &i64| (fix(&settings, *stamp, 1).position_in_site - truth).norm() > 0.5;
        let outliers = (0..1000).filter(far).count();
        assert!((60..140).contains(&outliers), "{outliers}");
        let times_s: Vec<f64> = settings.times_s(20.0).collect();
        assert_eq!(times_s.len(), 75);
        assert!(times_s.iter().all(|time_s| !(10.0..15.0).contains(time_s)));
    }
}

//! What the cameras say about a neighbour: a bearing, and bounds on its range.

use nalgebra::Vector3;

/// A neighbour as one frame shows it, in the heading frame: gravity-aligned, x forward, y left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sighting {
    /// Of length one.
    pub direction: Vector3<f64>,
    pub range: Range,
}

/// How far away a neighbour may be.
///
/// Lights that merge in the image have bounds and no expected range: far away behind a baseline
/// that cannot foreshorten, anywhere behind one that can.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Range {
    pub expected_m: Option<f64>,
    /// The neighbour is not nearer than this.
    pub low_m: f64,
    /// Nor farther than this; infinite where nothing is known.
    pub high_m: f64,
}

/// How the lights of a vehicle are mounted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Baseline {
    /// Three or more lights: from every side two of them show the full distance.
    AllRound,
    /// One above the other: seen at full length from all around, shortened from above and below.
    #[default]
    Vertical,
    /// Side by side, along the left axis: a neighbour abeam sees them merge.
    Horizontal,
}

/// The two lights that all vehicles of a team carry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerModel {
    pub baseline: Baseline,
    /// Between the lights.
    pub length_m: f64,
    /// Two headings of the team differ by at most this; larger widens the bounds of a horizontal
    /// baseline, smaller trusts that everybody flies the same way.
    pub heading_difference_rad_max: f64,
    /// A vertical baseline leans by at most this when its vehicle tilts.
    pub tilt_rad_max: f64,
}

impl Default for MarkerModel {
    fn default() -> Self {
        Self {
            baseline: Baseline::Vertical,
            length_m: 0.1,
            heading_difference_rad_max: 0.1,
            tilt_rad_max: 0.1,
        }
    }
}

/// Two lights as an image shows them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Separation {
    /// The angle between them, and its standard deviation.
    Resolved { angle_rad: f64, sigma_rad: f64 },
    /// One blob: the angle is below this.
    Merged { angle_rad_max: f64 },
}

/// Bounds are this many standard deviations of the separation wide.
const SIGMA_COUNT: f64 = 3.0;

impl MarkerModel {
    /// What a separation seen in this direction (heading frame, unit) says about the range.
    ///
    /// Small angles: `range = length × foreshortening / angle`.
    pub fn range(&self, direction: &Vector3<f64>, separation: Separation) -> Range {
        let [shortest, expected, longest] = self.foreshortening(direction);
        match separation {
            Separation::Resolved {
                angle_rad,
                sigma_rad,
            } => {
                let error_rad = SIGMA_COUNT * sigma_rad;
                let angle_low_rad = angle_rad - error_rad;
                let low_m = self.length_m * shortest / (angle_rad + error_rad);
                let high_m = if angle_low_rad > 0.0 {
                    self.length_m * longest / angle_low_rad
                } else {
                    f64::INFINITY
                };
                Range {
                    expected_m: (angle_rad > 0.0)
                        .then(|| (self.length_m * expected / angle_rad).clamp(low_m, high_m)),
                    low_m,
                    high_m,
                }
            }
            Separation::Merged { angle_rad_max } => Range {
                expected_m: None,
                low_m: self.length_m * shortest / angle_rad_max.max(f64::MIN_POSITIVE),
                high_m: f64::INFINITY,
            },
        }
    }

    /// The share of the baseline's length across the line of sight: smallest, expected, largest.
    fn foreshortening(&self, direction: &Vector3<f64>) -> [f64; 3] {
        let (along, tolerance_rad) = match self.baseline {
            Baseline::AllRound => return [1.0; 3],
            Baseline::Vertical => (direction.z, self.tilt_rad_max),
            Baseline::Horizontal => (direction.y, self.heading_difference_rad_max),
        };
        let angle_rad = along.abs().clamp(0.0, 1.0).acos();
        let right_angle_rad = std::f64::consts::FRAC_PI_2;
        [
            (angle_rad - tolerance_rad).max(0.0).sin(),
            angle_rad.sin(),
            (angle_rad + tolerance_rad).min(right_angle_rad).sin(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn resolved(angle_rad: f64) -> Separation {
        Separation::Resolved {
            angle_rad,
            sigma_rad: 0.3 / 181.0,
        }
    }

    #[test]
    fn merged_lights_mean_far_away_only_where_nothing_foreshortens() {
        let merged = Separation::Merged {
            angle_rad_max: 2.0 / 181.0,
        };
        let vertical = MarkerModel::default().range(&Vector3::y(), merged);
        assert!(vertical.low_m > 8.9, "{vertical:?}");
        let horizontal = MarkerModel {
            baseline: Baseline::Horizontal,
            ..MarkerModel::default()
        };
        assert_eq!(horizontal.range(&Vector3::y(), merged).low_m, 0.0);
        assert!(horizontal.range(&Vector3::x(), merged).low_m > 8.9);
    }

    proptest! {
        /// Goal: the truth is inside the bounds while errors are within their stated size.
        #[test]
        fn bounds_hold_the_truth(
            range_m in 0.3_f64..8.0,
            azimuth_rad in -3.1_f64..3.1,
            elevation_rad in -1.4_f64..1.4,
            heading_difference_rad in -0.1_f64..0.1,
            error in -2.9_f64..2.9,
            horizontal: bool,
        ) {
            let model = MarkerModel {
                baseline: if horizontal { Baseline::Horizontal } else { Baseline::Vertical },
                ..MarkerModel::default()
            };
            let direction = Vector3::new(
                elevation_rad.cos() * azimuth_rad.cos(),
                elevation_rad.cos() * azimuth_rad.sin(),
                elevation_rad.sin(),
            );
            let axis = if horizontal {
                Vector3::new(-heading_difference_rad.sin(), heading_difference_rad.cos(), 0.0)
            } else {
                Vector3::z()
            };
            let sigma_rad = 0.3 / 181.0;
            let across = axis.cross(&direction).norm();
            let angle_rad = model.length_m * across / range_m + error * sigma_rad;
            prop_assume!(angle_rad > 0.0);
            let range = model.range(&direction, resolved(angle_rad));
            prop_assert!(range.low_m <= range_m * (1.0 + 1e-9), "{range:?}");
            prop_assert!(range.high_m >= range_m * (1.0 - 1e-9), "{range:?}");
            let expected_m = range.expected_m.unwrap();
            prop_assert!(range.low_m <= expected_m && expected_m <= range.high_m);
        }
    }
}

//! The safety filter: the nearest velocity that closes in on nothing too fast.

use nalgebra::Vector3;

use crate::bounded::Bounded;
use crate::tracks::{TRACK_COUNT_MAX, Track};

/// More obstacles than this are not looked at; the caller gives the nearest first.
pub const OBSTACLE_COUNT_MAX: usize = 32;

/// Something to keep clear of, from the vehicle's own map or range sensors, in the heading frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Obstacle {
    /// Towards its nearest point, of length one.
    pub direction: Vector3<f64>,
    /// From the vehicle's centre to that point.
    pub clearance_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetySettings {
    /// Centres of vehicles stay this far apart, counted with the lower bound of the range.
    pub distance_m_min: f64,
    /// And by this farther, counted with the range itself: room for gusts that push vehicles
    /// together before the cameras show it. Zero is enough in still air.
    pub gust_m: f64,
    /// Centres of vehicles stay this far from obstacles.
    pub clearance_m_min: f64,
    /// What is left to the limit may be used up at this rate. Larger brakes later and harder.
    pub approach_hz: f64,
    /// The neighbour ahead does not see us and may back up this fast.
    pub unaware_mps: f64,
    /// A neighbour counts as slower than the swarm only by more than this: noise of the rate.
    pub slower_mps_min: f64,
    /// The command never exceeds the nominal speed by more than this. Smaller cannot get out of
    /// the way of who is blown along.
    pub excess_mps_max: f64,
}

impl Default for SafetySettings {
    fn default() -> Self {
        Self {
            distance_m_min: 0.8,
            gust_m: 0.4,
            clearance_m_min: 0.4,
            approach_hz: 1.0,
            unaware_mps: 0.1,
            slower_mps_min: 0.2,
            excess_mps_max: 1.0,
        }
    }
}

/// `direction · velocity <= speed_mps_max`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limit {
    /// Of length one, in the heading frame.
    pub direction: Vector3<f64>,
    pub speed_mps_max: f64,
}

impl Limit {
    fn excess_mps(&self, velocity: &Vector3<f64>) -> f64 {
        self.direction.dot(velocity) - self.speed_mps_max
    }

    fn is_broken_by(&self, velocity: &Vector3<f64>) -> bool {
        self.excess_mps(velocity) > SLACK_MPS
    }
}

/// Room for all tracks, all obstacles, and a box of speeds.
pub type Limits = Bounded<Limit, { TRACK_COUNT_MAX + OBSTACLE_COUNT_MAX + 4 }>;

/// Between limits that contradict each other so many rounds are made.
const SWEEP_COUNT: usize = 20;
/// Directions at a smaller angle count as parallel.
const PARALLEL_SIN: f64 = 1e-7;
/// Limits broken by less are kept.
const SLACK_MPS: f64 = 1e-9;
/// Lateral neighbours see us too and do their half.
const MUTUAL_SHARE: f64 = 0.5;
/// Within 30° of ahead we are in the other's blind rear: `cos 30°`, about the vertical.
const AHEAD_TAN: f64 = 0.577_350_269_189_625_8;
/// Faster than this is an error of the rate.
const SLOWER_MPS_MAX: f64 = 2.0;
/// A rate counts beyond so many standard deviations.
const RATE_SIGMA_COUNT: f64 = 4.0;
/// Rates of younger tracks are not used.
const RATE_SIGHTING_COUNT_MIN: u32 = 8;

/// How the vehicle flies, in the heading frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flight {
    /// The velocity common to the swarm.
    pub nominal: Vector3<f64>,
    /// The vehicle's own velocity now.
    pub velocity: Vector3<f64>,
}

impl SafetySettings {
    /// The limit that a neighbour sets, if it is near enough to matter.
    ///
    /// A discrete control barrier: the range may shrink at most at `approach_hz` times what is
    /// left of it, counted with its lower bound. Where the range is unknown, nobody closes in.
    ///
    /// - `direction`: towards it, heading frame.
    pub fn neighbour_limit(
        &self,
        direction: Vector3<f64>,
        track: &Track,
        flight: &Flight,
    ) -> Option<Limit> {
        let low_m = track
            .range
            .low_m
            .min(track.range_m.unwrap_or(f64::INFINITY));
        let keep_m = self.distance_m_min + self.gust_m;
        // The smoothed range lags behind a gust, the newest one is noisy: the nearer counts.
        let known_m = [track.range_m, track.range.expected_m]
            .into_iter()
            .flatten();
        let near_m = known_m.fold(f64::INFINITY, f64::min);
        let beyond_m = (low_m - self.distance_m_min).min(near_m - keep_m);
        let left_m = (beyond_m - track.age_s * self.unaware_mps).max(0.0);
        if left_m * self.approach_hz * MUTUAL_SHARE > 2.0 * self.excess_mps_max + 1.0 {
            return None;
        }
        let missing_m = (near_m - keep_m).min(0.0);
        let is_ahead = direction.x > 0.0 && direction.y.abs() < AHEAD_TAN * direction.x;
        let (share, margin_mps) = if is_ahead {
            (1.0, self.unaware_mps)
        } else {
            (MUTUAL_SHARE, 0.0)
        };
        let closing_mps = share * self.approach_hz * (left_m + missing_m) - margin_mps;
        let together_mps = direction.dot(&flight.nominal);
        let slower_mps = self.slower_mps(&direction, track, flight);
        Some(Limit {
            direction,
            speed_mps_max: together_mps - slower_mps + closing_mps,
        })
    }

    /// By how much the neighbour lags behind the nominal velocity towards us, beyond noise.
    fn slower_mps(&self, direction: &Vector3<f64>, track: &Track, flight: &Flight) -> f64 {
        let Some(range_m) = track.range_m else {
            return 0.0;
        };
        if track.sighting_count < RATE_SIGHTING_COUNT_MIN {
            return 0.0;
        }
        let its_mps = direction.dot(&flight.velocity) + track.growth_hz * range_m;
        let slower_mps = direction.dot(&flight.nominal) - its_mps;
        let noise_mps = RATE_SIGMA_COUNT * track.growth_sigma_hz() * range_m;
        let threshold_mps = self.slower_mps_min + noise_mps;
        // Fades in over as much again: beyond that all of it counts, or the rest closes in.
        let certainty = ((slower_mps - threshold_mps) / threshold_mps).clamp(0.0, 1.0);
        slower_mps.min(SLOWER_MPS_MAX) * certainty
    }

    pub fn obstacle_limit(&self, obstacle: &Obstacle) -> Limit {
        Limit {
            direction: obstacle.direction,
            speed_mps_max: self.approach_hz * (obstacle.clearance_m - self.clearance_m_min),
        }
    }
}

/// The velocity nearest to the wanted one that keeps all limits.
///
/// Where the limits contradict each other there is none, and it ends between them.
pub fn limit(wanted: &Vector3<f64>, limits: &[Limit]) -> Vector3<f64> {
    nearest_in_space(wanted, limits).unwrap_or_else(|| between(wanted, limits))
}

/// Adds one limit after the other. One that is broken bounds the new optimum, which therefore lies
/// on its plane: the same question with one dimension less and only the limits before it (Seidel,
/// "Small-dimensional linear programming and convex hulls made easy", 1991). Few limits break it,
/// so that it mostly costs a pass; were each to break what the ones before leave, its cost would
/// be their number cubed.
fn nearest_in_space(wanted: &Vector3<f64>, limits: &[Limit]) -> Option<Vector3<f64>> {
    let mut nearest = *wanted;
    for (idx, limit) in limits.iter().enumerate() {
        if limit.is_broken_by(&nearest) {
            nearest = nearest_on_plane(wanted, limit, &limits[..idx])?;
        }
    }
    Some(nearest)
}

fn nearest_on_plane(
    wanted: &Vector3<f64>,
    plane: &Limit,
    limits: &[Limit],
) -> Option<Vector3<f64>> {
    let start = wanted - plane.direction * plane.excess_mps(wanted);
    let mut nearest = start;
    for (idx, limit) in limits.iter().enumerate() {
        if limit.is_broken_by(&nearest) {
            // What the limit leaves of the plane: a half-plane, whose border is a line.
            let across = limit.direction - plane.direction * limit.direction.dot(&plane.direction);
            let share = across.norm();
            if share < PARALLEL_SIN {
                return None;
            }
            let across = across / share;
            let on_border = start - across * (limit.excess_mps(&start) / share);
            let along = plane.direction.cross(&across);
            nearest = nearest_on_line(&on_border, &along, &limits[..idx])?;
        }
    }
    Some(nearest)
}

/// - `start`: the point of the line that would be nearest without limits.
/// - `along`: of length one.
fn nearest_on_line(
    start: &Vector3<f64>,
    along: &Vector3<f64>,
    limits: &[Limit],
) -> Option<Vector3<f64>> {
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for limit in limits {
        let share = limit.direction.dot(along);
        let excess_mps = limit.excess_mps(start);
        if share > PARALLEL_SIN {
            high = high.min(-excess_mps / share);
        } else if share < -PARALLEL_SIN {
            low = low.max(-excess_mps / share);
        } else if excess_mps > SLACK_MPS {
            return None;
        }
    }
    (low <= high).then(|| start + along * 0.0_f64.clamp(low, high))
}

/// Cyclic projection onto the half-spaces: each round moves the velocity the least that each limit
/// asks for.
fn between(wanted: &Vector3<f64>, limits: &[Limit]) -> Vector3<f64> {
    let mut velocity = *wanted;
    for _ in 0..SWEEP_COUNT {
        for limit in limits {
            velocity -= limit.direction * limit.excess_mps(&velocity).max(0.0);
        }
    }
    velocity
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::sighting::Range;

    fn neighbour_at(range_m: f64) -> Track {
        Track {
            range: Range {
                expected_m: Some(range_m),
                low_m: range_m,
                high_m: range_m,
            },
            range_m: Some(range_m),
            ..Track::default()
        }
    }

    #[test]
    fn approach_ends_at_the_smallest_distance() {
        let settings = SafetySettings::default();
        let flight = Flight::default();
        let limit_at = |range_m: f64| {
            let limit = settings.neighbour_limit(Vector3::y(), &neighbour_at(range_m), &flight);
            limit.unwrap().speed_mps_max
        };
        let keep_m = settings.distance_m_min + settings.gust_m;
        assert!(limit_at(keep_m + 1.0) > 0.4);
        assert!(limit_at(keep_m).abs() < 1e-12);
        assert!(limit_at(keep_m - 0.3) < 0.0);
    }

    #[test]
    fn an_unknown_range_is_never_approached() {
        let unknown = Track::default();
        let settings = SafetySettings::default();
        let limit = settings.neighbour_limit(Vector3::y(), &unknown, &Flight::default());
        assert!(limit.unwrap().speed_mps_max.abs() < 1e-12);
    }

    #[test]
    fn who_stops_ahead_is_not_run_into() {
        let flight = Flight {
            nominal: Vector3::x(),
            velocity: Vector3::x(),
        };
        let mut stopped = neighbour_at(2.0);
        stopped.growth_hz = -0.5;
        stopped.sighting_count = 20;
        let settings = SafetySettings::default();
        let limit = settings.neighbour_limit(Vector3::x(), &stopped, &flight);
        let mut flying = stopped;
        flying.growth_hz = 0.0;
        let free = settings.neighbour_limit(Vector3::x(), &flying, &flight);
        let saved_mps = free.unwrap().speed_mps_max - limit.unwrap().speed_mps_max;
        assert!((saved_mps - 1.0).abs() < 1e-9, "{saved_mps}");
    }

    #[test]
    fn nearly_opposed_limits_are_kept() {
        let limits = [
            Vector3::new(-0.71, 0.98, -0.56),
            Vector3::new(0.67, -0.91, 0.23),
        ]
        .map(|direction| Limit {
            direction: direction.normalize(),
            speed_mps_max: 0.05,
        });
        let velocity = limit(&Vector3::new(0.0, -1.38, -1.3), &limits);
        for limit in &limits {
            assert!(!limit.is_broken_by(&velocity), "{velocity:?}");
        }
    }

    #[test]
    fn between_contradicting_limits_it_ends_between_them() {
        let limits = [Vector3::x(), -Vector3::x()].map(|direction| Limit {
            direction,
            speed_mps_max: -0.1,
        });
        let velocity = limit(&Vector3::new(0.7, 0.3, 0.0), &limits);
        assert!(velocity.x.abs() <= 0.1 + 1e-9, "{velocity:?}");
        assert!((velocity.y - 0.3).abs() < 1e-9, "{velocity:?}");
    }

    proptest! {
        /// Goal: whatever is around, limits that can be kept are kept, at the least cost. Method:
        /// limits that zero keeps, since standing still is always possible then; no velocity that
        /// keeps them, on the way to zero or to a random one, is nearer.
        #[test]
        fn limits_that_standing_still_keeps_are_kept(
            wanted in (-1.5_f64..1.5, -1.5_f64..1.5, -1.5_f64..1.5),
            raw in proptest::collection::vec(
                (-1.0_f64..1.0, -1.0_f64..1.0, -1.0_f64..1.0, 0.0_f64..0.5), 0..12),
            other in (-1.5_f64..1.5, -1.5_f64..1.5, -1.5_f64..1.5),
        ) {
            let limits: Vec<Limit> = raw
                .iter()
                .map(|(x, y, z, speed)| (Vector3::new(*x, *y, *z), *speed))
                .filter(|(direction, _)| direction.norm() > 0.1)
                .map(|(direction, speed_mps_max)| Limit {
                    direction: direction.normalize(),
                    speed_mps_max,
                })
                .collect();
            let wanted = Vector3::new(wanted.0, wanted.1, wanted.2);
            let velocity = limit(&wanted, &limits);
            for limit in &limits {
                prop_assert!(limit.excess_mps(&velocity) < 1e-6, "{}", limit.excess_mps(&velocity));
            }
            prop_assert!(velocity.norm() <= wanted.norm() + 1e-9);
            let other = Vector3::new(other.0, other.1, other.2);
            // As far towards the other one as all limits allow, from zero and from the found one.
            for from in [Vector3::zeros(), velocity] {
                let step = other - from;
                let share = limits.iter().fold(1.0_f64, |share, limit| {
                    let speed_mps = limit.direction.dot(&step);
                    let left_mps = -limit.excess_mps(&from);
                    if speed_mps > 0.0 { share.min(left_mps / speed_mps) } else { share }
                });
                let allowed = from + step * share.max(0.0);
                let saved_m = (velocity - wanted).norm() - (allowed - wanted).norm();
                prop_assert!(saved_m < 1e-6, "{saved_m}");
            }
        }

        #[test]
        fn what_keeps_all_limits_is_not_changed(speed in 0.0_f64..0.3) {
            let limits = [Vector3::x(), Vector3::y(), -Vector3::x()].map(|direction| Limit {
                direction,
                speed_mps_max: 0.3,
            });
            let wanted = Vector3::new(speed, -speed, 1.0);
            prop_assert_eq!(limit(&wanted, &limits), wanted);
        }
    }
}

//! Neighbours over time: sightings are joined frame to frame, smoothed, held, and remembered.

use nalgebra::Vector3;

use crate::bounded::Bounded;
use crate::sighting::{Range, Sighting};
use crate::turn::Turn;

/// More neighbours than this are not followed; the farthest are left out.
pub const TRACK_COUNT_MAX: usize = 128;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackSettings {
    /// Time constant of the low-pass on the logarithm of the range. Shorter passes pixel noise on
    /// to the command, longer lets a fast neighbour come near before it is noticed.
    pub smoothing_s: f64,
    /// A neighbour that is not seen counts as where it was for so long.
    pub hold_s: f64,
    /// For so long it is still kept clear of.
    pub memory_s: f64,
    /// Nobody moves faster than this against its neighbours.
    pub relative_speed_mps: f64,
}

impl Default for TrackSettings {
    fn default() -> Self {
        Self {
            smoothing_s: 0.5,
            hold_s: 0.3,
            memory_s: 2.0,
            relative_speed_mps: 1.0,
        }
    }
}

/// One neighbour.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Track {
    /// Of length one; level axes that do not turn with the vehicle.
    pub direction_in_level: Vector3<f64>,
    /// The newest bounds.
    pub range: Range,
    /// Smoothed, once there was a sighting with an expected range.
    pub range_m: Option<f64>,
    /// How fast the range grows, relative to it, per second.
    pub growth_hz: f64,
    /// Since the last sighting.
    pub age_s: f64,
    /// Since the last sighting with an expected range.
    pub range_age_s: f64,
    pub sighting_count: u32,
    /// The logarithm of the smoothed range, while there is one.
    pub log_range: f64,
    /// The same in the growth's own filter.
    pub predicted_log_range: f64,
}

/// All neighbours that were seen lately.
#[derive(Clone, Debug)]
pub struct Tracks {
    settings: TrackSettings,
    tracks: Bounded<Track, TRACK_COUNT_MAX>,
    /// Which tracks a sighting of this frame has been joined to.
    is_taken: [bool; TRACK_COUNT_MAX],
}

/// Sightings are joined to a track within this angle of it, at any range.
const GATE_RAD: f64 = 0.07;
/// And never beyond this one.
const GATE_RAD_MAX: f64 = 0.6;
/// And if the range changed by no more than this in logarithm (the marker vision's own gate).
const GATE_LOG_RANGE: f64 = 0.5;
/// A track that fits this well is taken without a look at the others.
const CERTAIN_COST: f64 = 0.05;
/// Ages are sums of steps, and sums of tenths are not exact.
const AGE_SLACK_S: f64 = 0.01;
/// Neighbours move, and the smoothed range lags: bounds exclude only beyond this ratio.
const BOUND_SLACK: f64 = 1.5;
/// Time constant of the range's rate, in time constants of the range.
const GROWTH_SMOOTHING: f64 = 2.0;

/// Bounds are six standard deviations wide, of which the alpha–beta filter below leaves 0.16 per
/// second in the rate.
const RATE_OF_WIDTH_HZ: f64 = 0.16 / 6.0;

impl Tracks {
    pub fn new(settings: TrackSettings) -> Self {
        Self {
            settings,
            tracks: Bounded::default(),
            is_taken: [false; TRACK_COUNT_MAX],
        }
    }

    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Whether the track may still pull or push.
    pub fn is_held(&self, track: &Track) -> bool {
        track.age_s <= self.settings.hold_s + AGE_SLACK_S
    }

    /// Takes one frame's sightings, in the heading frame.
    ///
    /// - `heading_rad`: of the vehicle, about the vertical, from its level axes.
    /// - `step_s`: since the last frame.
    pub fn update(&mut self, sightings: &[Sighting], heading_rad: f64, step_s: f64) {
        for track in self.tracks.iter_mut() {
            track.age_s += step_s;
            track.range_age_s += step_s;
        }
        let memory_s = self.settings.memory_s;
        self.tracks
            .retain(|track| track.age_s <= memory_s + AGE_SLACK_S);
        self.is_taken = [false; TRACK_COUNT_MAX];
        let level_from_heading = Turn::by(heading_rad);
        let known_count = self.tracks.len();
        let gains = Gains::after(step_s, &self.settings);
        let mut next = 0;
        for sighting in sightings {
            let measured = Measured {
                direction_in_level: level_from_heading.of(&sighting.direction),
                range: sighting.range,
                log_range: sighting.range.expected_m.map(f64::ln),
            };
            // Cameras report in about the same order from frame to frame, so the next track is
            // tried first.
            let found = if self.cost(next, &measured, known_count, step_s) < CERTAIN_COST {
                Some(next)
            } else {
                self.nearest(&measured, known_count, step_s)
            };
            match found {
                Some(idx) => {
                    self.is_taken[idx] = true;
                    self.tracks[idx].join(&measured, &gains, &self.settings);
                    next = idx + 1;
                }
                None => self.begin(&measured),
            }
        }
    }

    /// The free track among the first `known_count` that fits best.
    fn nearest(&self, measured: &Measured, known_count: usize, step_s: f64) -> Option<usize> {
        let mut best = None;
        let mut best_cost = 1.0;
        for idx in 0..known_count {
            let cost = self.cost(idx, measured, known_count, step_s);
            if cost < best_cost {
                best_cost = cost;
                best = Some(idx);
            }
        }
        best
    }

    /// How badly a track fits; below one it may be the same neighbour.
    fn cost(&self, idx: usize, measured: &Measured, known_count: usize, step_s: f64) -> f64 {
        let Some(track) = self.tracks[..known_count].get(idx) else {
            return f64::INFINITY;
        };
        // Twice the versine: the angle squared, where it is small.
        let along = track.direction_in_level.dot(&measured.direction_in_level);
        let angle_squared = 2.0 * (1.0 - along);
        if angle_squared > GATE_RAD_MAX * GATE_RAD_MAX
            || self.is_taken[idx]
            || !track.may_be_at(&measured.range)
        {
            return f64::INFINITY;
        }
        let moved_m = self.settings.relative_speed_mps * (track.age_s + step_s);
        let moved_rad = moved_m / track.reach_m().max(0.1);
        let gate_rad = (GATE_RAD + moved_rad).min(GATE_RAD_MAX);
        let mut cost = angle_squared / (gate_rad * gate_rad);
        if let (Some(_), Some(log_range)) = (track.range_m, measured.log_range) {
            let change = (log_range - track.log_range) / (GATE_LOG_RANGE + moved_rad);
            cost += change * change;
        }
        cost
    }

    /// Begins a track; if there is no room, in place of the farthest one.
    fn begin(&mut self, measured: &Measured) {
        let log_range = measured.log_range.unwrap_or(0.0);
        let track = Track {
            direction_in_level: measured.direction_in_level,
            range: measured.range,
            range_m: measured.range.expected_m,
            log_range,
            predicted_log_range: log_range,
            sighting_count: 1,
            ..Track::default()
        };
        let Err(track) = self.tracks.push(track) else {
            return;
        };
        let farthest = self
            .tracks
            .iter()
            .enumerate()
            .max_by(|(_, left), (_, right)| left.reach_m().total_cmp(&right.reach_m()));
        if let Some((idx, farthest)) = farthest
            && farthest.reach_m() > track.reach_m()
        {
            self.tracks[idx] = track;
            self.is_taken[idx] = true;
        }
    }
}

impl Track {
    /// Standard deviation of [`Self::growth_hz`] from the width of the newest bounds.
    pub fn growth_sigma_hz(&self) -> f64 {
        let log_width = (self.range.high_m / self.range.low_m.max(1e-3)).ln();
        RATE_OF_WIDTH_HZ * log_width
    }

    /// Whether bounds that were seen now do not exclude where the neighbour was.
    fn may_be_at(&self, range: &Range) -> bool {
        let was_m = self.range_m.unwrap_or(self.range.low_m);
        range.low_m <= was_m * BOUND_SLACK && range.high_m * BOUND_SLACK >= self.range.low_m
    }

    fn reach_m(&self) -> f64 {
        self.range_m.unwrap_or(self.range.low_m)
    }

    fn join(&mut self, measured: &Measured, gains: &Gains, settings: &TrackSettings) {
        self.direction_in_level = measured.direction_in_level;
        self.range = measured.range;
        self.age_s = 0.0;
        self.sighting_count = self.sighting_count.saturating_add(1);
        let Some(log_range) = measured.log_range else {
            // Lights that merge hide how the range changes.
            if self.range_age_s > settings.hold_s + AGE_SLACK_S {
                self.range_m = None;
                self.growth_hz = 0.0;
            }
            return;
        };
        let elapsed_s = std::mem::take(&mut self.range_age_s);
        if self.range_m.is_none() {
            self.range_m = measured.range.expected_m;
            self.log_range = log_range;
            self.predicted_log_range = log_range;
            return;
        }
        let missed;
        let gains = if elapsed_s == gains.elapsed_s {
            gains
        } else {
            missed = Gains::after(elapsed_s, settings);
            &missed
        };
        self.log_range += gains.range * (log_range - self.log_range);
        self.range_m = Some(self.log_range.exp());
        // An alpha–beta filter beside it, critically damped, gives the rate.
        let predicted = self.predicted_log_range + self.growth_hz * elapsed_s;
        let error = log_range - predicted;
        self.predicted_log_range = predicted + gains.growth * (2.0 - gains.growth) * error;
        if elapsed_s > 0.0 {
            self.growth_hz += gains.growth * gains.growth * error / elapsed_s;
        }
    }
}

/// A sighting in axes that do not turn.
struct Measured {
    direction_in_level: Vector3<f64>,
    range: Range,
    log_range: Option<f64>,
}

/// What share of an error the filters take over after some time.
struct Gains {
    elapsed_s: f64,
    range: f64,
    growth: f64,
}

impl Gains {
    fn after(elapsed_s: f64, settings: &TrackSettings) -> Self {
        let share = |smoothing_s: f64| 1.0 - (-elapsed_s / smoothing_s).exp();
        Self {
            elapsed_s,
            range: share(settings.smoothing_s),
            growth: share(GROWTH_SMOOTHING * settings.smoothing_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(azimuth_rad: f64, range_m: f64) -> Sighting {
        Sighting {
            direction: Vector3::new(azimuth_rad.cos(), azimuth_rad.sin(), 0.0),
            range: Range {
                expected_m: Some(range_m),
                low_m: 0.9 * range_m,
                high_m: 1.1 * range_m,
            },
        }
    }

    #[test]
    fn one_neighbour_stays_one_track_while_the_vehicle_turns() {
        let mut tracks = Tracks::new(TrackSettings::default());
        for idx in 0..30 {
            let heading_rad = 0.1 * f64::from(idx);
            tracks.update(&[sighting(-heading_rad, 3.0)], heading_rad, 0.1);
        }
        assert_eq!(tracks.tracks().len(), 1);
        assert_eq!(tracks.tracks()[0].sighting_count, 30);
        assert!((tracks.tracks()[0].direction_in_level - Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn a_lost_neighbour_is_held_then_remembered_then_forgotten() {
        let mut tracks = Tracks::new(TrackSettings::default());
        tracks.update(&[sighting(0.0, 3.0)], 0.0, 0.1);
        for _ in 0..3 {
            tracks.update(&[], 0.0, 0.1);
        }
        assert!(tracks.is_held(&tracks.tracks()[0]));
        tracks.update(&[], 0.0, 0.1);
        assert!(!tracks.is_held(&tracks.tracks()[0]));
        for _ in 0..16 {
            tracks.update(&[], 0.0, 0.1);
        }
        assert_eq!(tracks.tracks().len(), 1);
        tracks.update(&[], 0.0, 0.1);
        assert!(tracks.tracks().is_empty());
    }

    #[test]
    fn the_rate_of_a_steady_approach_is_found() {
        let mut tracks = Tracks::new(TrackSettings::default());
        for idx in 0..60 {
            let range_m = 8.0 - 0.05 * f64::from(idx);
            tracks.update(&[sighting(0.0, range_m)], 0.0, 0.1);
        }
        let track = tracks.tracks()[0];
        let speed_mps = track.growth_hz * track.range_m.unwrap();
        // The relative rate of a steady approach grows by a tenth a second; the filter lags by one.
        assert!((speed_mps + 0.5).abs() < 0.1, "{speed_mps}");
    }

    #[test]
    fn a_far_light_behind_a_near_neighbour_is_another_track() {
        let mut tracks = Tracks::new(TrackSettings::default());
        tracks.update(&[sighting(0.0, 2.0)], 0.0, 0.1);
        let far = Sighting {
            range: Range {
                expected_m: None,
                low_m: 6.0,
                high_m: f64::INFINITY,
            },
            ..sighting(0.01, 2.0)
        };
        tracks.update(&[far], 0.0, 0.1);
        assert_eq!(tracks.tracks().len(), 2);
    }

    #[test]
    fn the_nearest_are_kept_when_there_are_too_many() {
        let mut tracks = Tracks::new(TrackSettings::default());
        let crowd: Vec<Sighting> = (0..2 * TRACK_COUNT_MAX)
            .map(|idx| sighting(0.024 * idx as f64, 9.0 - 0.03 * idx as f64))
            .collect();
        tracks.update(&crowd, 0.0, 0.1);
        assert_eq!(tracks.tracks().len(), TRACK_COUNT_MAX);
        let limit_m = 9.0 - 0.03 * TRACK_COUNT_MAX as f64 + 1e-9;
        assert!(
            tracks
                .tracks()
                .iter()
                .all(|track| track.reach_m() <= limit_m)
        );
    }
}

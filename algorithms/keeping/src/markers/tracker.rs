//! Marker pairs followed from frame to frame.
//!
//! A track begins in [`TrackState::Acquire`], is believed after being seen in three of four frames
//! in a way that a drone can move, holds its last value through gaps of a few frames, and never
//! gives a number without its age and state.

mod filter;

use camera::Intrinsics;
use geometry::Timestamp;
use nalgebra::{UnitQuaternion, Vector3};

use super::blink::{BlinkCode, Brightness, HISTORY_LEN};
use super::finder::FramePairs;
use super::pairs::{MarkerPair, PAIR_COUNT_MAX};
use filter::Filter;

/// How tracks are begun, believed and given up.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerSettings {
    /// A pair's centre is looked for this far from where it is expected.
    pub gate_px: f64,
    /// And its separation up to this factor from what is expected.
    pub separation_ratio_max: f64,
    /// Frames that a track may be unseen before its value is no longer given.
    pub coast_frame_count: u32,
    /// Frames after which a lost track is forgotten; until then two sightings bring it back.
    pub memory_frame_count: u32,
    /// Fastest relative change of a separation, per second; a drone at 3 m that closes in with
    /// 6 m/s reaches 2. Larger believes more lights that are no drones.
    pub rate_max_per_s: f64,
    /// How suddenly that rate changes, per second to the power of 1.5.
    pub rate_noise: f64,
    /// The code that neighbours' lights blink; tracks that do not are never believed.
    pub blink: Option<BlinkCode>,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self {
            gate_px: 12.0,
            separation_ratio_max: 1.5,
            coast_frame_count: 5,
            memory_frame_count: 20,
            rate_max_per_s: 2.0,
            rate_noise: 0.5,
            blink: None,
        }
    }
}

/// How the camera turned since the frame before, from the gyroscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EgoMotion {
    pub now_from_before: UnitQuaternion<f64>,
    pub intrinsics: Intrinsics,
}

/// Which track; never used again for another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TrackId(pub u32);

/// How far a track can be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackState {
    /// Seen too seldom, or lost for too long: may be anything.
    Acquire,
    /// Seen in this frame.
    Track,
    /// Not seen in this frame; its values are held, and less certain with every frame.
    Coast,
}

/// One neighbour, as far as its lights tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerTrack {
    pub id: TrackId,
    pub state: TrackState,
    /// Since its lights were last told apart, seconds.
    pub age_s: f64,
    /// Column and row half-way between the lights.
    pub u_px: f64,
    pub v_px: f64,
    pub separation_px: f64,
    /// Grows while the lights are not seen.
    pub sigma_separation_px: f64,
    /// Relative change of the separation, per second; positive as the neighbour comes near.
    pub rate_per_s: f64,
    /// The logarithm of the lights' peak above the background, in grey levels: at least, and at
    /// most, which is infinite where the peak is clipped. As of the last sighting.
    pub log_peak_bounds: [f64; 2],
    /// Its lights run into each other: it is farther away than the separation says.
    pub merged: bool,
}

impl MarkerTrack {
    /// Whether its numbers may be used.
    pub fn is_confirmed(&self) -> bool {
        self.state != TrackState::Acquire
    }
}

/// Follows the pairs of one camera.
#[derive(Clone, Debug)]
pub struct MarkerTracker {
    settings: TrackerSettings,
    tracks: Vec<Track>,
    shown: Vec<MarkerTrack>,
    matches: Vec<Match>,
    next_id: u32,
    updated_at: Option<Timestamp>,
}

/// Beyond these the least certain are not begun.
const TRACK_COUNT_MAX: usize = 16;
/// Seen this often in the last four frames is believed.
const CONFIRMING_COUNT: u32 = 3;
const CONFIRMING_FRAMES: u32 = 0b1111;
/// A known track that comes back needs this many sightings in a row.
const RETURNING_FRAMES: u32 = 0b11;
/// The gate grows by this share with every frame without a sighting, up to a factor of three.
const GATE_GROWTH: f64 = 0.4;
const GATE_GROWTH_MAX: f64 = 3.0;
/// One light where its mate was expected, within this share of the separation: the survivor of a
/// pair beside a stranger.
const SLIPPED_SHARE: f64 = 0.3;
/// Merged lights of a pair that was up to this far apart.
const MERGING_SEPARATION_PX: f64 = 7.0;

#[derive(Clone, Debug)]
struct Track {
    id: TrackId,
    filter: Filter,
    /// One bit for each of the last frames, the latest lowest: seen.
    seen: u32,
    missed_count: u32,
    measured_at: Timestamp,
    was_confirmed: bool,
    state: TrackState,
    merged: bool,
    log_peak_bounds: [f64; 2],
    history: [Brightness; HISTORY_LEN],
    history_len: usize,
}

#[derive(Clone, Copy, Debug)]
struct Match {
    confirmed: bool,
    cost: f64,
    track_idx: usize,
    pair_idx: usize,
}

impl MarkerTracker {
    pub fn new(settings: TrackerSettings) -> Self {
        Self {
            settings,
            tracks: Vec::with_capacity(TRACK_COUNT_MAX),
            shown: Vec::with_capacity(TRACK_COUNT_MAX),
            matches: Vec::with_capacity(TRACK_COUNT_MAX * PAIR_COUNT_MAX),
            next_id: 0,
            updated_at: None,
        }
    }

    /// All tracks as of the last frame.
    pub fn tracks(&self) -> &[MarkerTrack] {
        &self.shown
    }

    /// Takes in the pairs of a frame, and says what is known after it.
    ///
    /// - `ego`: how the camera turned since the frame before, if that is known; without it, turning
    ///   faster than the gate per frame loses tracks.
    pub fn update(
        &mut self,
        frame: &FramePairs<'_>,
        captured_at: Timestamp,
        ego: Option<&EgoMotion>,
    ) -> &[MarkerTrack] {
        let elapsed_s = self.updated_at.map_or(0.0, |before| captured_at - before);
        self.updated_at = Some(captured_at);
        // A clock that went back tells nothing about motion.
        let elapsed_s = elapsed_s.max(0.0);
        for track in &mut self.tracks {
            track
                .filter
                .predict(elapsed_s, self.settings.rate_noise, ego);
        }
        let pairs = &frame.pairs[..frame.pairs.len().min(PAIR_COUNT_MAX)];
        self.find_matches(pairs);
        let (mut tracks_taken, mut pairs_taken) = (0_u32, 0_u32);
        for idx in 0..self.matches.len() {
            let Match {
                track_idx,
                pair_idx,
                ..
            } = self.matches[idx];
            if tracks_taken >> track_idx & 1 == 1 || pairs_taken >> pair_idx & 1 == 1 {
                continue;
            }
            tracks_taken |= 1 << track_idx;
            pairs_taken |= 1 << pair_idx;
            self.tracks[track_idx].see(&pairs[pair_idx], captured_at, &self.settings);
        }
        for (track_idx, track) in self.tracks.iter_mut().enumerate() {
            if tracks_taken >> track_idx & 1 == 0 {
                track.miss(frame, &self.settings);
            }
        }
        self.tracks
            .retain(|track| track.is_worth_keeping(&self.settings));
        for (pair_idx, pair) in pairs.iter().enumerate() {
            if pairs_taken >> pair_idx & 1 == 0 && self.tracks.len() < TRACK_COUNT_MAX {
                self.tracks
                    .push(Track::begin(TrackId(self.next_id), pair, captured_at));
                self.next_id += 1;
            }
        }
        self.shown.clear();
        self.shown
            .extend(self.tracks.iter().map(|track| track.show(captured_at)));
        &self.shown
    }

    /// All possible matches, those of believed tracks first, then the nearest.
    fn find_matches(&mut self, pairs: &[MarkerPair]) {
        self.matches.clear();
        for (track_idx, track) in self.tracks.iter().enumerate() {
            for (pair_idx, pair) in pairs.iter().enumerate() {
                if let Some(cost) = track.match_cost(pair, &self.settings) {
                    self.matches.push(Match {
                        confirmed: track.was_confirmed,
                        cost,
                        track_idx,
                        pair_idx,
                    });
                }
            }
        }
        self.matches.sort_unstable_by(|a, b| {
            let order = b
                .confirmed
                .cmp(&a.confirmed)
                .then(a.cost.total_cmp(&b.cost));
            order.then((a.track_idx, a.pair_idx).cmp(&(b.track_idx, b.pair_idx)))
        });
    }
}

impl Track {
    fn begin(id: TrackId, pair: &MarkerPair, captured_at: Timestamp) -> Self {
        let mut track = Self {
            id,
            filter: Filter::begin(pair),
            seen: 1,
            missed_count: 0,
            measured_at: captured_at,
            was_confirmed: false,
            state: TrackState::Acquire,
            merged: false,
            log_peak_bounds: pair.log_peak_bounds(),
            history: [Brightness::default(); HISTORY_LEN],
            history_len: 0,
        };
        track.remember_brightness(pair, captured_at);
        track
    }

    /// How far a pair is from what is expected, in gates; `None` outside.
    fn match_cost(&self, pair: &MarkerPair, settings: &TrackerSettings) -> Option<f64> {
        let growth = (1.0 + GATE_GROWTH * f64::from(self.missed_count)).min(GATE_GROWTH_MAX);
        let center_px = self.filter.center_px;
        let offset = [0, 1].map(|axis| pair.center_px[axis] - center_px[axis]);
        let distance = offset[0].hypot(offset[1]) / (settings.gate_px * growth);
        let log_ratio = (pair.separation_px / self.filter.separation_px())
            .ln()
            .abs();
        let ratio = log_ratio / settings.separation_ratio_max.ln();
        (distance <= 1.0 && ratio <= 1.0 && !self.is_slipped(pair)).then_some(distance + ratio)
    }

    /// Whether one of the lights is where the other was expected.
    fn is_slipped(&self, pair: &MarkerPair) -> bool {
        let near_px = SLIPPED_SHARE * self.filter.separation_px();
        let [first, second] = self.filter.lights_px();
        let is_near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < near_px;
        is_near(pair.lights[0].center_px, second) || is_near(pair.lights[1].center_px, first)
    }

    fn see(&mut self, pair: &MarkerPair, captured_at: Timestamp, settings: &TrackerSettings) {
        let elapsed_s = captured_at - self.measured_at;
        let plausible = self
            .filter
            .is_plausible(pair, elapsed_s, settings.rate_max_per_s);
        if !plausible && !self.was_confirmed {
            // No drone moves like that: begin again, from here.
            *self = Self::begin(self.id, pair, captured_at);
            return;
        }
        self.filter.correct(pair);
        self.seen = self.seen << 1 | 1;
        self.missed_count = 0;
        self.measured_at = captured_at;
        self.merged = false;
        self.log_peak_bounds = pair.log_peak_bounds();
        self.remember_brightness(pair, captured_at);
        if self.is_believed(settings) {
            self.state = TrackState::Track;
            self.was_confirmed = true;
        } else {
            self.state = TrackState::Acquire;
        }
    }

    fn is_believed(&self, settings: &TrackerSettings) -> bool {
        let is_steady = match self.state {
            TrackState::Track | TrackState::Coast => true,
            TrackState::Acquire if self.was_confirmed => {
                self.seen & RETURNING_FRAMES == RETURNING_FRAMES
            }
            TrackState::Acquire => (self.seen & CONFIRMING_FRAMES).count_ones() >= CONFIRMING_COUNT,
        };
        let blinks = match &settings.blink {
            None => true,
            Some(code) => code
                .is_shown_by(&self.history[..self.history_len])
                .unwrap_or(self.was_confirmed),
        };
        is_steady && blinks
    }

    fn miss(&mut self, frame: &FramePairs<'_>, settings: &TrackerSettings) {
        self.seen <<= 1;
        self.missed_count += 1;
        let center_px = self.filter.center_px;
        let is_here = |merged_px: [f64; 2]| {
            let offset = [0, 1].map(|axis| merged_px[axis] - center_px[axis]);
            offset[0].hypot(offset[1]) <= settings.gate_px
        };
        let may_merge = self.filter.separation_px() <= MERGING_SEPARATION_PX;
        let merged = frame.merged.iter().find(|merged| is_here(merged.center_px));
        self.merged = false;
        if let Some(merged) = merged.filter(|_| may_merge) {
            self.merged = true;
            self.filter.center_px = merged.center_px;
        }
        if self.missed_count > settings.coast_frame_count {
            self.state = TrackState::Acquire;
        } else if self.state == TrackState::Track {
            self.state = TrackState::Coast;
        }
    }

    fn is_worth_keeping(&self, settings: &TrackerSettings) -> bool {
        if self.was_confirmed {
            self.missed_count <= settings.memory_frame_count
        } else {
            // Three of four are out of reach after two misses in a row.
            self.missed_count < 2
        }
    }

    fn remember_brightness(&mut self, pair: &MarkerPair, captured_at: Timestamp) {
        if self.history_len == HISTORY_LEN {
            self.history.rotate_left(1);
            self.history_len -= 1;
        }
        self.history[self.history_len] = Brightness {
            time_s: captured_at.seconds(),
            log_flux: (pair.lights[0].flux + pair.lights[1].flux).ln(),
        };
        self.history_len += 1;
    }

    fn show(&self, now: Timestamp) -> MarkerTrack {
        let [u_px, v_px] = self.filter.center_px;
        MarkerTrack {
            id: self.id,
            state: self.state,
            age_s: (now - self.measured_at).max(0.0),
            u_px,
            v_px,
            separation_px: self.filter.separation_px(),
            sigma_separation_px: self.filter.sigma_separation_px(),
            rate_per_s: self.filter.rate_per_s,
            log_peak_bounds: self.log_peak_bounds,
            merged: self.merged,
        }
    }
}

impl EgoMotion {
    /// Where something far away that was seen here before the turn is seen after it.
    fn moved(&self, pixel: [f64; 2]) -> [f64; 2] {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let ray = Vector3::new((pixel[0] - cx) / fx, (pixel[1] - cy) / fy, 1.0);
        let turned = self.now_from_before * ray;
        if turned.z <= 0.0 {
            return pixel;
        }
        [fx * turned.x / turned.z + cx, fy * turned.y / turned.z + cy]
    }
}

#[cfg(test)]
mod tests;

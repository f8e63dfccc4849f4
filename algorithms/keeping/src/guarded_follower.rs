//! The follower of the paper's flight test behind the safety filter: marker tracks of one camera
//! in, a velocity out.

use nalgebra::{UnitQuaternion, Vector3};

use crate::follower::{FeedForward, Follower, FollowerSettings, LightPair, PlanarVelocity};
use crate::markers::{MarkerTrack, TrackId, TrackState};
use crate::mount::CameraMount;
use crate::own_motion::OwnMotion;
use crate::safety::{self, Flight, Limit, Limits, OBSTACLE_COUNT_MAX, Obstacle, SafetySettings};
use crate::sighting::Sighting;
use crate::tracks::{TrackSettings, Tracks};
use crate::turn::Turn;

/// Where the vehicle holds its place, and what keeps it from coming too near.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardedFollowerSettings {
    pub follower: FollowerSettings,
    pub tracks: TrackSettings,
    pub safety: SafetySettings,
    /// Time constant with which the vehicle takes up a commanded velocity. With a wrong one the
    /// other's speed is found later.
    pub lag_s: f64,
    /// The followed lights are known by their brightness; after so long without them, by nothing.
    pub forget_s: f64,
    /// Away from where the camera looks: it does not see what is there.
    pub backward_mps_max: f64,
}

impl GuardedFollowerSettings {
    /// Behind a neighbour in the middle of the camera's picture, with feed-forward.
    pub fn calibrated(mount: &CameraMount) -> Self {
        let intrinsics = mount.camera.intrinsics();
        let feed_forward = FeedForward {
            range_times_separation_m_px: intrinsics.fy * mount.markers.length_m,
            focal_px: intrinsics.fx,
            smoothing_s: 0.5,
        };
        Self {
            follower: FollowerSettings {
                feed_forward: Some(feed_forward),
                ..FollowerSettings::calibrated(intrinsics.cx)
            },
            tracks: TrackSettings::default(),
            safety: SafetySettings::default(),
            lag_s: 0.3,
            forget_s: 1.0,
            backward_mps_max: 0.2,
        }
    }

    /// How far behind the other the place is.
    pub fn place_m(&self, mount: &CameraMount) -> f64 {
        mount.camera.intrinsics().fy * mount.markers.length_m / self.follower.separation_px
    }
}

/// What is commanded, and what it comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GuardedCommand {
    /// Heading frame: forward, left, up. The height is left to the autopilot.
    pub velocity: Vector3<f64>,
    /// The lights that are followed, where this image shows them.
    pub seen: Option<LightPair>,
    /// What the filter took from the velocity that the controllers wanted.
    pub withheld_mps: f64,
}

/// Holds a vehicle's place behind another one. It allocates nothing.
#[derive(Clone, Debug)]
pub struct GuardedFollower {
    settings: GuardedFollowerSettings,
    /// In axes that the camera looks ahead in.
    mount: CameraMount,
    azimuth_rad: f64,
    follower: Follower,
    tracks: Tracks,
    limits: Limits,
    followed: Option<TrackId>,
    /// Logarithm of the peak of the followed lights, at least, at a separation of one pixel.
    log_peak_at_one_px: Option<f64>,
    /// Since the followed lights were seen.
    unseen_s: f64,
    own: OwnMotion,
}

/// More neighbours than this are not in one picture.
const SIGHTING_COUNT_MAX: usize = 16;
/// Lights of one team differ by less than a factor of four: their makes, their ages, their sides.
const LOG_FAINT: f64 = 2.0 * std::f64::consts::LN_2;
/// Share of a new image in what is known of the lights' brightness.
const BRIGHTNESS_GAIN: f64 = 0.1;
/// Who is steeper above or below is not kept clear of by level motion.
const LEVEL_SHARE_MIN: f64 = 0.1;

impl GuardedFollower {
    /// - `mount`: how the camera looks out of the vehicle, to whichever side; its rows are about
    ///   level.
    pub fn new(settings: GuardedFollowerSettings, mount: CameraMount) -> Self {
        let azimuth_rad = mount.azimuth_rad();
        let ahead_from_heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -azimuth_rad);
        Self {
            mount: CameraMount {
                heading_from_camera: ahead_from_heading * mount.heading_from_camera,
                ..mount
            },
            azimuth_rad,
            follower: Follower::new(settings.follower),
            tracks: Tracks::new(settings.tracks),
            limits: Limits::default(),
            followed: None,
            log_peak_at_one_px: None,
            unseen_s: 0.0,
            own: OwnMotion::new(settings.lag_s),
            settings,
        }
    }

    /// What to fly after an image.
    ///
    /// - `tracks`: the camera's marker tracks as of this image.
    /// - `obstacles`: what is known of them, the nearest first, in the heading frame.
    /// - `step_s`: since the image before.
    pub fn step(
        &mut self,
        tracks: &[MarkerTrack],
        obstacles: &[Obstacle],
        step_s: f64,
    ) -> GuardedCommand {
        self.own.advance(step_s);
        let seen = self.choose(tracks, step_s).map(|track| LightPair {
            separation_px: track.separation_px,
            lateral_px: track.u_px,
        });
        let own = PlanarVelocity {
            forward_mps: self.own.velocity().x,
            left_mps: self.own.velocity().y,
        };
        let wanted = self.follower.step(seen, own, step_s).velocity;
        let wanted = Vector3::new(wanted.forward_mps, wanted.left_mps, 0.0);
        self.limits.clear();
        self.limit_speeds();
        self.limit_by_neighbours(tracks, step_s);
        self.limit_by_obstacles(obstacles);
        let velocity = self.capped(safety::limit(&wanted, &self.limits));
        self.own.command(&velocity);
        GuardedCommand {
            velocity: Turn::by(self.azimuth_rad).of(&velocity),
            seen,
            withheld_mps: (self.capped(wanted) - velocity).norm(),
        }
    }

    /// The one that was followed, else the one nearest to the place; `None` where this image does
    /// not show it.
    fn choose<'a>(&mut self, tracks: &'a [MarkerTrack], step_s: f64) -> Option<&'a MarkerTrack> {
        self.unseen_s += step_s;
        if self.unseen_s > self.settings.forget_s {
            // Lamps dim and exposures change: nobody is left alone for that.
            self.log_peak_at_one_px = None;
        }
        let is_known = |track: &&MarkerTrack| {
            track.is_confirmed() && !track.merged && !self.is_too_faint(track)
        };
        let chosen = tracks
            .iter()
            .filter(is_known)
            .find(|track| Some(track.id) == self.followed)
            .or_else(|| {
                let known = tracks.iter().filter(is_known);
                known.min_by(|a, b| self.misplacement(a).total_cmp(&self.misplacement(b)))
            })?;
        self.followed = Some(chosen.id);
        if chosen.state != TrackState::Track {
            return None;
        }
        self.unseen_s = 0.0;
        let log_peak_at_one_px = chosen.log_peak_bounds[0] - 2.0 * chosen.separation_px.ln();
        let before = self.log_peak_at_one_px.get_or_insert(log_peak_at_one_px);
        *before += (log_peak_at_one_px - *before) * BRIGHTNESS_GAIN;
        Some(chosen)
    }

    /// How far from the commanded place a track is, in the logarithm of its range and radians.
    fn misplacement(&self, track: &MarkerTrack) -> f64 {
        let settings = &self.settings.follower;
        let aside_px = track.u_px - settings.lateral_px;
        (track.separation_px / settings.separation_px).ln().abs()
            + aside_px.abs() / self.mount.camera.intrinsics().fx
    }

    /// All vehicles carry the same lights, which are the brighter the nearer they are: who looks
    /// nearer than the one that is followed and is much fainter than that is part of a pattern.
    fn is_too_faint(&self, track: &MarkerTrack) -> bool {
        let log_peak_at_one_px = track.log_peak_bounds[1] - 2.0 * track.separation_px.ln();
        let is_fainter = |followed: f64| log_peak_at_one_px < followed - LOG_FAINT;
        Some(track.id) != self.followed && self.log_peak_at_one_px.is_some_and(is_fainter)
    }

    /// In whole, not by cutting what the filter allows: less to one side may be nearer to another.
    fn limit_speeds(&mut self) {
        let fastest_mps = self.settings.follower.speed_mps_max;
        let sides = [
            (Vector3::x(), fastest_mps),
            (-Vector3::x(), self.settings.backward_mps_max),
            (Vector3::y(), fastest_mps),
            (-Vector3::y(), fastest_mps),
        ];
        for (direction, speed_mps_max) in sides {
            // Room for these, all tracks and all obstacles is reserved.
            let _ = self.limits.push(Limit {
                direction,
                speed_mps_max,
            });
        }
    }

    /// Everybody in sight is kept clear of, followed or not.
    fn limit_by_neighbours(&mut self, tracks: &[MarkerTrack], step_s: f64) {
        let mut sightings = [Sighting::default(); SIGHTING_COUNT_MAX];
        let mut count = 0;
        let shown = tracks
            .iter()
            .filter(|track| track.state == TrackState::Track && !self.is_too_faint(track));
        for sighting in shown.filter_map(|track| self.mount.sighting_of_track(track)) {
            if let Some(place) = sightings.get_mut(count) {
                *place = sighting;
                count += 1;
            }
        }
        // The heading is held, so that these are level axes too.
        self.tracks.update(&sightings[..count], 0.0, step_s);
        let flight = Flight {
            nominal: Vector3::zeros(),
            velocity: *self.own.velocity(),
        };
        for track in self.tracks.tracks() {
            let safety = &self.settings.safety;
            let limit = safety.neighbour_limit(track.direction_in_level, track, &flight);
            if let Some(limit) = limit.as_ref().and_then(level) {
                let _ = self.limits.push(limit);
            }
        }
    }

    fn limit_by_obstacles(&mut self, obstacles: &[Obstacle]) {
        let ahead_from_heading = Turn::by(-self.azimuth_rad);
        for obstacle in obstacles.iter().take(OBSTACLE_COUNT_MAX) {
            let turned = Obstacle {
                direction: ahead_from_heading.of(&obstacle.direction),
                ..*obstacle
            };
            let _ = self
                .limits
                .push(self.settings.safety.obstacle_limit(&turned));
        }
    }

    /// Where limits contradict each other, at least the speeds are kept.
    fn capped(&self, velocity: Vector3<f64>) -> Vector3<f64> {
        let speed_mps_max = self.settings.follower.speed_mps_max;
        let backward_mps_max = self.settings.backward_mps_max;
        Vector3::new(
            velocity.x.clamp(-backward_mps_max, speed_mps_max),
            velocity.y.clamp(-speed_mps_max, speed_mps_max),
            0.0,
        )
    }
}

/// The limit as level motion keeps it; `None` if that cannot.
fn level(limit: &Limit) -> Option<Limit> {
    let level = Vector3::new(limit.direction.x, limit.direction.y, 0.0);
    let share = level.norm();
    (share >= LEVEL_SHARE_MIN).then(|| Limit {
        direction: level / share,
        speed_mps_max: limit.speed_mps_max / share,
    })
}

#[cfg(test)]
mod tests;

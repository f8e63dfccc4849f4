//! From images to velocities, without a clock.

use camera::{Calibration, Image};
use geometry::Timestamp;
use keeping::markers::{CameraMarkers, FinderSettings, TrackerSettings};
use keeping::{GuardedCommand, GuardedFollower, GuardedFollowerSettings, MarkerModel, Obstacle};
use nalgebra::Vector3;

/// Which place is held, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StationSettings {
    /// Between the two lights that every vehicle carries, one above the other.
    pub light_distance_m: f64,
    /// How far apart they shall be in the picture: the commanded distance.
    pub separation_px: f64,
    /// Where between left and right they shall be; without it, on the optical axis.
    pub lateral_px: Option<f64>,
    /// Centres of vehicles stay this far apart.
    pub distance_m_min: f64,
    pub speed_mps_max: f64,
}

/// The commanded place is where the safety filter lets nobody come.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the place is {place_m:.2} m behind the lights, nearer than the smallest distance of \
     {distance_m_min} m"
)]
pub struct TooNear {
    pub place_m: f64,
    pub distance_m_min: f64,
}

/// What was commanded because of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StationMoment {
    pub captured_at: Timestamp,
    pub command: GuardedCommand,
}

/// Holds the place. It allocates nothing.
#[derive(Clone, Debug)]
pub struct StationKeeper {
    markers: CameraMarkers,
    follower: GuardedFollower,
    hold_s: f64,
    decay_s: f64,
    newest: Option<StationMoment>,
}

impl StationKeeper {
    pub fn new(settings: &StationSettings, calibration: &Calibration) -> Result<Self, TooNear> {
        let camera = &calibration.camera;
        let marker = MarkerModel {
            length_m: settings.light_distance_m,
            ..MarkerModel::default()
        };
        let mut guarded = GuardedFollowerSettings::calibrated(camera, marker);
        guarded.safety.distance_m_min = settings.distance_m_min;
        let follower = &mut guarded.follower;
        follower.separation_px = settings.separation_px;
        follower.lateral_px = settings.lateral_px.unwrap_or(follower.lateral_px);
        follower.speed_mps_max = settings.speed_mps_max;
        let place_m = guarded.place_m(camera);
        if place_m <= settings.distance_m_min {
            return Err(TooNear {
                place_m,
                distance_m_min: settings.distance_m_min,
            });
        }
        let finder = FinderSettings::default();
        let tracker = TrackerSettings::default();
        Ok(Self {
            markers: CameraMarkers::new(finder, tracker, camera.width()),
            hold_s: guarded.follower.hold_s,
            decay_s: guarded.follower.decay_s,
            follower: GuardedFollower::new(guarded, camera.clone(), calibration.body_from_camera),
            newest: None,
        })
    }

    /// Takes an image in; one that is not newer than the last changes nothing.
    ///
    /// - `obstacles`: what is known of them now, in the heading frame, the nearest first.
    pub fn see(
        &mut self,
        captured_at: Timestamp,
        image: &Image,
        obstacles: &[Obstacle],
    ) -> Option<StationMoment> {
        let before = self.newest.map(|moment| moment.captured_at);
        if before.is_some_and(|before| before >= captured_at) {
            return None;
        }
        let (_, tracks) = self.markers.see(image, captured_at, None);
        let step_s = before.map_or(0.0, |before| captured_at - before);
        let command = self.follower.step(tracks, obstacles, step_s);
        let moment = StationMoment {
            captured_at,
            command,
        };
        self.newest = Some(moment);
        Some(moment)
    }

    /// What to fly at a time after the newest image: the same for a moment, then less and less,
    /// since a camera that has fallen silent shows nobody who is near.
    pub fn velocity_at(&self, now: Timestamp) -> Vector3<f64> {
        let Some(newest) = &self.newest else {
            return Vector3::zeros();
        };
        let silent_s = (now - newest.captured_at - self.hold_s).max(0.0);
        newest.command.velocity * (-silent_s / self.decay_s).exp()
    }
}

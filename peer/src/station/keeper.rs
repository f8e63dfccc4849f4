//! From images to velocities, without a clock.

use std::f64::consts::FRAC_PI_2;

use camera::{Calibration, Image};
use geometry::Timestamp;
use keeping::markers::{CameraMarkers, FinderSettings, FramePairs, MarkerTrack, TrackerSettings};
use keeping::mount::{self, Sightings};
use keeping::{
    CameraMount, FieldOfView, GuardedFollower, GuardedFollowerSettings, Keeper, KeeperSettings,
    LightPair, MarkerModel, Obstacle, Perception, SafetySettings,
};
use nalgebra::Vector3;

/// Which place is held, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StationSettings {
    /// Between the two lights that every vehicle carries, one above the other.
    pub light_distance_m: f64,
    /// Centres of vehicles stay this far apart.
    pub distance_m_min: f64,
    pub rule: StationRule,
}

/// By which rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StationRule {
    /// Behind one other vehicle, as in the paper's flight test.
    Follow {
        /// How far apart its lights shall be in the picture: the commanded distance.
        separation_px: f64,
        /// Where between left and right they shall be; without it, on the optical axis.
        lateral_px: Option<f64>,
        speed_mps_max: f64,
    },
    /// Among all neighbours, by the first shell.
    Gabriel {
        /// Between neighbours.
        preferred_m: f64,
        /// The speed common to the swarm, along the heading.
        speed_mps: f64,
    },
}

/// Why a place cannot be held.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StationError {
    /// The commanded place is where the safety filter lets nobody come.
    #[error(
        "the place is {place_m:.2} m from the next vehicle, and the smallest distance is \
         {distance_m_min} m: another separation_px, preferred_m or distance_m_min is needed"
    )]
    TooNear { place_m: f64, distance_m_min: f64 },
    #[error("the calibration does not hold at the borders of the image")]
    View,
}

/// What was commanded because of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StationMoment {
    pub captured_at: Timestamp,
    /// Heading frame: forward, left, up.
    pub velocity: Vector3<f64>,
    /// Neighbours whose lights this image shows, apart or merged.
    pub neighbour_count: usize,
    /// The lights that are followed, where this image shows them.
    pub followed: Option<LightPair>,
    /// What the safety filter took from what a follower's controllers wanted.
    pub withheld_mps: f64,
}

/// Holds the place.
#[derive(Clone, Debug)]
pub struct StationKeeper {
    markers: CameraMarkers,
    mount: CameraMount,
    pilot: Pilot,
    newest: Option<StationMoment>,
}

#[derive(Clone, Debug)]
enum Pilot {
    Follower(Box<GuardedFollower>),
    Swarm(Box<SwarmPilot>),
}

/// The rule with what it needs to know of the vehicle itself.
#[derive(Clone, Debug)]
struct SwarmPilot {
    keeper: Keeper,
    view: FieldOfView,
    sightings: Sightings,
    speed_mps: f64,
    /// As far as the autopilot has taken up what was commanded.
    own: Vector3<f64>,
    commanded: Vector3<f64>,
}

/// A camera that is silent for longer shows nobody who is near: what was commanded decays.
const HOLD_S: f64 = 0.3;
const DECAY_S: f64 = 0.2;
/// Room for gusts, of the way from the smallest distance to the place: a place near the smallest
/// distance leaves less than the filter would take.
const ROOM_FOR_GUSTS_SHARE: f64 = 0.5;
/// Time constant with which a small vehicle takes up a velocity.
const LAG_S: f64 = 0.3;

impl StationKeeper {
    pub fn new(
        settings: &StationSettings,
        calibration: &Calibration,
    ) -> Result<Self, StationError> {
        let mount = CameraMount {
            camera: calibration.camera.clone(),
            heading_from_camera: *calibration.body_from_camera.rotation(),
            baseline_rad: FRAC_PI_2,
            markers: MarkerModel {
                length_m: settings.light_distance_m,
                ..MarkerModel::default()
            },
        };
        let pilot = match settings.rule {
            StationRule::Follow {
                separation_px,
                lateral_px,
                speed_mps_max,
            } => {
                let mut guarded = GuardedFollowerSettings::calibrated(&mount);
                let follower = &mut guarded.follower;
                follower.separation_px = separation_px;
                follower.lateral_px = lateral_px.unwrap_or(follower.lateral_px);
                follower.speed_mps_max = speed_mps_max;
                guarded.safety = safety(settings.distance_m_min, guarded.place_m(&mount))?;
                Pilot::Follower(Box::new(GuardedFollower::new(guarded, mount.clone())))
            }
            StationRule::Gabriel {
                preferred_m,
                speed_mps,
            } => {
                let safety = safety(settings.distance_m_min, preferred_m)?;
                let pilot = SwarmPilot::new(safety, preferred_m, speed_mps, &mount);
                Pilot::Swarm(Box::new(pilot.ok_or(StationError::View)?))
            }
        };
        let width_px = mount.camera.width();
        Ok(Self {
            markers: CameraMarkers::new(
                FinderSettings::default(),
                TrackerSettings::default(),
                width_px,
            ),
            mount,
            pilot,
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
        let step_s = before.map_or(0.0, |before| captured_at - before);
        let (frame, tracks) = self.markers.see(image, captured_at, None);
        let moment = match &mut self.pilot {
            Pilot::Follower(follower) => {
                let command = follower.step(tracks, obstacles, step_s);
                let seen = tracks
                    .iter()
                    .filter(|track| self.mount.sighting_of_track(track).is_some());
                StationMoment {
                    captured_at,
                    velocity: command.velocity,
                    neighbour_count: seen.count(),
                    followed: command.seen,
                    withheld_mps: command.withheld_mps,
                }
            }
            Pilot::Swarm(pilot) => {
                pilot.look(&self.mount, &frame, tracks);
                StationMoment {
                    captured_at,
                    velocity: pilot.step(obstacles, step_s),
                    neighbour_count: pilot.sightings.len(),
                    followed: None,
                    withheld_mps: 0.0,
                }
            }
        };
        self.newest = Some(moment);
        Some(moment)
    }

    /// What to fly at a time after the newest image: the same for a moment, then less and less.
    pub fn velocity_at(&self, now: Timestamp) -> Vector3<f64> {
        let Some(newest) = &self.newest else {
            return Vector3::zeros();
        };
        let silent_s = (now - newest.captured_at - HOLD_S).max(0.0);
        newest.velocity * (-silent_s / DECAY_S).exp()
    }
}

/// The filter for a place at this distance from the next vehicle.
fn safety(distance_m_min: f64, place_m: f64) -> Result<SafetySettings, StationError> {
    if place_m <= distance_m_min {
        return Err(StationError::TooNear {
            place_m,
            distance_m_min,
        });
    }
    let safety = SafetySettings::default();
    let room_m = ROOM_FOR_GUSTS_SHARE * (place_m - distance_m_min);
    Ok(SafetySettings {
        distance_m_min,
        gust_m: safety.gust_m.min(room_m),
        ..safety
    })
}

impl SwarmPilot {
    /// `None` if the camera's view cannot be told.
    fn new(
        safety: SafetySettings,
        preferred_m: f64,
        speed_mps: f64,
        mount: &CameraMount,
    ) -> Option<Self> {
        let mut keeper = KeeperSettings {
            safety,
            ..KeeperSettings::default()
        };
        let forward_share = keeper.rule.preferred_forward_m / keeper.rule.preferred_m;
        keeper.rule.preferred_m = preferred_m;
        keeper.rule.preferred_forward_m = forward_share * preferred_m;
        Some(Self {
            keeper: Keeper::new(keeper),
            view: mount.view()?,
            sightings: Sightings::default(),
            speed_mps,
            own: Vector3::zeros(),
            commanded: Vector3::zeros(),
        })
    }

    fn look(&mut self, mount: &CameraMount, frame: &FramePairs<'_>, tracks: &[MarkerTrack]) {
        self.sightings.clear();
        let apart = tracks
            .iter()
            .filter_map(|track| mount.sighting_of_track(track));
        let merged = frame
            .merged
            .iter()
            .filter_map(|merged| mount.sighting_of_merged(merged));
        for sighting in apart.chain(merged) {
            mount::join(&mut self.sightings, sighting);
        }
    }

    fn step(&mut self, obstacles: &[Obstacle], step_s: f64) -> Vector3<f64> {
        self.own += (self.commanded - self.own) * (1.0 - (-step_s / LAG_S).exp());
        let perception = Perception {
            sightings: &self.sightings,
            obstacles,
            views: &[self.view],
            // The autopilot holds the heading that the vehicle began with.
            heading_rad: 0.0,
            velocity: self.own,
            nominal_mps: self.speed_mps,
        };
        self.commanded = self.keeper.step(&perception, step_s).velocity;
        self.commanded
    }
}

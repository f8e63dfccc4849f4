//! From images to velocities, without a clock.

use std::f64::consts::FRAC_PI_2;

use camera::{Calibration, Image};
use geometry::Timestamp;
use keeping::markers::{CameraMarkers, FinderSettings, FramePairs, MarkerTrack, TrackerSettings};
use keeping::mount::{self, Sightings};
use keeping::safety::OBSTACLE_COUNT_MAX;
use keeping::{
    Bounded, CameraMount, FieldOfView, GuardedFollower, GuardedFollowerSettings, Keeper,
    KeeperSettings, LightPair, MarkerModel, Obstacle, OwnMotion, Perception, SafetySettings, held,
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
    /// Lights one above the other would not look like that.
    #[error(
        "the camera is turned by {roll_deg:.0}° about its axis or looks up or down too far \
         (T_BS of its calibration): it is to be mounted with its rows level to {ROLL_DEG_MAX}°"
    )]
    NotUpright { roll_deg: f64 },
    #[error("the camera does not cover level, or its calibration does not hold at its borders")]
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
    own: OwnMotion,
}

/// Room for gusts, of the way from the smallest distance to the place: a place near the smallest
/// distance leaves less than the filter would take.
const ROOM_FOR_GUSTS_SHARE: f64 = 0.5;
/// Time constant with which a small vehicle takes up a velocity.
const LAG_S: f64 = 0.3;
/// As far as a pair may be tilted for the finder.
const ROLL_DEG_MAX: f64 = 20.0;

impl StationKeeper {
    pub fn new(
        settings: &StationSettings,
        calibration: &Calibration,
    ) -> Result<Self, StationError> {
        let mount = mount_of(settings, calibration)?;
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
        let finder = FinderSettings {
            baseline_rad: mount.baseline_rad,
            ..FinderSettings::default()
        };
        let tracker = TrackerSettings::default();
        Ok(Self {
            markers: CameraMarkers::new(finder, tracker, mount.camera.width()),
            mount,
            pilot,
            newest: None,
        })
    }

    /// Takes an image in; one that is not newer than the last changes nothing.
    ///
    /// - `obstacles`: what a map shows, in the heading frame, the nearest first. A map may be
    ///   wrong: it stops the vehicle, and never drives it.
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
        let clearance_m_min = SafetySettings::default().clearance_m_min;
        let mut stopping: Bounded<Obstacle, OBSTACLE_COUNT_MAX> = Bounded::default();
        for obstacle in obstacles.iter().take(OBSTACLE_COUNT_MAX) {
            let _ = stopping.push(Obstacle {
                clearance_m: obstacle.clearance_m.max(clearance_m_min),
                ..*obstacle
            });
        }
        let obstacles: &[Obstacle] = &stopping;
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
        held(&newest.velocity, now - newest.captured_at)
    }
}

/// The body is taken to be level.
fn mount_of(
    settings: &StationSettings,
    calibration: &Calibration,
) -> Result<CameraMount, StationError> {
    let mut mount = CameraMount {
        camera: calibration.camera.clone(),
        heading_from_camera: *calibration.body_from_camera.rotation(),
        baseline_rad: FRAC_PI_2,
        markers: MarkerModel {
            length_m: settings.light_distance_m,
            ..MarkerModel::default()
        },
    };
    let upright_rad = mount.upright_rad().unwrap_or(0.0);
    let roll_deg = (upright_rad.abs() - FRAC_PI_2).abs().to_degrees();
    if roll_deg > ROLL_DEG_MAX {
        return Err(StationError::NotUpright { roll_deg });
    }
    mount.baseline_rad = upright_rad;
    Ok(mount)
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
            own: OwnMotion::new(LAG_S),
        })
    }

    fn look(&mut self, mount: &CameraMount, frame: &FramePairs<'_>, tracks: &[MarkerTrack]) {
        self.sightings.clear();
        for sighting in mount.sightings(frame, tracks) {
            mount::join(&mut self.sightings, sighting);
        }
    }

    fn step(&mut self, obstacles: &[Obstacle], step_s: f64) -> Vector3<f64> {
        self.own.advance(step_s);
        let perception = Perception {
            sightings: &self.sightings,
            obstacles,
            views: &[self.view],
            // The autopilot holds the heading that the vehicle began with.
            heading_rad: 0.0,
            velocity: *self.own.velocity(),
            nominal_mps: self.speed_mps,
        };
        let velocity = self.keeper.step(&perception, step_s).velocity;
        self.own.command(&velocity);
        velocity
    }
}

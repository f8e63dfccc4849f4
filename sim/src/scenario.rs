//! Worlds with vehicles in them.

mod lab;

use std::time::Duration;

use camera::{CameraModel, Distortion, Intrinsics};
use geometry::{Body, Camera, Enu, Timestamp, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::marker_light::MarkerLights;
use crate::position_source::PositionSourceSettings;
use crate::renderer::{Neighbour, Scene, SensorSettings, Shot, gain_at};
use crate::route::{Motion, Route};
use crate::stream::Fix;
use crate::world::{Cuboid, World};

/// The scenarios that can be asked for by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScenarioName {
    /// A room of 10 × 8 × 3 m with a ground vehicle and two drones.
    #[default]
    Lab,
}

/// What is known about a vehicle before it moves; its configuration may say all of it.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleDescription {
    pub id: &'static str,
    pub camera: CameraModel,
    /// The body's origin is the camera's centre, so this is a rotation alone.
    pub body_from_camera: Transform<Body, Camera>,
    /// Whether fixes come; they are positions of the camera's centre in the site frame.
    pub has_position_source: bool,
    /// What others see it by.
    pub lights: Option<MarkerLights>,
    /// Whether it holds its place among the others, flown by the velocities that it commands.
    pub keeps_place: bool,
}

impl ScenarioName {
    pub fn name(self) -> &'static str {
        match self {
            Self::Lab => "lab",
        }
    }

    /// The vehicles, anchors first. They are the same for every seed.
    pub fn vehicles(self) -> Vec<VehicleDescription> {
        match self {
            Self::Lab => lab_vehicles(),
        }
    }
}

/// A world, its vehicles, and all that they do in it: the truth.
pub struct Scenario {
    pub seed: u64,
    pub world: World,
    pub vehicles: Vec<Vehicle>,
    pub frame_count: usize,
    pub frame_rate_hz: f64,
    pub position_source: PositionSourceSettings,
}

/// A vehicle and its way.
pub struct Vehicle {
    pub description: VehicleDescription,
    pub sensor: SensorSettings,
    /// Where it goes by itself. One that keeps its place is carried away from there by its
    /// commands: see [`crate::Flight`].
    pub route: Route,
    /// What others see of it, in its body's frame.
    pub hull: Vec<Cuboid>,
}

/// The clock of every vehicle says this when the routes begin.
const START: Timestamp = Timestamp::from_nanoseconds(10_000_000_000);

/// What every clock of a simulation says at a time since the start.
pub fn timestamp_at(time_s: f64) -> Timestamp {
    START.after(Duration::from_secs_f64(time_s.max(0.0)))
}

impl Scenario {
    pub fn new(name: ScenarioName, seed: u64) -> Self {
        match name {
            ScenarioName::Lab => Self::lab(seed),
        }
    }

    /// The rendered lab of the demo: 52 s at 10 Hz.
    pub fn lab(seed: u64) -> Self {
        let world = World::lab(seed);
        let routes = lab::routes(&world, seed);
        let vehicles = lab_vehicles().into_iter().zip(routes);
        let frame_rate_hz = 10.0;
        Self {
            seed,
            vehicles: vehicles
                .map(|(description, route)| Vehicle {
                    hull: match description.lights {
                        Some(lights) => lab::drone_hull(&lights),
                        None => lab::ground_vehicle_hull(),
                    },
                    description,
                    sensor: SensorSettings::default(),
                    route,
                })
                .collect(),
            world,
            frame_count: (lab::DURATION_S * frame_rate_hz) as usize,
            frame_rate_hz,
            position_source: PositionSourceSettings::default(),
        }
    }

    /// The world as cameras see it, with the hulls of its vehicles; this takes about a second.
    pub fn paint(&self) -> Scene {
        let hulls = self.vehicles.iter().map(|vehicle| vehicle.hull.as_slice());
        Scene::paint(&self.world).with_hulls(hulls)
    }

    /// When a frame is captured, in seconds since the start.
    pub fn frame_time_s(&self, frame_idx: usize) -> f64 {
        frame_idx as f64 / self.frame_rate_hz
    }

    /// What a vehicle's clock says at a time since the start.
    pub fn timestamp(&self, time_s: f64) -> Timestamp {
        timestamp_at(time_s)
    }

    /// Where a vehicle's camera is on its route.
    pub fn site_from_camera(&self, vehicle_idx: usize, time_s: f64) -> Transform<Enu, Camera> {
        let vehicle = &self.vehicles[vehicle_idx];
        vehicle.route.pose(time_s) * vehicle.description.body_from_camera
    }

    /// All that a vehicle's camera needs for a frame on its route.
    pub fn shot(&self, vehicle_idx: usize, frame_idx: usize) -> Shot {
        let time_s = self.frame_time_s(frame_idx);
        let motion = self.vehicles[vehicle_idx].route.motion(time_s);
        self.shot_in_motion(vehicle_idx, frame_idx, &motion)
    }

    /// All that a vehicle's camera needs for a frame when the vehicle moves like this.
    pub fn shot_in_motion(&self, vehicle_idx: usize, frame_idx: usize, motion: &Motion) -> Shot {
        let phase_rad = (self.seed % 64) as f64 + 2.0 * vehicle_idx as f64;
        Shot {
            gain: gain_at(self.frame_time_s(frame_idx), phase_rad),
            noise_seed: self.seed.rotate_left(40) ^ ((vehicle_idx as u64) << 32) ^ frame_idx as u64,
            ..motion.shot(&self.vehicles[vehicle_idx].description.body_from_camera)
        }
    }

    /// The other vehicles as one of them may see them.
    pub fn neighbours(&self, vehicle_idx: usize, motions: &[Motion]) -> Vec<Neighbour> {
        let others = motions.iter().enumerate();
        others
            .filter(|(other_idx, _)| *other_idx != vehicle_idx)
            .map(|(other_idx, motion)| Neighbour {
                hull_idx: other_idx,
                site_from_body: motion.site_from_body,
                lights: self.vehicles[other_idx].description.lights,
            })
            .collect()
    }

    /// The fixes of a vehicle in the order of their stamps; none without a position source.
    pub fn fixes(&self, vehicle_idx: usize) -> Vec<Fix> {
        if !self.vehicles[vehicle_idx].description.has_position_source {
            return Vec::new();
        }
        let duration_s = self.frame_time_s(self.frame_count);
        self.position_source
            .times_s(duration_s)
            .map(|time_s| {
                let truth = self.site_from_camera(vehicle_idx, time_s);
                let captured_at = self.timestamp(time_s);
                self.position_source
                    .fix(truth.translation(), captured_at, self.seed)
            })
            .collect()
    }
}

fn lab_vehicles() -> Vec<VehicleDescription> {
    let drone = |id, keeps_place| VehicleDescription {
        id,
        camera: drone_camera(),
        body_from_camera: mounted(0.0, DRONE_PITCH_DOWN_RAD),
        has_position_source: false,
        lights: Some(MarkerLights { length_m: 0.1 }),
        keeps_place,
    };
    let ground_vehicle = VehicleDescription {
        id: "ugv1",
        camera: ground_vehicle_camera(),
        body_from_camera: mounted(GROUND_VEHICLE_YAW_RAD, GROUND_VEHICLE_PITCH_DOWN_RAD),
        has_position_source: true,
        lights: None,
        keeps_place: false,
    };
    vec![
        ground_vehicle,
        drone("drone1", false),
        drone("drone2", true),
    ]
}

pub const DRONE_PITCH_DOWN_RAD: f64 = 0.14;
/// To the right, and back a little: where it turns the first corner it still sees the wall that
/// the drones look at.
const GROUND_VEHICLE_YAW_RAD: f64 = -std::f64::consts::FRAC_PI_2 - 0.2;
/// The camera near the floor looks up to where the drones look.
const GROUND_VEHICLE_PITCH_DOWN_RAD: f64 = -0.25;

/// The paper's drone, eq. 7. Its o_y lies far below the middle of the image and is kept.
pub fn drone_camera() -> CameraModel {
    let intrinsics = Intrinsics {
        fx: 180.9,
        fy: 180.94,
        cx: 159.23,
        cy: 155.72,
    };
    let distortion = Distortion::RadialTangential {
        k1: -0.045,
        k2: 0.012,
        p1: 0.0006,
        p2: -0.0004,
        k3: 0.0,
    };
    CameraModel::new(324, 244, intrinsics, distortion).expect("the constants are a camera")
}

/// The paper's ground vehicle, eq. 9.
fn ground_vehicle_camera() -> CameraModel {
    let intrinsics = Intrinsics {
        fx: 479.75,
        fy: 479.92,
        cx: 323.18,
        cy: 177.88,
    };
    let distortion = Distortion::RadialTangential {
        k1: 0.06,
        k2: -0.08,
        p1: -0.0005,
        p2: 0.0007,
        k3: 0.0,
    };
    CameraModel::new(640, 360, intrinsics, distortion).expect("the constants are a camera")
}

/// `body_from_camera` of a camera in the body's origin, turned to the left by `yaw_rad`, then
/// tilted down.
pub fn mounted(yaw_rad: f64, pitch_down_rad: f64) -> Transform<Body, Camera> {
    // Camera x (right) is body −y, camera y (down) is body −z, camera z (forward) is body x.
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let optical = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let pitch = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch_down_rad);
    Transform::new(yaw * pitch * optical, Vector3::zeros())
}

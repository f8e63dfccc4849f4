//! Worlds with vehicles in them.

use camera::{CameraModel, Distortion, Intrinsics};
use geometry::{Body, Camera, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

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

fn lab_vehicles() -> Vec<VehicleDescription> {
    let drone = |id| VehicleDescription {
        id,
        camera: drone_camera(),
        body_from_camera: mounted(0.0, DRONE_PITCH_DOWN_RAD),
        has_position_source: false,
    };
    let ground_vehicle = VehicleDescription {
        id: "ugv1",
        camera: ground_vehicle_camera(),
        body_from_camera: mounted(-std::f64::consts::FRAC_PI_2, GROUND_VEHICLE_PITCH_DOWN_RAD),
        has_position_source: true,
    };
    vec![ground_vehicle, drone("drone1"), drone("drone2")]
}

const DRONE_PITCH_DOWN_RAD: f64 = 0.14;
/// The camera near the floor looks up a little.
const GROUND_VEHICLE_PITCH_DOWN_RAD: f64 = -0.09;

/// The paper's drone, eq. 7. Its o_y lies far below the middle of the image and is kept.
fn drone_camera() -> CameraModel {
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

/// `body_from_camera` of a camera turned to the left by `yaw_rad`, then tilted down.
fn mounted(yaw_rad: f64, pitch_down_rad: f64) -> Transform<Body, Camera> {
    // Camera x (right) is body −y, camera y (down) is body −z, camera z (forward) is body x.
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let optical = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let pitch = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch_down_rad);
    Transform::new(yaw * pitch * optical, Vector3::zeros())
}

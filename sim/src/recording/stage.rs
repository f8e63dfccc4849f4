//! The world, the route and the camera of each kind of recording.

mod building;
mod hands;
mod lab;

use camera::{CameraModel, Distortion, Intrinsics};
use geometry::{Body, Camera, Transform};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::RecordingWorld;
use crate::route::Route;
use crate::world::World;

pub struct Stage {
    pub world: World,
    pub route: Route,
    pub camera: CameraModel,
    pub body_from_camera: Transform<Body, Camera>,
    pub duration_s: f64,
}

impl Stage {
    pub fn new(world: RecordingWorld, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0009);
        match world {
            RecordingWorld::Lab => lab::to_and_fro(seed),
            RecordingWorld::Round => lab::round(seed, &mut rng),
            RecordingWorld::Handheld => hands::handheld(seed, &mut rng),
            RecordingWorld::Office => building::office(seed, &mut rng),
            RecordingWorld::Board => hands::board(seed, &mut rng),
            RecordingWorld::Corridor => building::corridor(seed, &mut rng),
            RecordingWorld::Hover => lab::hover(seed, &mut rng),
            RecordingWorld::Still => lab::still(seed, &mut rng),
        }
    }
}

/// From 0 to 1 between two times, with continuous acceleration.
fn ramp(time_s: f64, from_s: f64, to_s: f64) -> f64 {
    let t = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}

/// A camera of 640×480 with about this focal length; no two have the same lens.
pub fn video_camera(focal_px: f64, rng: &mut impl Rng) -> CameraModel {
    let fx = focal_px * rng.random_range(0.96..1.04);
    let intrinsics = Intrinsics {
        fx,
        fy: fx * rng.random_range(0.998..1.002),
        cx: 319.5 + rng.random_range(-6.0..6.0),
        cy: 239.5 + rng.random_range(-6.0..6.0),
    };
    let distortion = Distortion::RadialTangential {
        k1: rng.random_range(-0.06..0.01),
        k2: rng.random_range(0.0..0.015),
        p1: rng.random_range(-5e-4..5e-4),
        p2: rng.random_range(-5e-4..5e-4),
        k3: 0.0,
    };
    CameraModel::new(640, 480, intrinsics, distortion).expect("all such numbers are a camera")
}

//! Vehicles that look at one place of a room for a while, each from its own side and height.

mod encounter;

use std::sync::Arc;

use camera::CameraModel;
use geometry::{Body, Camera, Enu, Timestamp, Transform};
use nalgebra::Vector3;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub use encounter::{Encounter, EncounterSettings};

use crate::recording::{RecordedFrame, video_camera};
use crate::renderer::{Renderer, Scene, SensorSettings, Shot, gain_at};
use crate::route::{Route, Waypoint, Wobble, WobbleSettings};
use crate::scenario::{mounted, timestamp_at};

/// Where a camera is, and what it looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standpoint {
    /// The middle of its way.
    pub place: Vector3<f64>,
    pub focus: Vector3<f64>,
}

/// A camera that goes to and fro sideways about its standpoint: 640×480 at 8 Hz for 10 s.
#[derive(Clone, Debug)]
pub struct Visit {
    seed: u64,
    route: Route,
    camera: CameraModel,
    body_from_camera: Transform<Body, Camera>,
}

const DURATION_S: f64 = 10.0;
const FRAME_RATE_HZ: f64 = 8.0;
const INTERVAL_S: f64 = 0.5;
const FOCAL_LENGTH_PX: f64 = 450.0;
/// To either side, and towards the focus and back.
const WAY_M: [f64; 2] = [0.6, 0.2];
const WOBBLE: WobbleSettings = WobbleSettings {
    shift_m: 0.01,
    tilt_rad: 0.015,
    rate_hz: [0.4, 1.4],
};

impl Standpoint {
    /// From the focus to the middle of the way.
    pub fn sight(&self) -> Vector3<f64> {
        self.place - self.focus
    }

    /// The place so far along the way: sideways and towards the focus, each from −1 to 1.
    fn on_way(&self, [sideways, ahead]: [f64; 2]) -> Vector3<f64> {
        let forward = -self.sight().xy().normalize().push(0.0);
        let left = Vector3::z().cross(&forward);
        self.place + left * (WAY_M[0] * sideways) + forward * (WAY_M[1] * ahead)
    }
}

impl Visit {
    /// - `seed`: of the lens, the way and the noise.
    pub fn new(standpoint: &Standpoint, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0010);
        let down_m = standpoint.sight().z;
        let pitch_down_rad = down_m.atan2(standpoint.sight().xy().norm());
        Self {
            seed,
            route: to_and_fro(standpoint, &mut rng),
            camera: video_camera(FOCAL_LENGTH_PX, &mut rng),
            body_from_camera: mounted(0.0, pitch_down_rad),
        }
    }

    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    pub fn frame_count(&self) -> usize {
        (DURATION_S * FRAME_RATE_HZ) as usize
    }

    /// Where the camera is at a frame.
    pub fn site_from_camera(&self, frame_idx: usize) -> Transform<Enu, Camera> {
        self.route.pose(time_s(frame_idx)) * self.body_from_camera
    }

    /// Stamps and poses of all frames, without rendering them.
    pub fn truth(&self) -> impl Iterator<Item = (Timestamp, Transform<Enu, Camera>)> + '_ {
        let truth = |idx| (timestamp_at(time_s(idx)), self.site_from_camera(idx));
        (0..self.frame_count()).map(truth)
    }

    /// Renders one frame after the other.
    pub fn frames(&self, scene: &Arc<Scene>) -> impl Iterator<Item = RecordedFrame> + '_ {
        let sensor = SensorSettings::default();
        let mut renderer = Renderer::new(Arc::clone(scene), &self.camera, sensor);
        (0..self.frame_count()).map(move |frame_idx| {
            let time_s = time_s(frame_idx);
            let shot = Shot {
                gain: gain_at(time_s, (self.seed % 64) as f64),
                noise_seed: self.seed.rotate_left(40) ^ frame_idx as u64,
                ..self.route.motion(time_s).shot(&self.body_from_camera)
            };
            RecordedFrame {
                captured_at: timestamp_at(time_s),
                site_from_camera: shot.site_from_camera,
                image: renderer.render_among(&shot, &[]),
            }
        })
    }
}

fn time_s(frame_idx: usize) -> f64 {
    frame_idx as f64 / FRAME_RATE_HZ
}

/// Once to one side and once to the other, nearer in between, with the eyes on the focus.
fn to_and_fro(standpoint: &Standpoint, rng: &mut impl Rng) -> Route {
    let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let (phase_rad, glance_rad) = (rng.random_range(0.0..6.0), rng.random_range(0.02..0.06));
    let waypoint = |idx: usize| {
        let turn = std::f64::consts::TAU * idx as f64 * INTERVAL_S / DURATION_S;
        let along = [side * turn.sin(), (2.0 * turn + phase_rad).sin()];
        let mut position = standpoint.on_way(along);
        position.z += 0.04 * (turn + phase_rad).sin();
        let ahead = standpoint.focus - position;
        Waypoint {
            position,
            yaw_rad: ahead.y.atan2(ahead.x),
        }
    };
    let mut waypoints: Vec<Waypoint> = Vec::new();
    for idx in 0..(DURATION_S / INTERVAL_S) as usize + 2 {
        let mut next = waypoint(idx);
        let last_rad = waypoints.last().map_or(next.yaw_rad, |last| last.yaw_rad);
        let turns = ((last_rad - next.yaw_rad) / std::f64::consts::TAU).round();
        next.yaw_rad += turns * std::f64::consts::TAU;
        waypoints.push(next);
    }
    for (idx, waypoint) in waypoints.iter_mut().enumerate() {
        waypoint.yaw_rad += glance_rad * (0.9 * idx as f64).sin();
    }
    Route::new(waypoints, INTERVAL_S, Wobble::new(&WOBBLE, rng))
}

#[cfg(test)]
mod tests;

//! A camera on a known path, a monocular map of it that drifts, and noisy fixes: for the tests.

use geometry::{Camera, Enu, Map, Timestamp, Transform, so3};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use vslam::KeyframeId;

use crate::georeference::LocalFix;
use crate::{FixPosition, FrameInput, KeyframePose, PositionFix};

/// Frames per second, metres per second and metres between keyframes.
const FRAME_RATE_HZ: f64 = 10.0;
const SPEED_M_PER_S: f64 = 0.5;
const KEYFRAME_EVERY: usize = 6;
/// Of the scene.
const DEPTH_M: f64 = 3.0;
/// Metres per unit of the map at its start.
pub(crate) const SCALE_M: f64 = 2.7;

pub(crate) struct Frame {
    pub(crate) captured_at: Timestamp,
    pub(crate) enu_from_camera: Transform<Enu, Camera>,
    pub(crate) map_from_camera: Transform<Map, Camera>,
    /// Metres per unit of the map, here.
    pub(crate) scale_m: f64,
    pub(crate) keyframe: Option<KeyframeId>,
}

pub(crate) struct Drift {
    pub(crate) log_scale_per_sqrt_m: f64,
    pub(crate) rotation_rad_per_sqrt_m: f64,
}

pub(crate) const NO_DRIFT: Drift = Drift {
    log_scale_per_sqrt_m: 0.0,
    rotation_rad_per_sqrt_m: 0.0,
};

/// 3 % of scale and 1.3° over 20 m.
pub(crate) const TYPICAL_DRIFT: Drift = Drift {
    log_scale_per_sqrt_m: 0.0067,
    rotation_rad_per_sqrt_m: 0.005,
};

pub(crate) struct Normal(ChaCha8Rng);

impl Normal {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn scalar(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    pub(crate) fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.scalar())
    }
}

/// A straight path to the east.
pub(crate) fn straight(s: f64) -> Vector3<f64> {
    Vector3::new(s, 2.0, 0.5)
}

/// East, then around a corner to the north.
pub(crate) fn with_a_turn(s: f64) -> Vector3<f64> {
    let corner = 8.0;
    let radius = 2.0;
    let arc = radius * std::f64::consts::FRAC_PI_2;
    if s < corner {
        return Vector3::new(s, 2.0, 0.5);
    }
    if s < corner + arc {
        let angle = (s - corner) / radius;
        return Vector3::new(
            corner + radius * angle.sin(),
            2.0 + radius * (1.0 - angle.cos()),
            0.5,
        );
    }
    Vector3::new(corner + radius, 2.0 + radius + s - corner - arc, 0.5)
}

/// Frames along a path that the camera looks along, in a map that drifts.
pub(crate) fn fly(
    path: impl Fn(f64) -> Vector3<f64>,
    length_m: f64,
    drift: &Drift,
    seed: u64,
) -> Vec<Frame> {
    fly_looking(0.0, path, length_m, drift, seed)
}

/// The same with the camera turned to the right by `yaw_rad`.
pub(crate) fn fly_looking(
    yaw_rad: f64,
    path: impl Fn(f64) -> Vector3<f64>,
    length_m: f64,
    drift: &Drift,
    seed: u64,
) -> Vec<Frame> {
    // The camera's y axis points down.
    let looking = Transform::new(so3::exp(&(Vector3::y() * yaw_rad)), Vector3::zeros());
    let mut normal = Normal::new(seed);
    let step_m = SPEED_M_PER_S / FRAME_RATE_HZ;
    let frame_count = (length_m / step_m) as usize;
    let mut frames: Vec<Frame> = Vec::new();
    let mut log_scale = 0.0;
    let first_in_map = Transform::new(so3::exp(&Vector3::new(0.4, -0.3, 0.9)), Vector3::zeros());
    for idx in 0..frame_count {
        let enu_from_camera = pose_on(&path, idx as f64 * step_m) * looking;
        let map_from_camera = match frames.last() {
            None => first_in_map,
            Some(last) => {
                let step = last.enu_from_camera.inverse() * enu_from_camera;
                let spread = step_m.sqrt();
                log_scale += drift.log_scale_per_sqrt_m * spread * normal.scalar();
                let turn = normal.vector() * (drift.rotation_rad_per_sqrt_m * spread);
                let scale_m = SCALE_M * f64::exp(log_scale);
                let units = step.translation() / scale_m;
                // What the camera looks at stays where it is.
                let scene = Vector3::z() * (DEPTH_M / scale_m);
                let turn = so3::exp(&turn);
                let shift = step.rotation() * (scene - turn * scene);
                last.map_from_camera * Transform::new(step.rotation() * turn, units + shift)
            }
        };
        frames.push(Frame {
            captured_at: at(idx as f64 / FRAME_RATE_HZ),
            enu_from_camera,
            map_from_camera,
            scale_m: SCALE_M * log_scale.exp(),
            keyframe: idx
                .is_multiple_of(KEYFRAME_EVERY)
                .then_some(KeyframeId((idx / KEYFRAME_EVERY) as u32)),
        });
    }
    frames
}

fn pose_on(path: &impl Fn(f64) -> Vector3<f64>, s: f64) -> Transform<Enu, Camera> {
    let forward = (path(s + 0.01) - path(s - 0.01)).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    Transform::new(UnitQuaternion::from_matrix(&axes), path(s))
}

pub(crate) fn at(seconds: f64) -> Timestamp {
    Timestamp::from_seconds(seconds).unwrap()
}

impl Frame {
    pub(crate) fn input(&self) -> FrameInput {
        FrameInput {
            captured_at: self.captured_at,
            map_from_camera: self.map_from_camera,
            up_in_camera: None,
        }
    }

    pub(crate) fn keyframe_pose(&self) -> Option<KeyframePose> {
        self.keyframe.map(|id| KeyframePose {
            id,
            captured_at: self.captured_at,
            map_from_camera: self.map_from_camera,
            unit: 1.0,
        })
    }

    pub(crate) fn local_fix(&self, sigma_m: f64, normal: &mut Normal) -> LocalFix {
        LocalFix {
            captured_at: self.captured_at,
            antenna_in_enu: self.enu_from_camera.translation() + normal.vector() * sigma_m,
            covariance: Matrix3::identity() * (sigma_m * sigma_m),
            heading: None,
        }
    }

    pub(crate) fn fix(&self, sigma_m: f64, normal: &mut Normal) -> PositionFix {
        let local = self.local_fix(sigma_m, normal);
        PositionFix {
            captured_at: local.captured_at,
            position: FixPosition::Local(local.antenna_in_enu),
            covariance: local.covariance,
            heading: None,
        }
    }
}

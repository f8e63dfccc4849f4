//! What makes a recording hard: drawn from its seed, each apart from the others.

use camera::Image;
use geometry::{Body, Camera, Enu, Transform};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::radio;
use crate::renderer::{Neighbour, SensorSettings};
use crate::world::Cuboid;

/// One way in which a recording can be hard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Condition {
    /// Exposures of 20 to 33 ms.
    Blur,
    /// A sensor in the dark: σ of about 5 grey levels.
    Noise,
    /// Torn and snowy lines in some frames, as of analogue video.
    Radio,
    /// The exposure jumps to 0.4 or 2.2 times, and back.
    Exposure,
    /// A covered lens for 2 s.
    Cover,
    /// Something dark passes close before the lens, a few times.
    Occlusion,
    /// A third of the contrast.
    LowTexture,
    /// Single frames and short bursts are missing.
    Drops,
}

impl Condition {
    pub const ALL: [Self; 8] = [
        Self::Blur,
        Self::Noise,
        Self::Radio,
        Self::Exposure,
        Self::Cover,
        Self::Occlusion,
        Self::LowTexture,
        Self::Drops,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Blur => "blur",
            Self::Noise => "noise",
            Self::Radio => "radio",
            Self::Exposure => "exposure",
            Self::Cover => "cover",
            Self::Occlusion => "occlusion",
            Self::LowTexture => "low-texture",
            Self::Drops => "drops",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|it| it.name() == name)
    }
}

/// The conditions of one recording.
pub struct Weather {
    seed: u64,
    exposure_s: Option<f64>,
    is_noisy: bool,
    has_radio_noise: bool,
    has_drops: bool,
    steps: Vec<Step>,
    cover_s: Option<f64>,
    passings: Vec<Passing>,
}

/// A sudden change of exposure.
#[derive(Clone, Copy, Debug)]
struct Step {
    from_s: f64,
    to_s: f64,
    ramp_s: f64,
    gain: f64,
}

/// A box that passes before the lens on a straight path.
#[derive(Clone, Debug)]
struct Passing {
    from_s: f64,
    duration_s: f64,
    start_in_camera: Vector3<f64>,
    end_in_camera: Vector3<f64>,
    turn_rad: Vector3<f64>,
    hull: Vec<Cuboid>,
}

/// Nothing strikes before this share of the recording, so that there is a map to be lost.
const CALM_SHARE: f64 = 0.15;
const COVERED_S: f64 = 2.0;
const COVER_RAMP_S: f64 = 0.12;
/// What comes through a covering hand.
const COVERED_GAIN: f64 = 0.015;
const DROP_SHARE: f64 = 0.06;

impl Weather {
    pub fn new(conditions: &[Condition], seed: u64, duration_s: f64) -> Self {
        let has = |condition| conditions.contains(&condition);
        let rng = |salt: u64| ChaCha8Rng::seed_from_u64(seed ^ (0x1ab0_0010 + salt));
        let calm_s = CALM_SHARE * duration_s;
        let within = |rng: &mut ChaCha8Rng| rng.random_range(calm_s..duration_s.max(calm_s + 0.1));
        Self {
            seed,
            exposure_s: has(Condition::Blur).then(|| rng(0).random_range(0.02..0.033)),
            is_noisy: has(Condition::Noise),
            has_radio_noise: has(Condition::Radio),
            has_drops: has(Condition::Drops),
            steps: if has(Condition::Exposure) {
                steps(calm_s, duration_s, &mut rng(1))
            } else {
                Vec::new()
            },
            cover_s: has(Condition::Cover).then(|| 0.85 * within(&mut rng(2))),
            passings: if has(Condition::Occlusion) {
                passings(calm_s, duration_s, &mut rng(3))
            } else {
                Vec::new()
            },
        }
    }

    pub fn sensor(&self, clear: SensorSettings) -> SensorSettings {
        let (read_noise, shot_noise) = if self.is_noisy {
            (4.0, 0.12)
        } else {
            (clear.read_noise, clear.shot_noise)
        };
        SensorSettings {
            exposure_s: self.exposure_s.unwrap_or(clear.exposure_s),
            read_noise,
            shot_noise,
            ..clear
        }
    }

    /// What the exposure is multiplied by.
    pub fn gain(&self, time_s: f64) -> f64 {
        let steps = self.steps.iter();
        let stepped: f64 = steps.map(|step| step.gain.ln() * step.weight(time_s)).sum();
        let covered = self.cover_s.map_or(0.0, |from_s| {
            let to_s = from_s + COVERED_S;
            trapezium(time_s, from_s, to_s, COVER_RAMP_S)
        });
        (stepped + covered * COVERED_GAIN.ln()).exp()
    }

    /// All hulls, in the order of [`Weather::occluders`].
    pub fn hulls(&self) -> Vec<Vec<Cuboid>> {
        let passings = self.passings.iter();
        passings.map(|passing| passing.hull.clone()).collect()
    }

    /// What is before the lens.
    pub fn occluders(
        &self,
        time_s: f64,
        site_from_camera: &Transform<Enu, Camera>,
    ) -> Vec<Neighbour> {
        let passings = self.passings.iter().enumerate();
        passings
            .filter_map(|(hull_idx, passing)| {
                let part = (time_s - passing.from_s) / passing.duration_s;
                let place = passing.start_in_camera.lerp(&passing.end_in_camera, part);
                let turn = UnitQuaternion::from_scaled_axis(passing.turn_rad);
                let camera_from_body: Transform<Camera, Body> = Transform::new(turn, place);
                (0.0..1.0).contains(&part).then(|| Neighbour {
                    hull_idx,
                    site_from_body: *site_from_camera * camera_from_body,
                    lights: None,
                })
            })
            .collect()
    }

    pub fn drops(&self, frame_idx: usize) -> bool {
        // A burst begins at any frame and lasts for one to five.
        let begins = |start: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x1ab0_0020 ^ (start as u64) << 32);
            let length = rng.random_range(1..6_usize);
            rng.random_bool(DROP_SHARE / 3.0) && start + length > frame_idx
        };
        self.has_drops && (frame_idx.saturating_sub(5)..=frame_idx).any(begins)
    }

    /// What happens to the picture on its way.
    pub fn disturb(&self, frame_idx: usize, image: &mut Image) {
        if self.has_radio_noise {
            radio::disturb(image, self.seed, frame_idx);
        }
    }
}

impl Step {
    fn weight(&self, time_s: f64) -> f64 {
        trapezium(time_s, self.from_s, self.to_s, self.ramp_s)
    }
}

/// 1 between two times, 0 elsewhere, with ramps outside.
fn trapezium(time_s: f64, from_s: f64, to_s: f64, ramp_s: f64) -> f64 {
    let rise = (time_s - from_s) / ramp_s + 1.0;
    let fall = (to_s - time_s) / ramp_s + 1.0;
    rise.min(fall).clamp(0.0, 1.0)
}

fn steps(calm_s: f64, duration_s: f64, rng: &mut impl Rng) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut cursor_s = calm_s + rng.random_range(0.0..1.5);
    while cursor_s < duration_s {
        let length_s = rng.random_range(0.8..4.0);
        steps.push(Step {
            from_s: cursor_s,
            to_s: cursor_s + length_s,
            // From one frame to the next, or as an automatic exposure takes its time.
            ramp_s: rng.random_range(0.005..0.5),
            gain: if rng.random_bool(0.5) { 0.4 } else { 2.2 },
        });
        cursor_s += length_s + rng.random_range(1.0..4.0);
    }
    steps
}

fn passings(calm_s: f64, duration_s: f64, rng: &mut impl Rng) -> Vec<Passing> {
    let mut passings = Vec::new();
    let mut cursor_s = calm_s + rng.random_range(0.0..2.0);
    while cursor_s < duration_s {
        let from_s = cursor_s;
        let duration_s = rng.random_range(0.8..2.5);
        let depth_m = rng.random_range(0.35..0.7);
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let edge_m = 1.2 * depth_m + 0.25;
        let height_m = rng.random_range(-0.15..0.15);
        // A hand, and the arm that it comes with.
        let size_m = Vector3::from_fn(|_, _| rng.random_range(0.14..0.3)) * (depth_m / 0.5);
        let arm_m = Vector3::new(0.5 * size_m.x, 1.2, 0.5 * size_m.z);
        let boxed = |centre: Vector3<f64>, size_m: Vector3<f64>| Cuboid {
            centre,
            half: size_m * 0.5,
            yaw_rad: 0.0,
        };
        passings.push(Passing {
            from_s,
            duration_s,
            start_in_camera: Vector3::new(-side * edge_m, height_m, depth_m),
            end_in_camera: Vector3::new(side * edge_m, -height_m, depth_m),
            turn_rad: Vector3::from_fn(|_, _| rng.random_range(-0.4..0.4)),
            hull: vec![
                boxed(Vector3::zeros(), size_m),
                boxed(Vector3::y() * (0.6 + 0.4 * size_m.y), arm_m),
            ],
        });
        cursor_s += duration_s + rng.random_range(1.5..5.0);
    }
    passings
}

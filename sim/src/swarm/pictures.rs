//! What the cameras of a drone take of the others: pictures, with nothing but light in them.

use camera::{CameraModel, Image};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{BODY_RADIUS_M, LightBaseline, STEP_S, Snapshot, Swarm, turned};
use crate::marker_light::{Grain, Irradiance, LENS_SIGMA_PX, LightSpot, MarkerScene, Sensor};

/// A camera that every drone carries, levelled.
#[derive(Clone, Debug, PartialEq)]
pub struct SwarmCamera {
    pub model: CameraModel,
    pub heading_from_camera: UnitQuaternion<f64>,
}

impl SwarmCamera {
    fn size_px(&self) -> [usize; 2] {
        [self.model.width(), self.model.height()]
    }
}

/// What pictures show beside the drones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureSettings {
    /// Standard deviation of a pixel, grey levels.
    pub noise: f64,
    /// Lamps that are nobody's, on walls to either side: so many are about at any time.
    pub lamp_count: usize,
}

impl Default for PictureSettings {
    fn default() -> Self {
        Self {
            noise: 3.0,
            lamp_count: 0,
        }
    }
}

/// All that is not a drone, and the cameras.
#[derive(Clone, Debug)]
pub struct Studio {
    cameras: Vec<SwarmCamera>,
    /// One for each camera, larger than its pictures.
    backdrops: Vec<Irradiance>,
    grain: Grain,
    sensor: Sensor,
    lamps: Vec<Vector3<f64>>,
}

/// Backdrops stick out by this, so that they can move by as much.
const BACKDROP_MARGIN_PX: usize = 160;
/// And move as things do that are so far away.
const BACKDROP_M: f64 = 12.0;
const BODY_LEVEL: f64 = 12.0;
/// Of a light at one metre, above what is behind it. At nine metres 130 are left.
const PEAK_AT_1_M: f64 = 10_800.0;
const LIGHT_RADIUS_M: f64 = 0.0025;
/// Walls with lamps are so far to either side.
const WALL_M: f64 = 8.0;
const LAMP_HEIGHT_M_MAX: f64 = 4.0;
/// Along the way the lamps repeat.
const LAMP_PERIOD_M: f64 = 20.0;

impl Studio {
    pub fn new(cameras: Vec<SwarmCamera>, settings: &PictureSettings, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let backdrop_of = |camera: &SwarmCamera| {
            let scene = MarkerScene {
                size_px: camera.size_px().map(|side| side + BACKDROP_MARGIN_PX),
                ..MarkerScene::lab()
            };
            scene.backdrop(rng.random())
        };
        let backdrops = cameras.iter().map(backdrop_of).collect();
        let widths = cameras.iter().map(|camera| camera.model.width());
        let width_max = widths.max().unwrap_or(0);
        let lamps = (0..settings.lamp_count).map(|_| {
            let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
            let along_m = rng.random_range(0.0..LAMP_PERIOD_M);
            let height_m = rng.random_range(-LAMP_HEIGHT_M_MAX..LAMP_HEIGHT_M_MAX);
            Vector3::new(along_m, side * WALL_M, height_m)
        });
        Self {
            lamps: lamps.collect(),
            backdrops,
            grain: Grain::new(width_max, &mut rng),
            sensor: Sensor {
                exposure: 1.0,
                noise: settings.noise,
            },
            cameras,
        }
    }

    fn backdrop(&self, camera_idx: usize, scene: &Snapshot, observer: usize) -> Irradiance {
        let camera = &self.cameras[camera_idx];
        let camera_from_heading = camera.heading_from_camera.inverse();
        let heading_rad = scene.headings_rad[observer];
        let moved = camera_from_heading * turned(&scene.positions[observer], -heading_rad);
        // There and back, so that it never ends.
        let swing = |px: f64| {
            let margin = BACKDROP_MARGIN_PX as f64;
            let phase = (px + 0.5 * margin).rem_euclid(2.0 * margin);
            phase.min(2.0 * margin - phase) as usize
        };
        let focal_px = camera.model.intrinsics().fx;
        let turn_px = focal_px * heading_rad;
        let corner = [moved.x, moved.y].map(|part| swing(focal_px * part / BACKDROP_M + turn_px));
        self.backdrops[camera_idx].cropped(corner, camera.size_px())
    }
}

/// Somebody whom a picture shows.
struct Shown {
    in_camera: Vector3<f64>,
    lights_in_camera: Option<[Vector3<f64>; 2]>,
}

impl Swarm {
    /// One camera's newest picture. Call once for each drone, camera and step, in order.
    ///
    /// - `camera_idx`: of the studio's cameras.
    pub fn picture(&mut self, observer: usize, studio: &Studio, camera_idx: usize) -> Image {
        let camera = &studio.cameras[camera_idx];
        let shown = self.shown_to(observer, camera);
        let scene = self.past.front().unwrap_or(&self.now);
        let mut light = studio.backdrop(camera_idx, scene, observer);
        for lamp in self.lamps_near(observer, camera, studio) {
            add_light(&mut light, camera, &lamp);
        }
        for drone in &shown {
            if let Some(pixel) = camera.model.project(&drone.in_camera) {
                let radius_px = camera.model.intrinsics().fx * BODY_RADIUS_M / drone.in_camera.z;
                light.fill_disc([pixel.x, pixel.y], radius_px, BODY_LEVEL);
            }
            for spot in drone.lights_in_camera.iter().flatten() {
                add_light(&mut light, camera, spot);
            }
        }
        studio.grain.expose(&light, &studio.sensor, &mut self.rng)
    }

    /// Whose lights are in a direction of the drone's heading frame in its newest pictures, for
    /// those who check; `None` if nobody is there.
    pub fn target_towards(&self, observer: usize, direction: &Vector3<f64>) -> Option<usize> {
        let scene = self.past.front().unwrap_or(&self.now);
        let heading_rad = scene.headings_rad[observer];
        let own = scene.positions[observer];
        let sine_of = |target: usize| {
            let offset = turned(&(scene.positions[target] - own), -heading_rad);
            let reach_m = offset.norm();
            let beside_m = offset.cross(direction).norm();
            let is_there = offset.dot(direction) > 0.0
                && beside_m
                    <= self
                        .settings
                        .sensing
                        .light_distance_m
                        .max(SAME_SINE * reach_m);
            is_there.then_some((beside_m / reach_m, target))
        };
        let targets = (0..scene.positions.len()).filter(|target| *target != observer);
        let by_sine = |left: &(f64, usize), right: &(f64, usize)| left.0.total_cmp(&right.0);
        targets
            .filter_map(sine_of)
            .min_by(by_sine)
            .map(|(_, target)| target)
    }

    /// Everybody ahead of a camera, the farthest first, so that the nearer ones hide them.
    fn shown_to(&mut self, observer: usize, camera: &SwarmCamera) -> Vec<Shown> {
        let sensing = self.settings.sensing;
        let mut shown: Vec<Shown> = Vec::new();
        for target in 0..self.now.positions.len() {
            let scene = self.past.front().unwrap_or(&self.now);
            let own = scene.positions[observer];
            let offset = scene.positions[target] - own;
            let is_far = offset.norm_squared() > sensing.bright_m * sensing.bright_m;
            if target == observer || is_far || !self.is_aloft(target) {
                continue;
            }
            let own_heading_rad = scene.headings_rad[observer];
            let in_camera = |offset: &Vector3<f64>| {
                let in_heading = turned(offset, -own_heading_rad);
                camera
                    .heading_from_camera
                    .inverse_transform_vector(&in_heading)
            };
            let center = in_camera(&offset);
            // Beside the picture at the least, with all that sticks out.
            if center.z <= BODY_RADIUS_M {
                continue;
            }
            let half =
                0.5 * sensing.light_distance_m * light_axis(scene, target, &offset, &sensing);
            let lights = [offset + half, offset - half].map(|light| in_camera(&light));
            let is_hidden = self
                .cylinders
                .iter()
                .any(|cylinder| cylinder.hides(&own, &scene.positions[target]));
            let is_dark = is_hidden
                || self.is_unlit(target)
                || sensing.missed > 0.0 && self.rng.random::<f64>() < sensing.missed;
            shown.push(Shown {
                in_camera: center,
                lights_in_camera: Some(lights).filter(|_| !is_dark),
            });
        }
        let range_m = |drone: &Shown| drone.in_camera.norm_squared();
        shown.sort_by(|left, right| range_m(right).total_cmp(&range_m(left)));
        shown
    }

    fn lamps_near(
        &self,
        observer: usize,
        camera: &SwarmCamera,
        studio: &Studio,
    ) -> Vec<Vector3<f64>> {
        let scene = self.past.front().unwrap_or(&self.now);
        let own = scene.positions[observer];
        let heading_rad = scene.headings_rad[observer];
        let offset_of = |lamp: &Vector3<f64>| {
            let mut offset = lamp - own;
            offset.x -= LAMP_PERIOD_M * (offset.x / LAMP_PERIOD_M).round();
            let in_heading = turned(&offset, -heading_rad);
            camera
                .heading_from_camera
                .inverse_transform_vector(&in_heading)
        };
        studio.lamps.iter().map(offset_of).collect()
    }

    /// From the drone's gyroscope, for when its newest pictures were taken.
    pub fn pictured_heading_rad(&self, observer: usize) -> f64 {
        self.past.front().unwrap_or(&self.now).headings_rad[observer]
    }

    /// Since the start.
    pub fn time_s(&self) -> f64 {
        self.step_count as f64 * STEP_S
    }
}

/// The sine of an angle at which lights count as seen in the right direction.
const SAME_SINE: f64 = 0.03;

/// The axis of the lights that a target shows towards the one who looks.
///
/// All-round lights are three pairs whose beams are 90° wide: one upright, seen from around, and
/// one along the left axis above and one below, seen from there.
fn light_axis(
    scene: &Snapshot,
    target: usize,
    offset: &Vector3<f64>,
    sensing: &super::SensingSettings,
) -> Vector3<f64> {
    let is_around = offset.z.abs() <= offset.x.hypot(offset.y);
    match sensing.baseline {
        LightBaseline::Vertical => Vector3::z(),
        LightBaseline::AllRound if is_around => Vector3::z(),
        LightBaseline::AllRound | LightBaseline::Horizontal => {
            turned(&Vector3::y(), scene.headings_rad[target])
        }
    }
}

fn add_light(light: &mut Irradiance, camera: &SwarmCamera, in_camera: &Vector3<f64>) {
    let Some(pixel) = camera.model.project(in_camera) else {
        return;
    };
    let radius_px = camera.model.intrinsics().fx * LIGHT_RADIUS_M / in_camera.z;
    light.add_spot(&LightSpot {
        center_px: [pixel.x, pixel.y],
        sigma_px: LENS_SIGMA_PX.hypot(radius_px),
        peak: PEAK_AT_1_M / in_camera.norm_squared(),
        streak_px: [0.0, 0.0],
    });
}

//! What the cameras of a drone show of the lights of the others.

use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{BODY_RADIUS_M, STEP_S, Swarm, turned};

/// How the lights of a drone are mounted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightBaseline {
    /// Three or more: from every side two of them show the full distance.
    #[default]
    AllRound,
    /// One above the other.
    Vertical,
    /// Side by side, along the left axis.
    Horizontal,
}

/// The default is ideal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensingSettings {
    pub latency_s: f64,
    /// Standard deviation of the lights' separation, and of their place in the image.
    pub noise_px: f64,
    /// The share of neighbours that a frame misses, at random.
    pub missed: f64,
    /// Other lights, taken for a neighbour's: how many in a frame on average, at most one.
    pub false_lights: f64,
    pub focal_px: f64,
    pub light_distance_m: f64,
    pub baseline: LightBaseline,
    /// Lights that are nearer to each other than this merge.
    pub separation_px_min: f64,
    /// Farther away lights merge in any case.
    pub visible_m: f64,
    /// And beyond this they are too dim.
    pub bright_m: f64,
    /// No more than this many lights are found in a frame, the nearest.
    pub light_count_max: usize,
    /// Cameras cover this to either side of ahead.
    pub azimuth_rad_max: f64,
    /// And this above and below.
    pub elevation_rad_max: f64,
    /// Bodies hide what is behind them.
    pub occlusion: bool,
    /// So many drones, the first ones, see nothing after [`FAULT_AFTER_S`].
    pub blinded: usize,
    /// For so long.
    pub blinded_s: f64,
    /// The lights of so many drones, the last ones, never shine.
    pub unlit: usize,
    /// And those drones know it, as the current through a light tells.
    pub unlit_known: bool,
}

impl Default for SensingSettings {
    fn default() -> Self {
        Self {
            latency_s: 0.0,
            noise_px: 0.0,
            missed: 0.0,
            false_lights: 0.0,
            focal_px: 181.0,
            light_distance_m: 0.1,
            baseline: LightBaseline::default(),
            separation_px_min: 0.0,
            visible_m: 9.0,
            bright_m: 9.0,
            light_count_max: 64,
            azimuth_rad_max: 150_f64.to_radians(),
            elevation_rad_max: std::f64::consts::FRAC_PI_2,
            occlusion: false,
            blinded: 0,
            blinded_s: f64::INFINITY,
            unlit: 0,
            unlit_known: true,
        }
    }
}

/// Lights in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glimpse {
    /// Whose they are, for those who check; `None` for a false light.
    pub target: Option<usize>,
    /// Of length one, in the heading frame of the drone that sees them.
    pub direction: Vector3<f64>,
    /// Unless they merged.
    pub separation_px: Option<f64>,
}

/// Somebody within sight.
#[derive(Clone, Copy, Debug)]
pub struct Nearby {
    target: usize,
    offset: Vector3<f64>,
    distance_m: f64,
}

/// Faults happen when the swarm has found its places.
pub const FAULT_AFTER_S: f64 = 30.0;
/// A false light looks like a neighbour at up to this distance.
const FALSE_LIGHT_M_MAX: f64 = 8.0;

impl Swarm {
    /// What a drone's newest frame shows. Call once for each drone and step, in order.
    pub fn glimpses(&mut self, observer: usize, glimpses: &mut Vec<Glimpse>) {
        glimpses.clear();
        let sensing = self.settings.sensing;
        if self.is_blinded(observer) {
            return;
        }
        let mut nearby = std::mem::take(&mut self.nearby);
        self.collect_nearby(observer, &mut nearby);
        let scene = self.past.front().unwrap_or(&self.now);
        let heading_rad = scene.headings_rad[observer];
        for (idx, seen) in nearby.iter().enumerate() {
            if self.is_unlit(seen.target) {
                continue;
            }
            if sensing.missed > 0.0 && self.rng.random::<f64>() < sensing.missed {
                continue;
            }
            if sensing.occlusion && is_hidden(seen, &nearby[..idx]) {
                continue;
            }
            let unit = seen.offset / seen.distance_m;
            let across = match sensing.baseline {
                LightBaseline::AllRound => 1.0,
                LightBaseline::Vertical => unit.x.hypot(unit.y),
                LightBaseline::Horizontal => {
                    let axis = turned(&Vector3::y(), scene.headings_rad[seen.target]);
                    axis.cross(&unit).norm()
                }
            };
            let true_px = sensing.focal_px * sensing.light_distance_m * across / seen.distance_m;
            let noisy_px = true_px + normal(&mut self.rng, sensing.noise_px);
            let direction = turned(&unit, -heading_rad);
            glimpses.push(Glimpse {
                target: Some(seen.target),
                direction: blurred(&direction, &sensing, &mut self.rng),
                separation_px: Some(noisy_px).filter(|px| {
                    *px >= sensing.separation_px_min && seen.distance_m <= sensing.visible_m
                }),
            });
        }
        if sensing.false_lights > 0.0 && self.rng.random::<f64>() < sensing.false_lights {
            glimpses.push(false_light(&sensing, &mut self.rng));
        }
        self.nearby = nearby;
    }

    /// Whether a drone's cameras give no image now.
    pub fn is_blinded(&self, drone: usize) -> bool {
        let sensing = &self.settings.sensing;
        let end_s = FAULT_AFTER_S + sensing.blinded_s;
        drone < sensing.blinded && self.has_fault() && self.step_count as f64 * STEP_S <= end_s
    }

    /// Whether a drone's lights are out.
    pub fn is_unlit(&self, drone: usize) -> bool {
        drone + self.settings.sensing.unlit >= self.now.positions.len()
    }

    /// Whether the time of faults has come.
    pub(super) fn has_fault(&self) -> bool {
        self.step_count as f64 * STEP_S > FAULT_AFTER_S
    }

    /// How many others with lights are in range and view of a drone's cameras.
    pub fn in_view_count(&mut self, observer: usize) -> usize {
        if self.is_blinded(observer) {
            return 0;
        }
        let mut nearby = std::mem::take(&mut self.nearby);
        self.collect_nearby(observer, &mut nearby);
        let count = nearby
            .iter()
            .filter(|seen| !self.is_unlit(seen.target))
            .count();
        self.nearby = nearby;
        count
    }

    /// Everybody in range and view, the nearest first.
    fn collect_nearby(&self, observer: usize, nearby: &mut Vec<Nearby>) {
        nearby.clear();
        let sensing = &self.settings.sensing;
        let scene = self.past.front().unwrap_or(&self.now);
        let own = scene.positions[observer];
        let view = sensing.view();
        let heading_rad = scene.headings_rad[observer];
        for (target, position) in scene.positions.iter().enumerate() {
            let offset = position - own;
            let distance_squared = offset.norm_squared();
            if distance_squared > sensing.bright_m * sensing.bright_m
                || target == observer
                || !self.is_aloft(target)
                || distance_squared == 0.0
            {
                continue;
            }
            let in_heading = turned(&offset, -heading_rad);
            if !view.covers(&in_heading) {
                continue;
            }
            if self
                .cylinders
                .iter()
                .any(|cylinder| cylinder.hides(&own, position))
            {
                continue;
            }
            nearby.push(Nearby {
                target,
                offset,
                distance_m: distance_squared.sqrt(),
            });
        }
        let by_distance =
            |left: &Nearby, right: &Nearby| left.distance_m.total_cmp(&right.distance_m);
        if nearby.len() > sensing.light_count_max {
            nearby.select_nth_unstable_by(sensing.light_count_max, by_distance);
            nearby.truncate(sensing.light_count_max);
        }
        nearby.sort_by(by_distance);
    }
}

impl SensingSettings {
    fn view(&self) -> View {
        View {
            azimuth_cos_min: self.azimuth_rad_max.cos(),
            elevation_tan_max: self.elevation_rad_max.tan(),
        }
    }
}

/// The borders of what cameras cover, without angles: this is the inner loop of large swarms.
struct View {
    azimuth_cos_min: f64,
    elevation_tan_max: f64,
}

impl View {
    fn covers(&self, offset: &Vector3<f64>) -> bool {
        let across_m = (offset.x * offset.x + offset.y * offset.y).sqrt();
        offset.x >= self.azimuth_cos_min * across_m
            && offset.z.abs() <= self.elevation_tan_max * across_m
    }
}

/// Whether the body of a nearer one covers the middle of the lights.
fn is_hidden(seen: &Nearby, nearer: &[Nearby]) -> bool {
    nearer.iter().any(|other| {
        let along = seen.offset.dot(&other.offset);
        let across_squared = other.distance_m.powi(2) - (along / seen.distance_m).powi(2);
        along > 0.0 && across_squared < BODY_RADIUS_M * BODY_RADIUS_M
    })
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    if sigma > 0.0 {
        rng.sample::<f64, _>(StandardNormal) * sigma
    } else {
        0.0
    }
}

/// The direction with the error of its place in the image.
fn blurred(
    direction: &Vector3<f64>,
    sensing: &SensingSettings,
    rng: &mut ChaCha8Rng,
) -> Vector3<f64> {
    if sensing.noise_px <= 0.0 {
        return *direction;
    }
    let sigma_rad = sensing.noise_px / sensing.focal_px;
    let error = Vector3::from_fn(|_, _| normal(rng, sigma_rad));
    (direction + error).normalize()
}

/// A light that is nobody's, anywhere in view.
fn false_light(sensing: &SensingSettings, rng: &mut ChaCha8Rng) -> Glimpse {
    let direction = loop {
        let candidate = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let length: f64 = candidate.norm();
        if (0.1..=1.0).contains(&length) && sensing.view().covers(&candidate) {
            break candidate / length;
        }
    };
    let distance_m = rng.random_range(0.5..FALSE_LIGHT_M_MAX);
    Glimpse {
        target: None,
        direction,
        separation_px: Some(sensing.focal_px * sensing.light_distance_m / distance_m),
    }
}

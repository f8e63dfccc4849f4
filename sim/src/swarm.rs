//! Swarms of point drones: how they move, and what their cameras see of each other.
//!
//! Lights are seen as a direction and a separation in pixels, with the errors that images have, or
//! in pictures. [`Glimpse::target`] and [`Swarm::target_towards`] are the truth and not for the
//! drones.

mod obstacles;
mod pictures;
mod sensing;
mod start;

use std::collections::VecDeque;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

pub use obstacles::{Cylinder, Surface};
pub use pictures::{PictureSettings, Studio, SwarmCamera};
pub use sensing::{FAULT_AFTER_S, Glimpse, LightBaseline, SensingSettings};

/// Synchronous explicit Euler: everybody senses, then everybody moves.
pub const STEP_S: f64 = 0.1;
/// Bodies hide what is behind them, and hit obstacles, with this radius.
pub const BODY_RADIUS_M: f64 = 0.06;

#[derive(Clone, Debug, PartialEq)]
pub struct SwarmSettings {
    pub drone_count: usize,
    /// Common to all, along each one's heading.
    pub speed_mps: f64,
    /// Headings differ by this, one standard deviation; they are equal at zero.
    pub heading_spread_rad: f64,
    /// Up to three drones start in a cube of this half-width, more at this distance.
    pub cube_half_width_m: f64,
    pub start_distance_m: f64,
    pub obstacle_count: usize,
    /// Time constant of the velocity behind the command; zero follows at once.
    pub lag_s: f64,
    /// Gusts move each drone with this standard deviation.
    pub wind_mps: f64,
    /// So many drones, the last ones, leave the air after [`FAULT_AFTER_S`].
    pub dropped: usize,
    pub sensing: SensingSettings,
}

impl Default for SwarmSettings {
    fn default() -> Self {
        Self {
            drone_count: 3,
            speed_mps: 0.0,
            heading_spread_rad: 0.0,
            cube_half_width_m: 4.0,
            start_distance_m: 3.0,
            obstacle_count: 0,
            lag_s: 0.0,
            wind_mps: 0.0,
            dropped: 0,
            sensing: SensingSettings::default(),
        }
    }
}

/// What a drone is told to do, in its heading frame: gravity-aligned, x forward, y left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steering {
    pub velocity: Vector3<f64>,
    pub heading_rad: f64,
}

/// Everybody's place at one time.
#[derive(Clone, Debug)]
struct Snapshot {
    positions: Vec<Vector3<f64>>,
    headings_rad: Vec<f64>,
}

/// A swarm in the air.
#[derive(Clone, Debug)]
pub struct Swarm {
    settings: SwarmSettings,
    rng: ChaCha8Rng,
    now: Snapshot,
    velocities: Vec<Vector3<f64>>,
    gusts: Vec<Vector3<f64>>,
    cylinders: Vec<Cylinder>,
    step_count: usize,
    /// What cameras show now is this old: the front, once there are enough.
    past: VecDeque<Snapshot>,
    /// Kept between calls, for its memory.
    nearby: Vec<sensing::Nearby>,
}

/// Gusts change with this time constant.
const GUST_S: f64 = 2.0;

impl Swarm {
    pub fn new(settings: SwarmSettings, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let positions = start::positions(&settings, &mut rng);
        let headings_rad: Vec<f64> = positions
            .iter()
            .map(|_| rng.sample::<f64, _>(StandardNormal) * settings.heading_spread_rad)
            .collect();
        let velocities = headings_rad
            .iter()
            .map(|heading| Vector3::new(heading.cos(), heading.sin(), 0.0) * settings.speed_mps)
            .collect();
        let cylinders = obstacles::rows(&settings, &mut rng);
        let now = Snapshot {
            positions,
            headings_rad,
        };
        Self {
            rng,
            velocities,
            gusts: vec![Vector3::zeros(); now.positions.len()],
            cylinders,
            step_count: 0,
            past: VecDeque::from([now.clone()]),
            now,
            nearby: Vec::new(),
            settings,
        }
    }

    pub fn settings(&self) -> &SwarmSettings {
        &self.settings
    }

    pub fn positions(&self) -> &[Vector3<f64>] {
        &self.now.positions
    }

    pub fn velocities(&self) -> &[Vector3<f64>] {
        &self.velocities
    }

    pub fn headings_rad(&self) -> &[f64] {
        &self.now.headings_rad
    }

    pub fn cylinders(&self) -> &[Cylinder] {
        &self.cylinders
    }

    /// Whether the drone is in the air. Who is not is seen by nobody and in nobody's way.
    pub fn is_aloft(&self, drone: usize) -> bool {
        !self.has_fault() || drone + self.settings.dropped < self.now.positions.len()
    }

    /// The drone's own velocity as its autopilot knows it, in its heading frame.
    pub fn own_velocity(&self, drone: usize) -> Vector3<f64> {
        turned(&self.velocities[drone], -self.now.headings_rad[drone])
    }

    /// Moves everybody by one step.
    ///
    /// - `steering`: one for each drone.
    pub fn advance(&mut self, steering: &[Steering]) {
        assert_eq!(steering.len(), self.now.positions.len());
        let gain = if self.settings.lag_s > 0.0 {
            1.0 - (-STEP_S / self.settings.lag_s).exp()
        } else {
            1.0
        };
        let keep = (-STEP_S / GUST_S).exp();
        let gust_mps = self.settings.wind_mps * (1.0 - keep * keep).sqrt();
        let drone_count = steering.len();
        let aloft_count = if self.has_fault() {
            drone_count.saturating_sub(self.settings.dropped)
        } else {
            drone_count
        };
        for (drone, steering) in steering.iter().enumerate() {
            let heading_rad = &mut self.now.headings_rad[drone];
            let commanded = turned(&steering.velocity, *heading_rad);
            let velocity = &mut self.velocities[drone];
            *velocity += (commanded - *velocity) * gain;
            *heading_rad = steering.heading_rad;
            let gust = &mut self.gusts[drone];
            if gust_mps > 0.0 {
                let rng = &mut self.rng;
                let push = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
                *gust = *gust * keep + push * gust_mps;
            }
            if drone < aloft_count {
                self.now.positions[drone] += (*velocity + *gust) * STEP_S;
            }
        }
        self.step_count += 1;
        self.remember();
    }

    fn remember(&mut self) {
        let latency_steps = (self.settings.sensing.latency_s / STEP_S).round() as usize;
        // The oldest snapshot's memory is used again.
        let mut snapshot = if self.past.len() > latency_steps {
            self.past.pop_front()
        } else {
            None
        }
        .unwrap_or_else(|| self.now.clone());
        snapshot.positions.copy_from_slice(&self.now.positions);
        snapshot
            .headings_rad
            .copy_from_slice(&self.now.headings_rad);
        self.past.push_back(snapshot);
    }
}

/// Turned about the vertical.
fn turned(vector: &Vector3<f64>, angle_rad: f64) -> Vector3<f64> {
    if angle_rad == 0.0 {
        return *vector;
    }
    let (sin, cos) = angle_rad.sin_cos();
    Vector3::new(
        cos * vector.x - sin * vector.y,
        sin * vector.x + cos * vector.y,
        vector.z,
    )
}

#[cfg(test)]
mod tests;

//! Upright cylinders across the way of a swarm, and what range sensors say about them.

use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{BODY_RADIUS_M, Swarm, SwarmSettings, start, turned};

/// Upright, without end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    pub x_m: f64,
    pub y_m: f64,
    pub radius_m: f64,
}

/// The nearest point of an obstacle, in the heading frame of the drone that measures it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Of length one.
    pub direction: Vector3<f64>,
    pub clearance_m: f64,
}

const ROW_SIZE: usize = 3;
/// Between the axes of a row's cylinders, before they are moved at random.
const ROW_GAP_M: f64 = 5.0;
const ROW_SHIFT_M: f64 = 0.5;
const ROW_DISTANCE_M: f64 = 25.0;
const FIRST_ROW_M: f64 = 10.0;
/// Range sensors reach this far.
const RANGE_M_MAX: f64 = 6.0;

/// Rows of three across the way, the middle one about where the swarm's middle flies.
pub fn rows(settings: &SwarmSettings, rng: &mut ChaCha8Rng) -> Vec<Cylinder> {
    let front_m = start::half_width_m(settings) + FIRST_ROW_M;
    (0..settings.obstacle_count)
        .map(|idx| {
            let (row, column) = (idx / ROW_SIZE, idx % ROW_SIZE);
            let mut shift_m = || rng.random_range(-ROW_SHIFT_M..ROW_SHIFT_M);
            let middle = 0.5 * (ROW_SIZE - 1) as f64;
            Cylinder {
                x_m: front_m + row as f64 * ROW_DISTANCE_M + 2.0 * shift_m(),
                y_m: (column as f64 - middle) * ROW_GAP_M + shift_m(),
                radius_m: 0.55 + 0.5 * shift_m(),
            }
        })
        .collect()
}

impl Cylinder {
    /// From a place to the nearest point of the surface; negative inside.
    pub fn clearance_m(&self, position: &Vector3<f64>) -> f64 {
        (self.x_m - position.x).hypot(self.y_m - position.y) - self.radius_m
    }

    pub fn is_hit_by(&self, position: &Vector3<f64>) -> bool {
        self.clearance_m(position) < BODY_RADIUS_M
    }

    /// Whether it stands between two places.
    pub fn hides(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let axis = Vector3::new(self.x_m, self.y_m, 0.0);
        let (mut along, mut towards) = (to - from, axis - from);
        along.z = 0.0;
        towards.z = 0.0;
        let share = (along.dot(&towards) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (towards - along * share).norm() < self.radius_m
    }
}

impl Swarm {
    /// What a drone's range sensors see of the cylinders, the nearest first.
    pub fn surfaces(&self, drone: usize, surfaces: &mut Vec<Surface>) {
        surfaces.clear();
        let position = self.now.positions[drone];
        for cylinder in &self.cylinders {
            let clearance_m = cylinder.clearance_m(&position);
            let towards = Vector3::new(cylinder.x_m - position.x, cylinder.y_m - position.y, 0.0);
            if clearance_m > RANGE_M_MAX || towards.norm() < 1e-9 {
                continue;
            }
            let direction = turned(&towards.normalize(), -self.now.headings_rad[drone]);
            surfaces.push(Surface {
                direction,
                clearance_m,
            });
        }
        surfaces.sort_by(|left, right| left.clearance_m.total_cmp(&right.clearance_m));
    }
}

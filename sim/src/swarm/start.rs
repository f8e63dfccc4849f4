//! Where a swarm starts.

use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::SwarmSettings;

/// No two drones start nearer than this.
const START_DISTANCE_M_MIN: f64 = 1.0;
/// Beyond this number the cube is as large as the density asks for.
const SMALL_COUNT_MAX: usize = 3;

/// Random places in a cube about the origin, one after the other.
pub fn positions(settings: &SwarmSettings, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let half_width_m = half_width_m(settings);
    let mut positions: Vec<Vector3<f64>> = Vec::with_capacity(settings.drone_count);
    // At a density of one drone per cubed start distance this rejects few; a cube that cannot
    // hold them all grows.
    let mut stretch = 1.0;
    while positions.len() < settings.drone_count {
        let side = half_width_m * stretch;
        let place = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0) * side);
        let is_free = |other: &Vector3<f64>| (other - place).norm() >= START_DISTANCE_M_MIN;
        if positions.iter().all(is_free) {
            positions.push(place);
        } else {
            stretch *= 1.0005;
        }
    }
    positions
}

/// Of the cube in which the swarm starts.
pub fn half_width_m(settings: &SwarmSettings) -> f64 {
    if settings.drone_count <= SMALL_COUNT_MAX {
        settings.cube_half_width_m
    } else {
        0.5 * settings.start_distance_m * (settings.drone_count as f64).cbrt()
    }
}

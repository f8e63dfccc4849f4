//! The lab's vehicles and their routes.
//!
//! The ground vehicle goes around the middle with its camera turned 90° to the right, so that it
//! sees all walls from about 2.7 m. The drones fly between it and the walls and look at the
//! walls too, from half that distance: with their shorter focal length they see about the same
//! detail. They start where the ground vehicle looks first and never overtake its view.

use nalgebra::Vector3;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::route::{Loop, Route, Waypoint, Wobble, WobbleSettings};
use crate::world::World;

pub const DURATION_S: f64 = 52.0;
const INTERVAL_S: f64 = 0.5;
const LAP_S: f64 = 39.0;
const QUARTER_TURN_RAD: f64 = std::f64::consts::FRAC_PI_2;

const GROUND_WOBBLE: WobbleSettings = WobbleSettings {
    shift_m: 0.002,
    tilt_rad: 0.004,
    rate_hz: [1.0, 4.0],
};
const DRONE_WOBBLE: WobbleSettings = WobbleSettings {
    shift_m: 0.012,
    tilt_rad: 0.02,
    rate_hz: [0.4, 1.3],
};

/// The routes of `ugv1`, `drone1` and `drone2`.
pub fn routes(world: &World, seed: u64) -> Vec<Route> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0002);
    // Loops begin in the middle of a long side, and are half done in the middle of the other.
    let lap = if rng.random_bool(0.5) { 0.0 } else { 0.5 };
    vec![
        ground_vehicle(world, lap, &mut rng),
        drone(world, &first_drone(lap, &mut rng), &mut rng),
        drone(world, &second_drone(lap, &mut rng), &mut rng),
    ]
}

fn inset(world: &World, inset_m: f64, corner_radius_m: f64) -> Loop {
    Loop {
        half_length_m: 0.5 * world.size_m.x - inset_m,
        half_width_m: 0.5 * world.size_m.y - inset_m,
        corner_radius_m,
    }
}

fn times_s() -> impl Iterator<Item = f64> {
    (0..=(DURATION_S / INTERVAL_S) as usize).map(|idx| idx as f64 * INTERVAL_S)
}

/// From 0 to 1 between two times, with continuous acceleration.
fn ramp(time_s: f64, from_s: f64, to_s: f64) -> f64 {
    let t = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}

fn ground_vehicle(world: &World, lap: f64, rng: &mut impl Rng) -> Route {
    let circuit = inset(world, rng.random_range(2.65..2.75), 1.1);
    let height_m = rng.random_range(0.4..0.48);
    let speed_m_per_s = circuit.perimeter_m() / (LAP_S * rng.random_range(0.97..1.03));
    let mut distance_m = lap * circuit.perimeter_m() + rng.random_range(0.4..0.6);
    let mut waypoints = Vec::new();
    for time_s in times_s() {
        let ([x, y], yaw_rad) = circuit.at(distance_m);
        waypoints.push(Waypoint {
            position: Vector3::new(x, y, height_m),
            yaw_rad,
        });
        distance_m += speed_m_per_s * ramp(time_s, -0.5, 1.0) * INTERVAL_S;
    }
    Route::new(waypoints, INTERVAL_S, Wobble::new(&GROUND_WOBBLE, rng))
}

struct Flight {
    /// Where on the loop it starts: so many laps and metres from the middle of the first side.
    lap: f64,
    start_m: f64,
    inset_m: f64,
    speed_m_per_s: f64,
    /// When it turns back, if it does.
    back_at_s: Option<f64>,
    height_m: f64,
    height_back_m: f64,
}

fn first_drone(lap: f64, rng: &mut impl Rng) -> Flight {
    let height_m = rng.random_range(1.05..1.2);
    Flight {
        lap,
        start_m: rng.random_range(0.3..0.5),
        inset_m: rng.random_range(1.45..1.55),
        speed_m_per_s: rng.random_range(0.35..0.37),
        back_at_s: None,
        height_m,
        height_back_m: height_m,
    }
}

fn second_drone(lap: f64, rng: &mut impl Rng) -> Flight {
    Flight {
        lap,
        start_m: rng.random_range(-1.1..-0.9),
        inset_m: rng.random_range(1.65..1.8),
        speed_m_per_s: rng.random_range(0.33..0.345),
        back_at_s: Some(rng.random_range(25.0..26.0)),
        height_m: rng.random_range(0.85..0.95),
        height_back_m: rng.random_range(1.15..1.3),
    }
}

/// Takes off while moving sideways, looks outwards, and weaves a little.
fn drone(world: &World, flight: &Flight, rng: &mut impl Rng) -> Route {
    let circuit = inset(world, flight.inset_m, 1.15);
    let phases = [0; 3].map(|_| rng.random_range(0.0..std::f64::consts::TAU));
    let swing = |time_s: f64, period_s: f64, phase: usize| {
        (std::f64::consts::TAU * time_s / period_s + phases[phase]).sin()
    };
    let mut distance_m = flight.lap * circuit.perimeter_m() + flight.start_m;
    let mut waypoints = Vec::new();
    for time_s in times_s() {
        let back = flight
            .back_at_s
            .map_or(0.0, |at_s| ramp(time_s, at_s - 2.0, at_s + 2.0));
        let ([x, y], heading_rad) = circuit.at(distance_m);
        let cruise_m = flight.height_m + back * (flight.height_back_m - flight.height_m);
        let risen = ramp(time_s, -1.0, 4.5);
        let height_m = 0.45 + (cruise_m - 0.45) * risen + 0.08 * risen * swing(time_s, 13.0, 0);
        let outward_rad = heading_rad - QUARTER_TURN_RAD;
        let weave_m = 0.08 * swing(time_s, 9.0, 1);
        let (sine, cosine) = outward_rad.sin_cos();
        waypoints.push(Waypoint {
            position: Vector3::new(x + weave_m * cosine, y + weave_m * sine, height_m),
            yaw_rad: outward_rad + 0.07 * swing(time_s, 11.0, 2),
        });
        let speed_m_per_s = flight.speed_m_per_s * ramp(time_s, -1.0, 1.5) * (1.0 - 2.0 * back);
        distance_m += speed_m_per_s * INTERVAL_S;
    }
    Route::new(waypoints, INTERVAL_S, Wobble::new(&DRONE_WOBBLE, rng))
}

#[cfg(test)]
mod tests;

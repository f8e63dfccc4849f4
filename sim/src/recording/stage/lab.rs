//! Drones in the lab.

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

use super::{Stage, ramp, video_camera};
use crate::route::{Loop, Route, Waypoint, Wobble, WobbleSettings};
use crate::scenario::{DRONE_PITCH_DOWN_RAD, Scenario, drone_camera, mounted};
use crate::world::World;

const INTERVAL_S: f64 = 0.5;
const WOBBLE: WobbleSettings = WobbleSettings {
    shift_m: 0.015,
    tilt_rad: 0.025,
    rate_hz: [0.4, 1.4],
};
const HOVER_WOBBLE: WobbleSettings = WobbleSettings {
    shift_m: 0.008,
    tilt_rad: 0.012,
    rate_hz: [0.4, 1.4],
};
/// When the demo's first drone passes the one that stays where it is.
const PASSED_AT_S: f64 = 6.0;

/// The first drone of the demo.
pub fn to_and_fro(seed: u64) -> Stage {
    let scenario = Scenario::lab(seed);
    let drone = &scenario.vehicles[1];
    Stage {
        route: drone.route.clone(),
        camera: drone.description.camera.clone(),
        body_from_camera: drone.description.body_from_camera,
        duration_s: scenario.frame_time_s(scenario.frame_count),
        world: scenario.world,
    }
}

/// Hovers beside the way of the demo's first drone for 12 s, then turns on the spot, back and
/// beyond.
pub fn still(seed: u64, rng: &mut impl Rng) -> Stage {
    let duration_s = 20.0;
    let stage = to_and_fro(seed);
    let passed = stage.route.pose(PASSED_AT_S);
    let (_, _, heading_rad) = passed.rotation().euler_angles();
    let offset = Vector3::new(
        rng.random_range(-0.4..-0.1),
        rng.random_range(-0.3..0.3),
        rng.random_range(-0.1..0.2),
    );
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
    let position = passed.translation() + heading * offset;
    let turn_rad = rng.random_range(0.3..0.5) * sign(rng);
    let waypoints = (0..(duration_s / INTERVAL_S) as usize + 2)
        .map(|idx| {
            let time_s = idx as f64 * INTERVAL_S;
            let turned = ramp(time_s, 12.0, 15.0) - 2.0 * ramp(time_s, 15.0, 19.0);
            Waypoint {
                position,
                yaw_rad: heading_rad + turn_rad * turned,
            }
        })
        .collect();
    Stage {
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&HOVER_WOBBLE, rng)),
        duration_s,
        ..stage
    }
}

/// Around the lab, looking ahead or to the walls on the right.
pub fn round(seed: u64, rng: &mut impl Rng) -> Stage {
    let duration_s = 50.0;
    let world = World::lab(seed);
    let inset_m = rng.random_range(1.6..1.9);
    let circuit = Loop {
        half_length_m: 0.5 * world.size_m.x - inset_m,
        half_width_m: 0.5 * world.size_m.y - inset_m,
        corner_radius_m: 1.1,
    };
    let speed_m_per_s = rng.random_range(0.45..0.7);
    let aside_rad = rng.random_range(0.0..1.3);
    let cruise_m = rng.random_range(1.0..1.4);
    let mut distance_m = rng.random_range(0.0..circuit.perimeter_m());
    let waypoints = (0..(duration_s / INTERVAL_S) as usize + 2)
        .map(|idx| {
            let time_s = idx as f64 * INTERVAL_S;
            let ([x, y], yaw_rad) = circuit.at(distance_m);
            distance_m += speed_m_per_s * ramp(time_s, -0.5, 2.0) * INTERVAL_S;
            let risen_m = 0.5 + (cruise_m - 0.5) * ramp(time_s, -1.0, 4.0);
            Waypoint {
                position: Vector3::new(x, y, risen_m + 0.15 * (time_s / 2.3).sin()),
                yaw_rad: yaw_rad - aside_rad,
            }
        })
        .collect();
    Stage {
        world,
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&WOBBLE, rng)),
        camera: drone_camera(),
        body_from_camera: mounted(0.0, DRONE_PITCH_DOWN_RAD),
        duration_s,
    }
}

/// Hover, turns in place, a flight, and the same again.
pub fn hover(seed: u64, rng: &mut impl Rng) -> Stage {
    let duration_s = 36.0;
    let world = if rng.random_bool(0.5) {
        World::lab(seed)
    } else {
        World::parlour(seed)
    };
    let start = Vector3::new(
        rng.random_range(-0.5..0.5),
        rng.random_range(0.7..1.0) * if rng.random_bool(0.5) { 1.0 } else { -1.0 },
        rng.random_range(1.1..1.5),
    );
    let mut swing = |limit: f64| limit * rng.random_range(0.6..1.0) * sign(rng);
    let (first_turn, second_turn) = (swing(1.0), swing(2.6));
    let ways = [swing(1.2), swing(1.2)];
    let heading_rad = swing(3.0);
    let waypoints = (0..(duration_s / INTERVAL_S) as usize + 2)
        .map(|idx| {
            let time_s = idx as f64 * INTERVAL_S;
            let between = |from_s, to_s| ramp(time_s, from_s, to_s);
            let yaw_rad = heading_rad
                + first_turn * (between(3.0, 6.0) - between(6.0, 9.0))
                + second_turn * (between(20.0, 24.0) - between(24.5, 28.5));
            let shift = Vector3::new(
                ways[0] * (between(9.5, 13.0) - between(29.0, 33.0)),
                -0.4 * start.y * between(12.0, 16.0),
                0.25 * (between(14.0, 17.0) - between(31.0, 35.0)),
            );
            let sideways = 0.3 * ways[1] * (between(10.0, 12.0) - between(12.0, 14.0));
            Waypoint {
                position: start + shift + Vector3::y() * sideways,
                yaw_rad,
            }
        })
        .collect();
    Stage {
        world,
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&HOVER_WOBBLE, rng)),
        camera: video_camera(420.0, rng),
        body_from_camera: mounted(0.0, 0.1),
        duration_s,
    }
}

fn sign(rng: &mut impl Rng) -> f64 {
    if rng.random_bool(0.5) { 1.0 } else { -1.0 }
}

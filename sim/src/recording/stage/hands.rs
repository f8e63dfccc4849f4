//! Cameras in somebody's hands.

use nalgebra::Vector3;
use rand::{Rng, RngExt};

use super::{Stage, ramp, video_camera};
use crate::route::{Route, Waypoint, Wobble, WobbleSettings};
use crate::scenario::mounted;
use crate::world::{BOARD_HEIGHT_M, BOARD_WALL_M, World};

const INTERVAL_S: f64 = 0.25;

/// A part of a panorama.
struct Pan {
    from_s: f64,
    to_s: f64,
    turn_rad: f64,
    /// Of the step that is taken meanwhile.
    step: Vector3<f64>,
    /// The camera's distance from the axis of its turn.
    lever_m: f64,
}

/// Pans to and fro, now and then with a sway.
pub fn handheld(seed: u64, rng: &mut impl Rng) -> Stage {
    let duration_s = 25.0;
    let pans = pans(duration_s, rng);
    let start = Vector3::new(
        rng.random_range(-0.5..0.5),
        rng.random_range(-0.4..0.4),
        rng.random_range(1.2..1.6),
    );
    let heading_rad = rng.random_range(-3.0..3.0);
    let sway_m = rng.random_range(0.12..0.22);
    let waypoints = (0..(duration_s / INTERVAL_S) as usize + 2)
        .map(|idx| {
            let time_s = idx as f64 * INTERVAL_S;
            // A sway in the beginning shows how far away everything is.
            let sway = sway_m * (2.2 * time_s).sin() * (1.0 - ramp(time_s, 2.5, 4.5));
            let mut position = start;
            let mut yaw_rad = heading_rad;
            let mut lever_m = pans[0].lever_m;
            for (pan_idx, pan) in pans.iter().enumerate() {
                let done = ramp(time_s, pan.from_s, pan.to_s);
                yaw_rad += pan.turn_rad * done;
                position += pan.step * done;
                let before = pans[pan_idx.saturating_sub(1)].lever_m;
                lever_m += (pan.lever_m - before) * ramp(time_s, pan.from_s - 0.8, pan.from_s);
            }
            let forward = Vector3::new(yaw_rad.cos(), yaw_rad.sin(), 0.0);
            let left = Vector3::z().cross(&forward);
            Waypoint {
                position: position + forward * lever_m + left * sway,
                yaw_rad,
            }
        })
        .collect();
    let wobble = WobbleSettings {
        shift_m: 0.012,
        tilt_rad: 0.07,
        rate_hz: [0.3, 1.5],
    };
    Stage {
        world: World::parlour(seed),
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&wobble, rng)),
        camera: video_camera(520.0, rng),
        body_from_camera: mounted(0.0, 0.1),
        duration_s,
    }
}

fn pans(duration_s: f64, rng: &mut impl Rng) -> Vec<Pan> {
    let mut pans: Vec<Pan> = Vec::new();
    let mut cursor_s = 3.5;
    let mut direction = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    while cursor_s < duration_s {
        let is_first = pans.is_empty();
        let turn_rad: f64 = if is_first {
            std::f64::consts::TAU
        } else {
            rng.random_range(1.0..3.8)
        };
        let mean_rate_rad_per_s = rng.random_range(0.45..0.75);
        let length_s = turn_rad / mean_rate_rad_per_s;
        let is_arc = rng.random_bool(0.6);
        pans.push(Pan {
            from_s: cursor_s,
            to_s: cursor_s + length_s,
            turn_rad: direction * turn_rad,
            step: Vector3::new(
                rng.random_range(-0.2..0.2),
                rng.random_range(-0.2..0.2),
                rng.random_range(-0.1..0.1),
            ),
            lever_m: if is_arc {
                rng.random_range(0.2..0.4)
            } else {
                rng.random_range(0.02..0.06)
            },
        });
        direction = -direction;
        cursor_s += length_s + rng.random_range(0.2..1.2);
    }
    pans
}

/// To and fro before a printed board.
pub fn board(seed: u64, rng: &mut impl Rng) -> Stage {
    let duration_s = 20.0;
    let mut place = Vector3::zeros();
    let mut left_s = 0.0;
    let mut steps = vec![place];
    // Rests between quick moves to places around the middle.
    while (steps.len() as f64) * INTERVAL_S < duration_s + 1.0 {
        left_s -= INTERVAL_S;
        if left_s <= 0.0 && steps.len() > 4 {
            let wide = Vector3::new(0.22, 0.11, 0.16);
            place = wide.map(|limit| rng.random_range(-limit..limit));
            left_s = rng.random_range(0.4..1.0);
        }
        steps.push(place);
    }
    let distance_m = 0.6;
    let facing_rad = std::f64::consts::FRAC_PI_2;
    let waypoints = steps
        .iter()
        .map(|step| Waypoint {
            position: Vector3::new(0.0, BOARD_WALL_M - distance_m, BOARD_HEIGHT_M) + step,
            yaw_rad: facing_rad + 0.5 * step.x * rng.random_range(0.0..1.2),
        })
        .collect();
    let wobble = WobbleSettings {
        shift_m: 0.05,
        tilt_rad: 0.2,
        rate_hz: [0.5, 1.2],
    };
    Stage {
        world: World::board(seed),
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&wobble, rng)),
        camera: video_camera(520.0, rng),
        body_from_camera: mounted(0.0, 0.0),
        duration_s,
    }
}

//! Long ways through buildings.

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt};

use super::super::walk::{Gait, walk};
use super::{Stage, video_camera};
use crate::route::{Loop, Route, Waypoint, Wobble, WobbleSettings};
use crate::scenario::mounted;
use crate::world::{Office, Stop, World, corridor_outline_m};

/// A head that bobs with each step.
const BOB: WobbleSettings = WobbleSettings {
    shift_m: 0.025,
    tilt_rad: 0.03,
    rate_hz: [0.7, 2.0],
};
const INTERVAL_S: f64 = 0.3;
const OFFICE_S_MAX: f64 = 70.0;

/// Out of a room, through others, around the corner of the corridors, into one more and on.
pub fn office(seed: u64, rng: &mut impl Rng) -> Stage {
    let office = Office::new(seed);
    let gait = Gait {
        speed_m_per_s: rng.random_range(0.65..0.95),
        height_m: rng.random_range(1.35..1.6),
        rounding_m: rng.random_range(0.5..0.7),
        foresight_m: rng.random_range(0.35..0.5),
    };
    let waypoints = walk(&way_through(&office, rng), &gait, INTERVAL_S);
    let duration_s = (waypoints.len() as f64 * INTERVAL_S - 1.0).min(OFFICE_S_MAX);
    Stage {
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&BOB, rng)),
        camera: video_camera(500.0, rng),
        body_from_camera: mounted(0.0, 0.12),
        duration_s,
        world: office.world,
    }
}

fn way_through(office: &Office, rng: &mut impl Rng) -> Vec<Vector2<f64>> {
    let beyond = office.stops.iter().position(|stop| stop.is_beyond_corner);
    let (first, second) = office
        .stops
        .split_at(beyond.expect("each corridor has rooms"));
    let mut pick = |stops: &[Stop]| stops[rng.random_range(0..stops.len())].clone();
    let (start, next, last) = (pick(first), pick(first), pick(second));
    let mut way = around(&start, rng);
    way.drain(..2);
    if next.before != start.before {
        way.extend(around(&next, rng));
    }
    way.push(office.corner);
    way.extend(around(&last, rng));
    way.push(office.end);
    way.push(office.corner);
    way.push(-office.corner);
    way.dedup_by(|a, b| (*a - *b).norm() < 0.1);
    way
}

/// From before a room's door around the room and back.
fn around(stop: &Stop, rng: &mut impl Rng) -> Vec<Vector2<f64>> {
    let nearest = (0..4).min_by(|a, b| {
        let distance = |idx: usize| (stop.around[idx] - stop.inside).norm();
        distance(*a).total_cmp(&distance(*b))
    });
    let first = nearest.expect("a room has four corners");
    let step = if rng.random_bool(0.5) { 1 } else { 3 };
    let ring = (0..4).map(|corner| stop.around[(first + corner * step) % 4]);
    [stop.before, stop.inside]
        .into_iter()
        .chain(ring)
        .chain([stop.inside, stop.before])
        .collect()
}

/// Once around the block and on for some metres.
pub fn corridor(seed: u64, rng: &mut impl Rng) -> Stage {
    let [length_m, width_m] = corridor_outline_m(seed);
    let circuit = Loop {
        half_length_m: 0.5 * length_m,
        half_width_m: 0.5 * width_m,
        corner_radius_m: 0.9,
    };
    let start_m = rng.random_range(0.0..20.0);
    let end_m = start_m + circuit.perimeter_m() + rng.random_range(10.0..15.0);
    let speed_m_per_s = rng.random_range(1.35..1.6);
    let aside = [(); 2].map(|()| rng.random_range(0.0..6.0));
    let height_m = rng.random_range(1.3..1.6);
    let mut waypoints = Vec::new();
    let mut distance_m = start_m;
    while distance_m < end_m {
        let ([x, y], yaw_rad) = circuit.at(distance_m);
        let (_, before_rad) = circuit.at(distance_m - 0.7);
        let (_, after_rad) = circuit.at(distance_m + 0.9);
        let turning = ((after_rad - before_rad) / std::f64::consts::FRAC_PI_2).min(1.0);
        // Nobody walks quite in the middle, nor looks quite ahead.
        let left_m = 0.2 * (0.21 * distance_m + aside[0]).sin();
        let glance_rad = 0.12 * (0.13 * distance_m + aside[1]).sin();
        let left = Vector3::new(-yaw_rad.sin(), yaw_rad.cos(), 0.0);
        waypoints.push(Waypoint {
            position: Vector3::new(x, y, height_m) + left * left_m,
            yaw_rad: yaw_rad + glance_rad,
        });
        distance_m += speed_m_per_s * (1.0 - 0.55 * turning) * INTERVAL_S;
    }
    let duration_s = (waypoints.len() - 2) as f64 * INTERVAL_S;
    Stage {
        world: World::corridor(seed),
        route: Route::new(waypoints, INTERVAL_S, Wobble::new(&BOB, rng)),
        camera: video_camera(310.0, rng),
        body_from_camera: mounted(0.0, 0.05),
        duration_s,
    }
}

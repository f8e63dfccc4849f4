//! The lab's vehicles and their routes.
//!
//! One drone flies to and fro before a long wall, and the other holds its place behind it: so
//! both look at that wall all the time. The ground vehicle begins between them and the wall's
//! one end, and goes around with its camera turned to the right: it sees that end of the wall
//! first, then all others, and comes back in the end.

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::marker_light::MarkerLights;
use crate::route::{Loop, Route, Waypoint, Wobble, WobbleSettings};
use crate::world::{Cuboid, World};

pub const DURATION_S: f64 = 52.0;
const INTERVAL_S: f64 = 0.5;
const GROUND_SPEED_M_PER_S: f64 = 0.33;

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

/// The first drone's distance from the wall, which furniture does not reach.
const FIRST_DRONE_M: f64 = 1.2;
/// How far the second drone holds itself behind the first: where marker lights 0.1 m apart are
/// 10 px apart in its picture.
const PLACE_BEHIND_M: f64 = 1.81;
/// The ground vehicle goes around between the two.
const GROUND_VEHICLE_M: f64 = 2.1;
const CORNER_RADIUS_M: f64 = 1.1;

/// The routes of `ugv1`, `drone1` and `drone2`.
pub fn routes(world: &World, seed: u64) -> Vec<Route> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0002);
    let wall = Wall::new(world, rng.random_bool(0.5));
    let sweep = Sweep::draw(&wall, &mut rng);
    vec![
        ground_vehicle(world, &wall, &mut rng),
        first_drone(&wall, &sweep, &mut rng),
        second_drone(&wall, &sweep, &mut rng),
    ]
}

/// What is seen of a drone: a plate, and an upright shield across its heading that carries the
/// lights, so that they stand out before bright walls.
pub fn drone_hull(lights: &MarkerLights) -> Vec<Cuboid> {
    let around_origin = |extents: Vector3<f64>| Cuboid {
        centre: Vector3::zeros(),
        half: extents * 0.5,
        yaw_rad: 0.0,
    };
    vec![
        around_origin(Vector3::new(0.16, 0.16, 0.04)),
        around_origin(Vector3::new(0.012, 0.14, lights.length_m + 0.1)),
    ]
}

/// What is seen of the ground vehicle: a box under a camera on a mast.
pub fn ground_vehicle_hull() -> Vec<Cuboid> {
    let standing = |bottom_m: f64, extents: Vector3<f64>| {
        Cuboid::standing(Vector3::z() * bottom_m, extents, 0.0)
    };
    vec![
        standing(-0.36, Vector3::new(0.5, 0.36, 0.2)),
        standing(-0.16, Vector3::new(0.05, 0.05, 0.18)),
    ]
}

/// The long wall where everything begins.
struct Wall {
    /// The ground vehicle's direction of travel, towards its first corner.
    along: Vector2<f64>,
    inward: Vector2<f64>,
    middle: Vector2<f64>,
    half_length_m: f64,
    /// Laps of the loops until its middle.
    lap: f64,
}

impl Wall {
    fn new(world: &World, is_first: bool) -> Self {
        let side = if is_first { 1.0 } else { -1.0 };
        Self {
            along: Vector2::new(side, 0.0),
            inward: Vector2::new(0.0, side),
            middle: Vector2::new(0.0, -0.5 * side * world.size_m.y),
            half_length_m: 0.5 * world.size_m.x,
            lap: if is_first { 0.0 } else { 0.5 },
        }
    }

    /// The place so far along the wall from its middle, and so far from it.
    fn place(&self, along_m: f64, inward_m: f64, height_m: f64) -> Vector3<f64> {
        let point = self.middle + self.along * along_m + self.inward * inward_m;
        point.push(height_m)
    }

    /// The heading of who looks at it.
    fn outward_rad(&self) -> f64 {
        (-self.inward.y).atan2(-self.inward.x)
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

fn ground_vehicle(world: &World, wall: &Wall, rng: &mut impl Rng) -> Route {
    let inset_m = GROUND_VEHICLE_M + rng.random_range(-0.02..0.02);
    let circuit = Loop {
        half_length_m: 0.5 * world.size_m.x - inset_m,
        half_width_m: 0.5 * world.size_m.y - inset_m,
        corner_radius_m: CORNER_RADIUS_M,
    };
    let height_m = rng.random_range(0.4..0.48);
    let speed_m_per_s = GROUND_SPEED_M_PER_S * rng.random_range(0.97..1.03);
    // A straight path alone does not tell where it is, so the first corner comes soon.
    let before_corner_m = rng.random_range(0.65..0.75);
    let corner_m = circuit.half_length_m - circuit.corner_radius_m;
    let mut distance_m = wall.lap * circuit.perimeter_m() + corner_m - before_corner_m;
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

/// Sideways to and fro along the wall, at first away from the ground vehicle's corner.
struct Sweep {
    /// Metres from the wall's middle at each waypoint.
    along_m: Vec<f64>,
}

/// Turning around takes this long, so that a follower can keep up.
const TURN_S: f64 = 4.5;

impl Sweep {
    fn draw(wall: &Wall, rng: &mut impl Rng) -> Self {
        let leg_m = rng.random_range(3.3..3.5);
        let speed_m_per_s = rng.random_range(0.385..0.41);
        let first_turn_s = rng.random_range(5.2..5.8);
        // Half a turn covers 0.6875 of the way at full speed.
        let period_s = leg_m / speed_m_per_s + 0.3125 * TURN_S;
        let mut along_m = Vec::new();
        let mut here_m = 0.0;
        for time_s in times_s() {
            along_m.push(here_m);
            let mut direction = -1.0;
            let turns_s = (0..6).map(|turn| first_turn_s + period_s * f64::from(turn));
            for (turn, turn_s) in turns_s.enumerate() {
                let turned = ramp(time_s, turn_s - 0.5 * TURN_S, turn_s + 0.5 * TURN_S);
                direction += if turn % 2 == 0 { 2.0 } else { -2.0 } * turned;
            }
            here_m += speed_m_per_s * direction * ramp(time_s, -0.8, 2.4) * INTERVAL_S;
        }
        let least_m = along_m.iter().copied().fold(f64::INFINITY, f64::min);
        let start_m = wall.half_length_m - SWEEP_START_M - least_m;
        for place_m in &mut along_m {
            *place_m += start_m;
        }
        Self { along_m }
    }
}

/// The sweep's end that is further from the ground vehicle's first corner, from that corner.
const SWEEP_START_M: f64 = 4.7;

/// The slow motions of a drone beside its way.
struct Swing {
    cruise_m: f64,
    phases: [f64; 3],
}

impl Swing {
    fn draw(rng: &mut impl Rng) -> Self {
        Self {
            cruise_m: rng.random_range(1.0..1.12),
            phases: [0; 3].map(|_| rng.random_range(0.0..std::f64::consts::TAU)),
        }
    }

    fn at(&self, time_s: f64, period_s: f64, phase: usize) -> f64 {
        (std::f64::consts::TAU * time_s / period_s + self.phases[phase]).sin()
    }

    /// Rises, then goes up and down a little.
    fn height_m(&self, time_s: f64) -> f64 {
        let risen = ramp(time_s, -1.0, 4.5);
        0.45 + (self.cruise_m - 0.45 + 0.06 * self.at(time_s, 13.0, 0)) * risen
    }

    fn yaw_rad(&self, wall: &Wall, time_s: f64) -> f64 {
        wall.outward_rad() + 0.02 * self.at(time_s, 11.0, 1)
    }
}

fn first_drone(wall: &Wall, sweep: &Sweep, rng: &mut impl Rng) -> Route {
    let swing = Swing::draw(rng);
    let waypoint = |(time_s, along_m): (f64, &f64)| {
        let inward_m = FIRST_DRONE_M + 0.06 * swing.at(time_s, 9.0, 2);
        Waypoint {
            position: wall.place(*along_m, inward_m, swing.height_m(time_s)),
            yaw_rad: swing.yaw_rad(wall, time_s),
        }
    };
    let waypoints = times_s().zip(&sweep.along_m).map(waypoint).collect();
    Route::new(waypoints, INTERVAL_S, Wobble::new(&DRONE_WOBBLE, rng))
}

/// Where it hovers until it commands something: nearly in its place behind the first.
fn second_drone(wall: &Wall, sweep: &Sweep, rng: &mut impl Rng) -> Route {
    let swing = Swing::draw(rng);
    // Its first way leads to where the other one goes, too.
    let along_m = sweep.along_m[0] + rng.random_range(0.02..0.14);
    let inward_m = FIRST_DRONE_M + PLACE_BEHIND_M + rng.random_range(-0.08..0.08);
    let waypoint = |time_s: f64| Waypoint {
        position: wall.place(along_m, inward_m, swing.height_m(time_s)),
        yaw_rad: swing.yaw_rad(wall, time_s),
    };
    let waypoints = times_s().map(waypoint).collect();
    Route::new(waypoints, INTERVAL_S, Wobble::new(&DRONE_WOBBLE, rng))
}

#[cfg(test)]
mod tests;

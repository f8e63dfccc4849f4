//! Where a vehicle is at any time: a smooth path, and the wobble of what carries it.

use geometry::{Body, Camera, Enu, Transform, so3};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

use crate::renderer::Shot;

/// A place on the way: position in the site frame and heading, unwrapped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    pub position: Vector3<f64>,
    pub yaw_rad: f64,
}

/// A path through waypoints at equal times, as a uniform cubic B-spline: acceleration is
/// continuous, and corners are cut a little.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    waypoints: Vec<Waypoint>,
    interval_s: f64,
    wobble: Wobble,
}

/// How a vehicle moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    pub site_from_body: Transform<Enu, Body>,
    pub velocity_in_site: Vector3<f64>,
    pub rotation_rate_in_body: Vector3<f64>,
}

impl Motion {
    /// What a camera that moves like this sees at plain exposure; the body's origin is its centre.
    pub fn shot(&self, body_from_camera: &Transform<Body, Camera>) -> Shot {
        let site_from_camera = self.site_from_body * *body_from_camera;
        let camera_from_body = body_from_camera.rotation().inverse();
        Shot {
            site_from_camera,
            velocity_in_camera: site_from_camera.rotation().inverse() * self.velocity_in_site,
            rotation_rate_in_camera: camera_from_body * self.rotation_rate_in_body,
            gain: 1.0,
            noise_seed: 0,
        }
    }
}

/// Velocities are differences over twice this time; wobble is slow against it.
const DIFFERENCE_S: f64 = 1e-3;

impl Route {
    /// The route over these waypoints, the first of which is passed at time zero.
    pub fn new(waypoints: Vec<Waypoint>, interval_s: f64, wobble: Wobble) -> Self {
        assert!(!waypoints.is_empty() && interval_s > 0.0);
        Self {
            waypoints,
            interval_s,
            wobble,
        }
    }

    /// Position and velocity; before the first and after the last waypoint the vehicle rests.
    pub fn motion(&self, time_s: f64) -> Motion {
        let before = self.pose(time_s - DIFFERENCE_S);
        let after = self.pose(time_s + DIFFERENCE_S);
        let turn = before.rotation().inverse() * after.rotation();
        Motion {
            site_from_body: self.pose(time_s),
            velocity_in_site: (after.translation() - before.translation()) / (2.0 * DIFFERENCE_S),
            rotation_rate_in_body: so3::log(&turn) / (2.0 * DIFFERENCE_S),
        }
    }

    pub fn pose(&self, time_s: f64) -> Transform<Enu, Body> {
        let Waypoint { position, yaw_rad } = self.smoothed(time_s);
        let (shift, tilt_rad) = self.wobble.at(time_s);
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        Transform::new(heading * so3::exp(&tilt_rad), position + heading * shift)
    }

    /// The length of the path without wobble, metres.
    pub fn length_m(&self, duration_s: f64) -> f64 {
        let steps = (duration_s / 0.05) as usize;
        let at = |step: usize| self.smoothed(0.05 * step as f64).position;
        (0..steps)
            .map(|step| (at(step + 1) - at(step)).norm())
            .sum()
    }

    fn smoothed(&self, time_s: f64) -> Waypoint {
        let position = (time_s / self.interval_s).clamp(0.0, self.waypoints.len() as f64);
        let knot = position.floor();
        let t = position - knot;
        let weights = [
            (1.0 - t).powi(3) / 6.0,
            (3.0 * t.powi(3) - 6.0 * t * t + 4.0) / 6.0,
            (-3.0 * t.powi(3) + 3.0 * t * t + 3.0 * t + 1.0) / 6.0,
            t.powi(3) / 6.0,
        ];
        let mut sum = Waypoint {
            position: Vector3::zeros(),
            yaw_rad: 0.0,
        };
        for (offset, weight) in weights.into_iter().enumerate() {
            let idx = (knot as usize + offset).saturating_sub(1);
            let waypoint = &self.waypoints[idx.min(self.waypoints.len() - 1)];
            sum.position += waypoint.position * weight;
            sum.yaw_rad += waypoint.yaw_rad * weight;
        }
        sum
    }
}

/// How strongly a vehicle shakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WobbleSettings {
    /// Amplitude along each axis, metres.
    pub shift_m: f64,
    /// Amplitude of roll and pitch; yaw takes half.
    pub tilt_rad: f64,
    /// The slowest and the fastest component.
    pub rate_hz: [f64; 2],
}

/// Three sines for each degree of freedom.
#[derive(Clone, Debug, PartialEq)]
pub struct Wobble {
    sines: Vec<[Sine; 3]>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sine {
    amplitude: f64,
    rate_rad_per_s: f64,
    phase_rad: f64,
}

impl Wobble {
    pub fn new(settings: &WobbleSettings, rng: &mut impl Rng) -> Self {
        let WobbleSettings {
            shift_m,
            tilt_rad,
            rate_hz,
        } = *settings;
        let amplitudes = [
            shift_m,
            shift_m,
            shift_m,
            tilt_rad,
            tilt_rad,
            0.5 * tilt_rad,
        ];
        let mut sine = |amplitude: f64| Sine {
            amplitude: amplitude / 3.0,
            rate_rad_per_s: std::f64::consts::TAU * rng.random_range(rate_hz[0]..rate_hz[1]),
            phase_rad: rng.random_range(0.0..std::f64::consts::TAU),
        };
        Self {
            sines: amplitudes
                .map(|amplitude| [0; 3].map(|_| sine(amplitude)))
                .to_vec(),
        }
    }

    /// Shift and rotation vector in the body.
    fn at(&self, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let sum = |axis: usize| -> f64 {
            let value = |s: &Sine| s.amplitude * (s.rate_rad_per_s * time_s + s.phase_rad).sin();
            self.sines[axis].iter().map(value).sum()
        };
        (
            Vector3::new(sum(0), sum(1), sum(2)),
            Vector3::new(sum(3), sum(4), sum(5)),
        )
    }
}

/// A rectangle with round corners about the origin, gone around counter-clockwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loop {
    pub half_length_m: f64,
    pub half_width_m: f64,
    pub corner_radius_m: f64,
}

impl Loop {
    pub fn perimeter_m(&self) -> f64 {
        let straight = self.half_length_m + self.half_width_m - 2.0 * self.corner_radius_m;
        4.0 * straight + std::f64::consts::TAU * self.corner_radius_m
    }

    /// The point `distance_m` after the middle of the side at −y, with the direction of travel;
    /// further laps go on turning.
    pub fn at(&self, distance_m: f64) -> ([f64; 2], f64) {
        let radius = self.corner_radius_m;
        let half = [self.half_length_m - radius, self.half_width_m - radius];
        let corner_m = std::f64::consts::FRAC_PI_2 * radius;
        let laps = (distance_m / self.perimeter_m()).floor();
        let mut left_m = distance_m - laps * self.perimeter_m();
        let mut yaw_rad = laps * std::f64::consts::TAU;
        let mut point = [0.0, -self.half_width_m];
        for side in 0..5 {
            // The first side begins in its middle.
            let whole_m = 2.0 * half[side % 2];
            let side_m = if side == 0 { 0.5 * whole_m } else { whole_m };
            let straight_m = left_m.min(side_m);
            point = ahead(point, yaw_rad, [straight_m, 0.0]);
            left_m -= straight_m;
            let angle_rad = left_m.min(corner_m) / radius;
            let bend = [radius * angle_rad.sin(), radius * (1.0 - angle_rad.cos())];
            point = ahead(point, yaw_rad, bend);
            yaw_rad += angle_rad;
            left_m -= left_m.min(corner_m);
            if left_m <= 0.0 {
                break;
            }
        }
        (point, yaw_rad)
    }
}

fn ahead(point: [f64; 2], yaw_rad: f64, step: [f64; 2]) -> [f64; 2] {
    let (sine, cosine) = yaw_rad.sin_cos();
    [
        point[0] + cosine * step[0] - sine * step[1],
        point[1] + sine * step[0] + cosine * step[1],
    ]
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn a_loop_closes_and_never_jumps() {
        let circuit = Loop {
            half_length_m: 3.0,
            half_width_m: 2.0,
            corner_radius_m: 1.0,
        };
        let perimeter_m = circuit.perimeter_m();
        assert!((perimeter_m - (12.0 + std::f64::consts::TAU)).abs() < 1e-12);
        let mut before = circuit.at(-0.5);
        for step in 1..5000 {
            let distance_m = -0.5 + 0.01 * f64::from(step);
            let here = circuit.at(distance_m);
            let moved = (here.0[0] - before.0[0]).hypot(here.0[1] - before.0[1]);
            assert!((moved - 0.01).abs() < 1e-4, "{distance_m}: {moved}");
            assert!((-1e-9..0.0101).contains(&(here.1 - before.1)));
            before = here;
        }
        let (point, yaw_rad) = circuit.at(perimeter_m * 1.5);
        assert!(point[0].abs() < 1e-9 && (point[1] - 2.0).abs() < 1e-9);
        assert!((yaw_rad - 1.5 * std::f64::consts::TAU).abs() < 1e-9);
    }

    #[test]
    fn velocities_are_those_of_the_poses() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let waypoints = (0..20)
            .map(|idx| Waypoint {
                position: Vector3::new(0.2 * f64::from(idx), 0.0, 1.0),
                yaw_rad: 0.1 * f64::from(idx),
            })
            .collect();
        let settings = WobbleSettings {
            shift_m: 0.0,
            tilt_rad: 0.0,
            rate_hz: [0.5, 1.0],
        };
        let route = Route::new(waypoints, 0.5, Wobble::new(&settings, &mut rng));
        let motion = route.motion(4.0);
        assert!((motion.velocity_in_site - Vector3::new(0.4, 0.0, 0.0)).norm() < 1e-6);
        assert!((motion.rotation_rate_in_body - Vector3::new(0.0, 0.0, 0.2)).norm() < 1e-6);
        let position = motion.site_from_body.translation();
        assert!((position - Vector3::new(1.6, 0.0, 1.0)).norm() < 1e-9);
        assert!(route.motion(100.0).velocity_in_site.norm() < 1e-9);
        assert!((route.length_m(9.0) - 3.6).abs() < 0.2);
    }
}

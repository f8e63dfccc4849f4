//! Which directions the cameras cover, and covered lately: nobody flies where nobody looks.

use nalgebra::Vector3;

use crate::bounded::Bounded;

/// At most this many cameras are told apart.
pub const VIEW_COUNT_MAX: usize = 8;

/// What one camera, or several side by side, cover in the heading frame: a wedge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldOfView {
    /// Where its middle points, left of ahead.
    pub azimuth_rad: f64,
    /// To either side of the middle.
    pub half_width_rad: f64,
    /// Above and below level.
    pub elevation_rad_max: f64,
}

impl FieldOfView {
    /// Everything but the blind rear of the paper, straight up and down included.
    pub fn all_but_rear() -> Self {
        Self {
            azimuth_rad: 0.0,
            half_width_rad: 150_f64.to_radians(),
            elevation_rad_max: std::f64::consts::FRAC_PI_2,
        }
    }

    /// Whether it covers a direction of any length; standing still is covered everywhere.
    pub fn contains(&self, direction: &Vector3<f64>) -> bool {
        let across_m = direction.x.hypot(direction.y);
        let is_level_enough = self.elevation_rad_max >= std::f64::consts::FRAC_PI_2
            || direction.z.abs() <= across_m * self.elevation_rad_max.tan() + SLACK;
        is_level_enough && self.beyond_rad(direction) <= SLACK
    }

    /// How far beside the wedge a direction points.
    fn beyond_rad(&self, direction: &Vector3<f64>) -> f64 {
        if direction.x.hypot(direction.y) <= SLACK {
            return 0.0;
        }
        let difference = wrapped(direction.y.atan2(direction.x) - self.azimuth_rad);
        difference.abs() - self.half_width_rad
    }

    /// The part of a velocity that points into the wedge.
    fn clamped(&self, velocity: &Vector3<f64>) -> Vector3<f64> {
        let mut across = *velocity;
        across.z = 0.0;
        let beyond_rad = self.beyond_rad(velocity);
        if beyond_rad > 0.0 {
            let side = wrapped(velocity.y.atan2(velocity.x) - self.azimuth_rad).signum();
            let border_rad = self.azimuth_rad + side * self.half_width_rad;
            let speed_mps = across.norm() * beyond_rad.cos().max(0.0);
            across = Vector3::new(border_rad.cos(), border_rad.sin(), 0.0) * speed_mps;
        }
        if self.elevation_rad_max < std::f64::consts::FRAC_PI_2 {
            let climb_mps = across.norm() * self.elevation_rad_max.tan();
            across.z = velocity.z.clamp(-climb_mps, climb_mps);
        } else {
            across.z = velocity.z;
        }
        across
    }
}

/// Rounding at the border of a wedge.
const SLACK: f64 = 1e-9;

fn wrapped(angle_rad: f64) -> f64 {
    let turn_rad = std::f64::consts::TAU;
    angle_rad - turn_rad * (angle_rad / turn_rad).round()
}

/// What was covered during the last seconds, while the vehicle may have turned.
#[derive(Clone, Debug)]
pub struct Coverage {
    memory_s: f64,
    glances: Bounded<Glance, GLANCE_COUNT_MAX>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Glance {
    view: FieldOfView,
    heading_rad: f64,
    age_s: f64,
}

impl Glance {
    /// The wedge in the heading frame of another heading.
    fn seen_from(&self, heading_rad: f64) -> FieldOfView {
        let mut view = self.view;
        view.azimuth_rad += self.heading_rad - heading_rad;
        view
    }
}

/// When a turning vehicle has looked in more directions, the oldest are forgotten.
const GLANCE_COUNT_MAX: usize = 48;
/// Headings that differ by less are the same glance.
const SAME_HEADING_RAD: f64 = 0.05;

impl Coverage {
    /// - `memory_s`: a direction that was not covered for so long counts as not seen.
    pub fn new(memory_s: f64) -> Self {
        Self {
            memory_s,
            glances: Bounded::default(),
        }
    }

    /// Takes what the cameras that gave an image cover now.
    pub fn update(&mut self, views: &[FieldOfView], heading_rad: f64, step_s: f64) {
        for glance in self.glances.iter_mut() {
            glance.age_s += step_s;
        }
        let memory_s = self.memory_s;
        self.glances.retain(|glance| glance.age_s <= memory_s);
        for view in views.iter().take(VIEW_COUNT_MAX) {
            let is_same = |glance: &&mut Glance| {
                glance.view == *view
                    && wrapped(glance.heading_rad - heading_rad).abs() < SAME_HEADING_RAD
            };
            let glance = Glance {
                view: *view,
                heading_rad,
                age_s: 0.0,
            };
            if let Some(same) = self.glances.iter_mut().find(is_same) {
                *same = glance;
            } else if self.glances.push(glance).is_err() {
                let oldest = self
                    .glances
                    .iter_mut()
                    .max_by(|left, right| left.age_s.total_cmp(&right.age_s));
                if let Some(oldest) = oldest {
                    *oldest = glance;
                }
            }
        }
    }

    /// Whether a direction in the heading frame was looked at lately.
    pub fn covers(&self, direction: &Vector3<f64>, heading_rad: f64) -> bool {
        self.glances
            .iter()
            .any(|glance| glance.seen_from(heading_rad).contains(direction))
    }

    /// The part of a velocity in the heading frame that points where was looked lately; all of it
    /// if it does, nothing if nobody looks.
    pub fn clamp(&self, velocity: &Vector3<f64>, heading_rad: f64) -> Vector3<f64> {
        let mut best = Vector3::zeros();
        let mut best_along = 0.0;
        for glance in self.glances.iter() {
            let view = glance.seen_from(heading_rad);
            if view.contains(velocity) {
                return *velocity;
            }
            let clamped = view.clamped(velocity);
            let along = clamped.dot(velocity);
            if along > best_along {
                best_along = along;
                best = clamped;
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn forward_camera() -> FieldOfView {
        FieldOfView {
            azimuth_rad: 0.0,
            half_width_rad: 0.73,
            elevation_rad_max: 0.6,
        }
    }

    #[test]
    fn a_turned_vehicle_remembers_where_it_looked() {
        let mut coverage = Coverage::new(2.0);
        let back = -Vector3::x();
        coverage.update(&[forward_camera()], 0.0, 0.1);
        coverage.update(&[forward_camera()], std::f64::consts::PI, 0.1);
        // Behind is where it looked first.
        assert_eq!(coverage.clamp(&back, std::f64::consts::PI), back);
        for _ in 0..21 {
            coverage.update(&[forward_camera()], std::f64::consts::PI, 0.1);
        }
        assert_eq!(
            coverage.clamp(&back, std::f64::consts::PI),
            Vector3::zeros()
        );
    }

    #[test]
    fn a_blind_vehicle_stands_still_after_the_memory_is_over() {
        let mut coverage = Coverage::new(2.0);
        coverage.update(&[forward_camera()], 0.0, 0.1);
        for _ in 0..21 {
            coverage.update(&[], 0.0, 0.1);
        }
        assert_eq!(coverage.clamp(&Vector3::x(), 0.0), Vector3::zeros());
    }

    proptest! {
        #[test]
        fn what_is_left_of_a_velocity_points_into_a_view(
            x in -1.0_f64..1.0, y in -1.0_f64..1.0, z in -1.0_f64..1.0,
            middle_rad in -3.0_f64..3.0, half_width_rad in 0.1_f64..2.7,
            elevation_rad_max in 0.1_f64..1.4,
        ) {
            let view = FieldOfView { azimuth_rad: middle_rad, half_width_rad, elevation_rad_max };
            let mut coverage = Coverage::new(2.0);
            coverage.update(&[view], 0.0, 0.1);
            let velocity = Vector3::new(x, y, z);
            let clamped = coverage.clamp(&velocity, 0.0);
            let mut widened = view;
            widened.half_width_rad += 1e-6;
            widened.elevation_rad_max += 1e-6;
            prop_assert!(widened.contains(&clamped), "{clamped:?}");
            prop_assert!(clamped.norm() <= velocity.norm() + 1e-12);
            prop_assert!(clamped.dot(&velocity) >= -1e-12);
        }
    }
}

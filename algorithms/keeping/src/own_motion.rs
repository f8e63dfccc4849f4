//! How a vehicle moves itself, as far as its autopilot has taken up what was commanded.

use nalgebra::Vector3;

/// A camera that is silent for longer shows nobody who is near: what was commanded decays.
const HOLD_S: f64 = 0.3;
const DECAY_S: f64 = 0.2;

/// A model of the autopilot: a lag of first order behind what is commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnMotion {
    lag_s: f64,
    velocity: Vector3<f64>,
    commanded: Vector3<f64>,
}

impl OwnMotion {
    /// - `lag_s`: time constant. With a wrong one, how others move is found later.
    pub fn new(lag_s: f64) -> Self {
        Self {
            lag_s,
            velocity: Vector3::zeros(),
            commanded: Vector3::zeros(),
        }
    }

    /// Lets time pass, in which nothing else was commanded.
    pub fn advance(&mut self, step_s: f64) {
        let flown = held(&self.commanded, step_s);
        self.velocity += (flown - self.velocity) * (1.0 - (-step_s / self.lag_s).exp());
    }

    pub fn command(&mut self, velocity: &Vector3<f64>) {
        self.commanded = *velocity;
    }

    pub fn velocity(&self) -> &Vector3<f64> {
        &self.velocity
    }
}

/// What is flown of a commanded velocity so long after the image that it came from: the same for
/// a moment, then less and less.
pub fn held(commanded: &Vector3<f64>, age_s: f64) -> Vector3<f64> {
    commanded * (-(age_s - HOLD_S).max(0.0) / DECAY_S).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_taken_up_and_fades_when_no_image_follows() {
        let mut own = OwnMotion::new(0.3);
        own.command(&Vector3::x());
        for _ in 0..20 {
            own.advance(0.1);
        }
        assert!((own.velocity().x - 1.0).abs() < 0.01);
        // A pause of the camera, in which the autopilot was told to stop.
        own.advance(2.0);
        assert!(own.velocity().norm() < 0.01, "{:?}", own.velocity());
    }
}

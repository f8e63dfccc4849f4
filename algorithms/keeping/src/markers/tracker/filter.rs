//! What is expected of a pair in the next frame: a constant-velocity filter.

use super::EgoMotion;
use crate::markers::pairs::MarkerPair;

/// Position, and the logarithm of the separation with its rate and their covariance.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    pub center_px: [f64; 2],
    velocity_px_per_s: [f64; 2],
    /// From the upper light to the lower one, a unit vector.
    direction: [f64; 2],
    log_separation: f64,
    pub rate_per_s: f64,
    /// Variances of both and their covariance: ss, sr, rr.
    covariance: [f64; 3],
    since_measured_s: f64,
}

/// A new pair may come or go this fast, one sigma, per second.
const RATE_SIGMA_AT_BIRTH: f64 = 0.3;
/// Share of a step in the image that counts as velocity: a jerk is not a motion.
const VELOCITY_GAIN: f64 = 0.3;
/// Velocity dies away while nothing is seen, seconds.
const VELOCITY_LIFETIME_S: f64 = 0.5;
/// Measured separations may be off by this many sigmas before they count as impossible.
const PLAUSIBLE_SIGMAS: f64 = 5.0;

impl Filter {
    pub fn begin(pair: &MarkerPair) -> Self {
        Self {
            center_px: pair.center_px,
            velocity_px_per_s: [0.0; 2],
            direction: direction(pair),
            log_separation: pair.separation_px.ln(),
            rate_per_s: 0.0,
            covariance: [log_variance(pair), 0.0, RATE_SIGMA_AT_BIRTH.powi(2)],
            since_measured_s: 0.0,
        }
    }

    pub fn separation_px(&self) -> f64 {
        self.log_separation.exp()
    }

    pub fn sigma_separation_px(&self) -> f64 {
        self.separation_px() * self.covariance[0].sqrt()
    }

    pub fn lights_px(&self) -> [[f64; 2]; 2] {
        let half = 0.5 * self.separation_px();
        [-half, half]
            .map(|along| [0, 1].map(|axis| self.center_px[axis] + along * self.direction[axis]))
    }

    /// Moves on to the time of the next frame.
    pub fn predict(&mut self, elapsed_s: f64, rate_noise: f64, ego: Option<&EgoMotion>) {
        if let Some(ego) = ego {
            self.center_px = ego.moved(self.center_px);
        }
        for (center, velocity) in self.center_px.iter_mut().zip(&mut self.velocity_px_per_s) {
            *center += *velocity * elapsed_s;
            *velocity *= (-self.since_measured_s / VELOCITY_LIFETIME_S).exp();
        }
        self.since_measured_s += elapsed_s;
        // Held, not extrapolated: without sightings the rate soon says nothing.
        let moves = self.since_measured_s <= VELOCITY_LIFETIME_S;
        self.log_separation += if moves {
            self.rate_per_s * elapsed_s
        } else {
            0.0
        };
        let [ss, sr, rr] = self.covariance;
        let noise = rate_noise * rate_noise;
        self.covariance = [
            ss + elapsed_s * (2.0 * sr + elapsed_s * rr) + noise * elapsed_s.powi(3) / 3.0,
            sr + elapsed_s * rr + noise * elapsed_s.powi(2) / 2.0,
            rr + noise * elapsed_s,
        ];
    }

    /// Takes in a sighting (Kalman).
    pub fn correct(&mut self, pair: &MarkerPair) {
        let innovation = pair.separation_px.ln() - self.log_separation;
        let [ss, sr, rr] = self.covariance;
        let variance = ss + log_variance(pair);
        let (gain_s, gain_r) = (ss / variance, sr / variance);
        self.log_separation += gain_s * innovation;
        self.rate_per_s += gain_r * innovation;
        self.covariance = [ss * (1.0 - gain_s), sr * (1.0 - gain_s), rr - gain_r * sr];
        for axis in 0..2 {
            // Predicted already: what is left is what the velocity did not explain.
            let step_px = pair.center_px[axis] - self.center_px[axis];
            self.center_px[axis] = pair.center_px[axis];
            if self.since_measured_s > 0.0 {
                self.velocity_px_per_s[axis] += VELOCITY_GAIN * step_px / self.since_measured_s;
            }
        }
        self.direction = direction(pair);
        self.since_measured_s = 0.0;
    }

    /// Whether a drone could have moved so.
    pub fn is_plausible(&self, pair: &MarkerPair, elapsed_s: f64, rate_max_per_s: f64) -> bool {
        let change = (pair.separation_px.ln() - self.log_separation).abs();
        let sigma = (self.covariance[0] + log_variance(pair)).sqrt();
        change <= rate_max_per_s * elapsed_s.max(0.0) + PLAUSIBLE_SIGMAS * sigma
    }
}

fn log_variance(pair: &MarkerPair) -> f64 {
    (pair.sigma_separation_px / pair.separation_px).powi(2)
}

fn direction(pair: &MarkerPair) -> [f64; 2] {
    let [first, second] = pair.lights.map(|light| light.center_px);
    [0, 1].map(|axis| (second[axis] - first[axis]) / pair.separation_px)
}

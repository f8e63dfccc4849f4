//! The paper's flight test on simulated pixels: one drone hovers, another holds its place behind.

use keeping::{Follower, FollowerSettings, LightPair, PlanarVelocity};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// One frame of the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowingMoment {
    pub time_s: f64,
    pub measured: Option<LightPair>,
    pub smoothed: Option<LightPair>,
    pub range_m: f64,
}

/// How the drone and its camera behave: those of the paper's small quadrotor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowingSettings {
    pub focal_px: f64,
    pub principal_px: f64,
    pub light_distance_m: f64,
    pub rate_hz: f64,
    pub latency_s: f64,
    pub lag_s: f64,
    pub noise_px: f64,
    pub missed: f64,
    pub start_range_m: f64,
    pub start_left_m: f64,
    pub duration_s: f64,
}

impl Default for FollowingSettings {
    fn default() -> Self {
        Self {
            focal_px: 181.0,
            principal_px: 159.23,
            light_distance_m: 0.1,
            rate_hz: 20.0,
            latency_s: 0.15,
            lag_s: 0.3,
            noise_px: 0.3,
            missed: 0.1,
            start_range_m: 3.0,
            start_left_m: 0.6,
            duration_s: 40.0,
        }
    }
}

/// Flies the follower once.
pub fn follow(
    settings: &FollowingSettings,
    follower: FollowerSettings,
    seed: u64,
) -> Vec<FollowingMoment> {
    let step_s = 1.0 / settings.rate_hz;
    let latency_steps = (settings.latency_s * settings.rate_hz).round() as usize;
    let gain = 1.0 - (-step_s / settings.lag_s).exp();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut follower = Follower::new(follower);
    // Where the leader is from the follower, which never turns.
    let (mut ahead_m, mut left_m) = (settings.start_range_m, settings.start_left_m);
    let mut own = PlanarVelocity::default();
    let mut past = Vec::new();
    let mut moments = Vec::new();
    for idx in 0..(settings.duration_s * settings.rate_hz) as usize {
        past.push([ahead_m, left_m]);
        let [seen_ahead_m, seen_left_m] = past[idx.saturating_sub(latency_steps)];
        let mut noise = || rng.sample::<f64, _>(StandardNormal) * settings.noise_px;
        let lights = LightPair {
            separation_px: settings.focal_px * settings.light_distance_m / seen_ahead_m + noise(),
            lateral_px: settings.principal_px - settings.focal_px * seen_left_m / seen_ahead_m
                + noise(),
        };
        let measured = (rng.random::<f64>() >= settings.missed).then_some(lights);
        let command = follower.step(measured, own, step_s);
        own.forward_mps += gain * (command.velocity.forward_mps - own.forward_mps);
        own.left_mps += gain * (command.velocity.left_mps - own.left_mps);
        ahead_m -= own.forward_mps * step_s;
        left_m -= own.left_mps * step_s;
        moments.push(FollowingMoment {
            time_s: idx as f64 * step_s,
            measured,
            smoothed: command.smoothed,
            range_m: ahead_m.hypot(left_m),
        });
    }
    moments
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten pixels are 1.81 m; 0.3 px of noise, smoothed over 0.2 s, are some centimetres.
    #[test]
    fn the_follower_settles_at_ten_pixels() {
        let settings = FollowingSettings::default();
        let follower = FollowerSettings::calibrated(settings.principal_px);
        let moments = follow(&settings, follower, 3);
        let tail = &moments[moments.len() / 2..];
        assert!(
            tail.iter()
                .all(|moment| (moment.range_m - 1.81).abs() < 0.15)
        );
    }
}

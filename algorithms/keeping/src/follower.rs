//! The paper's flight test (section 3.1.2): hold a place behind another vehicle by two
//! proportional controllers on what one camera sees of its lights.

/// Where and how a vehicle follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerSettings {
    /// dist_cmd: the commanded separation of the two lights.
    pub separation_px: f64,
    /// u_cmd: where between left and right the lights shall be.
    pub lateral_px: f64,
    /// Speed per pixel of separation. The loop gain grows as the square of the separation: beyond
    /// 0.3 it overshoots at the delays of small drones.
    pub gain_forward_mps_per_px: f64,
    pub gain_lateral_mps_per_px: f64,
    /// Time constant of the low-pass on both measurements.
    pub smoothing_s: f64,
    /// Without lights for so long, the command is held; then it decays.
    pub hold_s: f64,
    pub decay_s: f64,
    pub speed_mps_max: f64,
    /// Adds the other's estimated speed; without it, a moving vehicle is followed with a lag.
    pub feed_forward: Option<FeedForward>,
}

/// How the speed of the other vehicle is found from the growth of its lights' separation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForward {
    /// Focal length times the distance of the lights: range (m) = this / separation (px).
    pub range_times_separation_m_px: f64,
    /// Focal length: sideways, range × pixels / this are metres.
    pub focal_px: f64,
    /// Time constant of the estimate. Shorter follows faster and passes more noise on.
    pub smoothing_s: f64,
}

impl FollowerSettings {
    /// - `principal_px`: where the optical axis meets the image, from the calibration.
    pub fn calibrated(principal_px: f64) -> Self {
        Self {
            separation_px: 10.0,
            lateral_px: principal_px,
            gain_forward_mps_per_px: 0.1,
            gain_lateral_mps_per_px: 0.005,
            smoothing_s: 0.2,
            hold_s: 0.3,
            decay_s: 0.2,
            speed_mps_max: 0.5,
            feed_forward: None,
        }
    }

    /// With the paper's set-point, the middle of the image: 0.9° beside the optical axis.
    pub fn paper() -> Self {
        Self::calibrated(162.0)
    }
}

/// The lights of the other vehicle in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightPair {
    /// dist_meas.
    pub separation_px: f64,
    /// u_meas: the middle of both lights.
    pub lateral_px: f64,
}

/// How the follower moves itself, in its heading frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlanarVelocity {
    pub forward_mps: f64,
    pub left_mps: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerCommand {
    pub velocity: PlanarVelocity,
    /// What the controllers worked on; `None` before the first sight.
    pub smoothed: Option<LightPair>,
    /// Since the lights were seen.
    pub age_s: f64,
}

#[derive(Clone, Debug)]
pub struct Follower {
    settings: FollowerSettings,
    smoothed: Option<LightPair>,
    age_s: f64,
    held: PlanarVelocity,
    /// Estimated speed of the other vehicle.
    other: PlanarVelocity,
}

/// Separations below this are noise, and their logarithm has no meaning.
const SEPARATION_PX_MIN: f64 = 0.5;

impl Follower {
    pub fn new(settings: FollowerSettings) -> Self {
        Self {
            settings,
            smoothed: None,
            age_s: 0.0,
            held: PlanarVelocity::default(),
            other: PlanarVelocity::default(),
        }
    }

    /// - `own`: the vehicle's velocity now, which the feed-forward needs.
    /// - `step_s`: since the last frame.
    pub fn step(
        &mut self,
        lights: Option<LightPair>,
        own: PlanarVelocity,
        step_s: f64,
    ) -> FollowerCommand {
        self.age_s += step_s;
        let lights = lights.filter(|lights| {
            lights.separation_px >= SEPARATION_PX_MIN && lights.lateral_px.is_finite()
        });
        match lights {
            Some(lights) => self.take(lights, own),
            None => self.coast(step_s),
        }
        FollowerCommand {
            velocity: self.held,
            smoothed: self.smoothed,
            age_s: self.age_s,
        }
    }

    fn take(&mut self, lights: LightPair, own: PlanarVelocity) {
        let settings = self.settings;
        let elapsed_s = std::mem::take(&mut self.age_s);
        let smoothed = match self.smoothed {
            // What comes back after a long time has nothing to do with what was smoothed.
            Some(before) if elapsed_s <= settings.hold_s + settings.decay_s => {
                let gain = 1.0 - (-elapsed_s / settings.smoothing_s).exp();
                let after = LightPair {
                    separation_px: before.separation_px
                        + gain * (lights.separation_px - before.separation_px),
                    lateral_px: before.lateral_px + gain * (lights.lateral_px - before.lateral_px),
                };
                self.estimate_other(before, after, own, elapsed_s);
                after
            }
            _ => lights,
        };
        self.smoothed = Some(smoothed);
        let forward_mps = self.other.forward_mps
            + settings.gain_forward_mps_per_px * (settings.separation_px - smoothed.separation_px);
        let left_mps = self.other.left_mps
            + settings.gain_lateral_mps_per_px * (settings.lateral_px - smoothed.lateral_px);
        self.held = PlanarVelocity {
            forward_mps: forward_mps.clamp(-settings.speed_mps_max, settings.speed_mps_max),
            left_mps: left_mps.clamp(-settings.speed_mps_max, settings.speed_mps_max),
        };
    }

    /// The other's velocity is our own and the change of where it is from us.
    fn estimate_other(
        &mut self,
        before: LightPair,
        after: LightPair,
        own: PlanarVelocity,
        elapsed_s: f64,
    ) {
        let Some(feed_forward) = self.settings.feed_forward else {
            return;
        };
        if elapsed_s <= 0.0 {
            return;
        }
        let place = |lights: LightPair| {
            let ahead_m = feed_forward.range_times_separation_m_px / lights.separation_px;
            let aside_px = self.settings.lateral_px - lights.lateral_px;
            [ahead_m, ahead_m * aside_px / feed_forward.focal_px]
        };
        let [ahead_before_m, left_before_m] = place(before);
        let [ahead_m, left_m] = place(after);
        let gain = 1.0 - (-elapsed_s / feed_forward.smoothing_s).exp();
        let forward_mps = own.forward_mps + (ahead_m - ahead_before_m) / elapsed_s;
        let left_mps = own.left_mps + (left_m - left_before_m) / elapsed_s;
        self.other.forward_mps += gain * (forward_mps - self.other.forward_mps);
        self.other.left_mps += gain * (left_mps - self.other.left_mps);
    }

    fn coast(&mut self, step_s: f64) {
        if self.age_s <= self.settings.hold_s {
            return;
        }
        let keep = (-step_s / self.settings.decay_s).exp();
        self.held.forward_mps *= keep;
        self.held.left_mps *= keep;
        self.other = PlanarVelocity::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FOCAL_PX: f64 = 181.0;
    const RANGE_TIMES_SEPARATION: f64 = FOCAL_PX * 0.1;

    /// Flies a follower behind a leader along a line; gives the ranges of the last half.
    fn ranges(settings: FollowerSettings, leader: impl Fn(f64) -> f64, end_s: f64) -> Vec<f64> {
        let (step_s, lag_s, latency_steps) = (0.05, 0.3, 3);
        let mut follower = Follower::new(settings);
        let (mut position_m, mut speed_mps) = (0.0, 0.0);
        let mut seen = Vec::new();
        let mut ranges = Vec::new();
        let step_count = (end_s / step_s) as usize;
        for idx in 0..step_count {
            let range_m = leader(idx as f64 * step_s) - position_m;
            seen.push(LightPair {
                separation_px: RANGE_TIMES_SEPARATION / range_m,
                lateral_px: settings.lateral_px,
            });
            let late = idx.checked_sub(latency_steps).map(|past| seen[past]);
            let own = PlanarVelocity {
                forward_mps: speed_mps,
                left_mps: 0.0,
            };
            let command = follower.step(late, own, step_s);
            speed_mps += (command.velocity.forward_mps - speed_mps) * step_s / lag_s;
            position_m += speed_mps * step_s;
            if idx >= step_count / 2 {
                ranges.push(range_m);
            }
        }
        ranges
    }

    fn rms_error(ranges: &[f64]) -> f64 {
        let wanted_m = RANGE_TIMES_SEPARATION / 10.0;
        let sum: f64 = ranges.iter().map(|range| (range - wanted_m).powi(2)).sum();
        (sum / ranges.len() as f64).sqrt()
    }

    #[test]
    fn a_hovering_leader_is_approached_to_ten_pixels() {
        let found = ranges(FollowerSettings::calibrated(159.23), |_| 3.0, 20.0);
        assert!(rms_error(&found) < 0.01, "{}", rms_error(&found));
    }

    #[test]
    fn feed_forward_follows_a_moving_leader_closer() {
        let leader = |time_s: f64| 3.0 + 0.2 / 0.6 * (0.6 * time_s).sin();
        let plain = FollowerSettings::calibrated(159.23);
        let helped = FollowerSettings {
            feed_forward: Some(FeedForward {
                range_times_separation_m_px: RANGE_TIMES_SEPARATION,
                focal_px: FOCAL_PX,
                smoothing_s: 0.5,
            }),
            ..plain
        };
        let without_m = rms_error(&ranges(plain, leader, 60.0));
        let with_m = rms_error(&ranges(helped, leader, 60.0));
        assert!(with_m < 0.6 * without_m, "{with_m} against {without_m}");
    }

    #[test]
    fn lost_lights_let_the_command_decay() {
        let mut follower = Follower::new(FollowerSettings::paper());
        let own = PlanarVelocity::default();
        let far = LightPair {
            separation_px: 6.0,
            lateral_px: 100.0,
        };
        let seen = follower.step(Some(far), own, 0.05).velocity;
        assert!((seen.forward_mps - 0.4).abs() < 1e-12 && (seen.left_mps - 0.31).abs() < 1e-12);
        for _ in 0..6 {
            assert_eq!(follower.step(None, own, 0.05).velocity, seen);
        }
        for _ in 0..20 {
            follower.step(None, own, 0.05);
        }
        let lost = follower.step(None, own, 0.05).velocity;
        assert!(lost.forward_mps < 0.01 && lost.left_mps < 0.01, "{lost:?}");
    }
}

//! What a gyroscope and an accelerometer tell beside the camera; nothing here is needed.

use std::collections::VecDeque;

use geometry::Timestamp;
use nalgebra::{Unit, UnitQuaternion, Vector3};

/// One reading of an inertial sensor, in the camera's axes and on the camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    pub captured_at: Timestamp,
    /// The camera's rate of rotation (rad/s).
    pub rate_in_camera: Vector3<f64>,
    /// What an accelerometer feels (m/s²): at rest 9.8, away from the ground.
    pub specific_force_in_camera: Option<Vector3<f64>>,
}

/// Samples remembered, the oldest are forgotten first: some seconds at 1 kHz.
const SAMPLES_MAX: usize = 8192;
/// Over a longer gap between two samples nothing is said.
const GAP_MAX_S: f64 = 0.05;
/// Faster than any gyroscope of a vehicle can turn (rad/s).
const RATE_MAX: f64 = 100.0;
/// The part of each frame's disagreement with the camera that the bias takes on.
const BIAS_GAIN: f64 = 0.02;
/// No gyroscope that is worth listening to is off by more (rad/s).
const BIAS_MAX: f64 = 0.2;
/// Accelerations of the vehicle itself cancel out over this time (s).
const UP_TIME_CONSTANT_S: f64 = 1.0;
/// Specific force beyond this share of what is felt at rest says little about the ground.
const FORCE_RANGE: std::ops::Range<f64> = 0.5 * STANDARD_GRAVITY..1.5 * STANDARD_GRAVITY;
const STANDARD_GRAVITY: f64 = 9.806_65;

/// The newest readings and what was learned from them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Inertia {
    samples: VecDeque<ImuSample>,
    /// What the gyroscope says at rest (rad/s).
    bias: Vector3<f64>,
    up_in_camera: Option<Vector3<f64>>,
    doubt_count: u32,
}

/// So often the camera may be right against the gyroscope before that is not listened to any more:
/// its axes or its unit are not those that were said.
const DOUBTS_MAX: u32 = 3;

impl Inertia {
    /// Takes the next reading; one that is not newer, or that cannot be, changes nothing.
    pub(crate) fn take(&mut self, sample: ImuSample) -> bool {
        let rate_is_sane = sample.rate_in_camera.norm() < RATE_MAX;
        let last = self.samples.back();
        if !rate_is_sane || last.is_some_and(|last| sample.captured_at <= last.captured_at) {
            return false;
        }
        self.follow_up(&sample);
        if self.samples.len() == SAMPLES_MAX {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        true
    }

    /// A complementary filter: up turns with the gyroscope and is drawn to the accelerometer.
    fn follow_up(&mut self, sample: &ImuSample) {
        let last_at = self.samples.back().map(|last| last.captured_at);
        if let (Some(up), Some(last_at)) = (&mut self.up_in_camera, last_at) {
            let turn = (sample.rate_in_camera - self.bias) * (sample.captured_at - last_at);
            *up = UnitQuaternion::from_scaled_axis(-turn) * *up;
        }
        let felt = sample.specific_force_in_camera;
        let Some(force) = felt.filter(|force| FORCE_RANGE.contains(&force.norm())) else {
            return;
        };
        let felt_up = force.normalize();
        self.up_in_camera = Some(match (self.up_in_camera, last_at) {
            (Some(up), Some(last_at)) => {
                let gain = (sample.captured_at - last_at) / UP_TIME_CONSTANT_S;
                (up + (felt_up - up) * gain.min(1.0)).normalize()
            }
            _ => felt_up,
        });
    }

    /// Away from the ground, as of the newest reading.
    pub(crate) fn up_in_camera(&self) -> Option<Unit<Vector3<f64>>> {
        Unit::try_new(self.up_in_camera?, 1e-6)
    }

    /// `later_from_earlier` of the camera's axes, if the readings cover the time between.
    pub(crate) fn turn(&self, earlier: Timestamp, later: Timestamp) -> Option<UnitQuaternion<f64>> {
        if self.doubt_count >= DOUBTS_MAX {
            return None;
        }
        let first = self
            .samples
            .partition_point(|sample| sample.captured_at <= earlier);
        let mut earlier_from_now = UnitQuaternion::identity();
        let mut now = earlier;
        // The reading before the interval holds until the next one.
        let mut rate = match first.checked_sub(1) {
            Some(before) => {
                let sample = &self.samples[before];
                (earlier - sample.captured_at <= GAP_MAX_S).then_some(sample.rate_in_camera)
            }
            None => None,
        };
        for sample in self.samples.range(first..) {
            let next = sample.captured_at.min(later);
            if next - now > GAP_MAX_S {
                return None;
            }
            // The mean of the readings at both ends; at the first only one may be known.
            let mean_rate = rate.map_or(sample.rate_in_camera, |rate| {
                (rate + sample.rate_in_camera) * 0.5
            });
            let turned = (mean_rate - self.bias) * (next - now);
            earlier_from_now *= UnitQuaternion::from_scaled_axis(turned);
            now = next;
            rate = Some(sample.rate_in_camera);
            if now >= later {
                break;
            }
        }
        let rest_s = later - now;
        if rest_s > GAP_MAX_S {
            return None;
        }
        let turned = (rate? - self.bias) * rest_s;
        earlier_from_now *= UnitQuaternion::from_scaled_axis(turned);
        Some(earlier_from_now.inverse())
    }

    /// The camera was right against it.
    pub(crate) fn doubt(&mut self) {
        self.doubt_count += 1;
    }

    /// Compares the readings with how the camera turned between two frames that follow another.
    pub(crate) fn learn(
        &mut self,
        (earlier, later): (Timestamp, Timestamp),
        later_from_earlier: &UnitQuaternion<f64>,
    ) {
        let interval_s = later - earlier;
        let Some(turn) = self.turn(earlier, later).filter(|_| interval_s > 0.0) else {
            return;
        };
        let too_much = later_from_earlier * turn.inverse();
        // In the axes of either frame: between two frames they differ little.
        let rate = too_much.scaled_axis() / interval_s;
        // One frame alone, found by a wrong match, must not turn the rest.
        let gain = BIAS_GAIN * (BIAS_MAX / rate.norm().max(BIAS_MAX));
        self.bias = (self.bias + rate * gain).cap_magnitude(BIAS_MAX);
    }
}

#[cfg(test)]
mod tests;

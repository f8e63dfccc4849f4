//! What a gyroscope and an accelerometer tell beside the camera; nothing here is needed.

mod trial;

use std::collections::VecDeque;

use geometry::Timestamp;
use nalgebra::{Unit, UnitQuaternion, Vector3};

pub use trial::{GyroFault, GyroState};
use trial::{Span, Trial};

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
    /// How the camera turned since the last comparison with the gyroscope.
    seen: Option<Seen>,
    trial: Trial,
}

/// A turn that the pictures showed.
#[derive(Clone, Copy, Debug)]
struct Seen {
    from: Timestamp,
    until: Timestamp,
    until_from_start: UnitQuaternion<f64>,
}

/// Turns are compared over so long at least (s): over less, what keypoints err by hides a gyroscope
/// with other axes in a slow turn.
const SPAN_S: f64 = 0.2;

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

    /// Away from the ground, as of the newest reading. It turned with the gyroscope, and the
    /// accelerometer has the same axes: nothing if that is not listened to.
    pub(crate) fn up_in_camera(&self) -> Option<Unit<Vector3<f64>>> {
        if self.is_refuted() {
            return None;
        }
        Unit::try_new(self.up_in_camera?, 1e-6)
    }

    /// What the pictures say about the gyroscope.
    pub(crate) fn gyro_state(&self) -> GyroState {
        self.trial.state()
    }

    fn is_refuted(&self) -> bool {
        matches!(self.gyro_state(), GyroState::Refuted(_))
    }

    /// `later_from_earlier` of the camera's axes, if the readings cover the time between and the
    /// gyroscope is listened to.
    pub(crate) fn turn(&self, earlier: Timestamp, later: Timestamp) -> Option<UnitQuaternion<f64>> {
        if self.is_refuted() {
            return None;
        }
        let mut earlier_from_now = UnitQuaternion::identity();
        for (rate, seconds) in self.rates(earlier, later)? {
            earlier_from_now *= UnitQuaternion::from_scaled_axis((rate - self.bias) * seconds);
        }
        Some(earlier_from_now.inverse())
    }

    /// Mean rates (rad/s) as they were read and for how long (s), one after the other from the
    /// earlier time to the later, if the readings cover all of it.
    fn rates(&self, earlier: Timestamp, later: Timestamp) -> Option<Vec<(Vector3<f64>, f64)>> {
        let first = self
            .samples
            .partition_point(|sample| sample.captured_at <= earlier);
        let mut rates = Vec::new();
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
            rates.push((mean_rate, next - now));
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
        rates.push((rate?, rest_s));
        Some(rates)
    }

    /// The pictures were right against it for as long as it was followed: from now on it must be
    /// confirmed anew.
    pub(crate) fn doubt(&mut self) {
        self.trial.begin_anew();
    }

    /// Compares the readings with how the camera turned between two frames that follow another.
    ///
    /// - `sigma`: of a keypoint, on the plane at depth one.
    pub(crate) fn learn(
        &mut self,
        (earlier, later): (Timestamp, Timestamp),
        later_from_earlier: &UnitQuaternion<f64>,
        sigma: f64,
    ) {
        let interval_s = later - earlier;
        let Some(turn) = self.turn(earlier, later).filter(|_| interval_s > 0.0) else {
            self.seen = None;
            return;
        };
        let too_much = later_from_earlier * turn.inverse();
        // In the axes of either frame: between two frames they differ little.
        let rate = too_much.scaled_axis() / interval_s;
        // One frame alone, found by a wrong match, must not turn the rest.
        let gain = BIAS_GAIN * (BIAS_MAX / rate.norm().max(BIAS_MAX));
        self.bias = (self.bias + rate * gain).cap_magnitude(BIAS_MAX);
        self.compare((earlier, later), later_from_earlier, sigma);
    }

    /// Adds to the turn that the pictures show, and puts it to the trial when it is long enough.
    fn compare(
        &mut self,
        (earlier, later): (Timestamp, Timestamp),
        later_from_earlier: &UnitQuaternion<f64>,
        sigma: f64,
    ) {
        let before = self.seen.filter(|seen| seen.until == earlier);
        let seen = Seen {
            from: before.map_or(earlier, |seen| seen.from),
            until: later,
            until_from_start: before.map_or(*later_from_earlier, |seen| {
                later_from_earlier * seen.until_from_start
            }),
        };
        let seconds = seen.until - seen.from;
        if seconds < SPAN_S {
            self.seen = Some(seen);
            return;
        }
        self.seen = None;
        let Some(rates) = self.rates(seen.from, seen.until) else {
            return;
        };
        let told = rates.iter().map(|(rate, seconds)| rate * *seconds);
        self.trial.judge(
            Span {
                seconds,
                // What stands still turns the other way.
                seen: -seen.until_from_start.scaled_axis(),
                told: told.sum(),
            },
            sigma,
        );
    }
}

/// The median of vectors, axis by axis; there is at least one.
pub(crate) fn median(vectors: &[Vector3<f64>]) -> Vector3<f64> {
    let along = |axis: usize| {
        let mut values: Vec<f64> = vectors.iter().map(|one| one[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    Vector3::new(along(0), along(1), along(2))
}

#[cfg(test)]
mod tests;

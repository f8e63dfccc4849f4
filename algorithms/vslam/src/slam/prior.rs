//! Inertial readings and the direction of gravity: priors for who has them.

use std::collections::BTreeMap;

use nalgebra::{Unit, Vector3};

use super::Vslam;
use crate::inertia::median;
use crate::{GyroState, ImuSample, KeyframeId, VslamMap};

/// Where away from the ground is, as each keyframe was told.
#[derive(Clone, Debug, Default)]
pub(super) struct Ups {
    up_in_camera: BTreeMap<KeyframeId, Unit<Vector3<f64>>>,
    /// For the next frame, from somebody who knows.
    told: Option<Unit<Vector3<f64>>>,
    /// At the newest frame.
    newest: Option<Unit<Vector3<f64>>>,
}

/// Keyframes of which it is remembered; the oldest are forgotten first.
const UPS_MAX: usize = 4096;

/// Keyframes that must agree on where up is.
const UPS_MIN: usize = 3;

impl Ups {
    pub(super) fn begin_frame(&mut self, felt: Option<Unit<Vector3<f64>>>) {
        self.newest = self.told.take().or(felt);
    }

    /// The newest frame became this keyframe.
    pub(super) fn note(&mut self, keyframe: KeyframeId) {
        self.up_in_camera
            .extend(self.newest.map(|up| (keyframe, up)));
        if self.up_in_camera.len() > UPS_MAX {
            self.up_in_camera.pop_first();
        }
    }

    /// The median of what the map's keyframes say, axis by axis.
    fn in_map(&self, map: &VslamMap) -> Option<Unit<Vector3<f64>>> {
        let ups: Vec<Vector3<f64>> = self
            .up_in_camera
            .iter()
            .filter_map(|(id, up)| {
                let map_from_camera = map.keyframe(*id)?.map_from_camera();
                Some(map_from_camera.rotation() * up.into_inner())
            })
            .collect();
        if ups.len() < UPS_MIN {
            return None;
        }
        Unit::try_new(median(&ups), 0.5)
    }
}

impl Vslam {
    /// Takes a reading of an inertial sensor that moves with the camera; those up to a frame's
    /// stamp come before the frame. Without any, the camera does alone.
    ///
    /// The gyroscope tells how the camera turned since the last frame, in place of its velocity,
    /// and what it says at rest is learned on the way. Whether it is right is for the pictures to
    /// say: see [`Self::gyro_state`]. An accelerometer tells where up is: see [`Self::up_in_map`].
    /// Returns whether the reading was taken: it must be finite and newer than the last.
    pub fn take_imu(&mut self, sample: ImuSample) -> bool {
        self.inertia.take(sample)
    }

    /// Whether the turns that the gyroscope tells are those that the pictures show.
    pub fn gyro_state(&self) -> GyroState {
        self.inertia.gyro_state()
    }

    /// Says where away from the ground is at the next frame, better than its readings do.
    pub fn tell_up(&mut self, up_in_camera: Unit<Vector3<f64>>) {
        self.ups.told = Some(up_in_camera);
    }

    /// Away from the ground, in the frame of [`Self::map`], if at least some keyframes were told,
    /// and the pictures did not refute the gyroscope: then what anybody told is in doubt with it.
    pub fn up_in_map(&self) -> Option<Unit<Vector3<f64>>> {
        match self.gyro_state() {
            GyroState::Refuted(_) => None,
            GyroState::Untested | GyroState::Confirmed => self.ups.in_map(&self.map),
        }
    }
}

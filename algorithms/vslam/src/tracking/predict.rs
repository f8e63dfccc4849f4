//! Where the camera should be now.

use geometry::{Camera, Map, Timestamp, Transform};

use super::TrackedFrame;
use crate::VslamMap;

/// Velocity is carried on for at most this many frame intervals.
const EXTRAPOLATION_MAX: f64 = 4.0;

/// The last tracked frame and how the camera moved there.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) last: TrackedFrame,
    velocity: Option<Velocity>,
    /// Frames without a pose since.
    pub(crate) missed_count: u32,
}

#[derive(Clone, Copy, Debug)]
struct Velocity {
    later_from_earlier: Transform<Camera, Camera>,
    interval_s: f64,
}

impl Motion {
    /// A camera of which nothing but one frame is known.
    pub(crate) fn starting_at(last: TrackedFrame) -> Self {
        Self {
            last,
            velocity: None,
            missed_count: 0,
        }
    }

    /// Takes the next tracked frame.
    pub(crate) fn advance(&mut self, map: &VslamMap, next: TrackedFrame) {
        let pose = |frame: &TrackedFrame| map.pose(&frame.place);
        let interval_s = next.captured_at - self.last.captured_at;
        self.velocity = pose(&self.last)
            .zip(pose(&next))
            // After a gap the mean velocity says little about the last one.
            .filter(|_| interval_s > 0.0 && self.missed_count == 0)
            .map(|(earlier, later)| Velocity {
                later_from_earlier: later * earlier.inverse(),
                interval_s,
            });
        self.last = next;
        self.missed_count = 0;
    }

    /// Follows a correction of the map that made lengths around the camera grow by this factor.
    pub(crate) fn stretch(&mut self, factor: f64) {
        if let Some(velocity) = &mut self.velocity {
            let motion = &velocity.later_from_earlier;
            let way = motion.translation() * factor;
            velocity.later_from_earlier = Transform::new(*motion.rotation(), way);
        }
    }

    /// The pose of the last frame, corrected with the map since.
    pub(crate) fn last_pose(&self, map: &VslamMap) -> Option<Transform<Camera, Map>> {
        map.pose(&self.last.place)
    }

    /// The pose at this time, if the camera went on as it did.
    pub(crate) fn predict(&self, map: &VslamMap, at: Timestamp) -> Option<Transform<Camera, Map>> {
        let last = self.last_pose(map)?;
        let Some(velocity) = self.velocity else {
            return Some(last);
        };
        let intervals = (at - self.last.captured_at) / velocity.interval_s;
        let tangent = velocity.later_from_earlier.log() * intervals.clamp(0.0, EXTRAPOLATION_MAX);
        Some(Transform::<Camera, Camera>::exp(&tangent) * last)
    }
}

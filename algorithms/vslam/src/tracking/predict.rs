//! Where the camera should be now.

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::UnitQuaternion;

use super::{TrackedFrame, Whereabouts};
use crate::VslamMap;
use crate::held::PLACED_MIN;
use crate::map::Place;

/// Velocity is carried on for at most this many frame intervals.
const EXTRAPOLATION_MAX: f64 = 4.0;

/// A gyroscope and the camera agree on a turn of some frames within this.
const TURN_ERROR_RAD_MAX: f64 = 0.1;
/// A camera that only turns may go on for so long; what it does beside is not known.
const UNPLACED_MAX_S: f64 = 1.0;

/// The last tracked frame and how the camera moved there.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) last: TrackedFrame,
    velocity: Option<Velocity>,
    /// How the camera's axes turned since the last frame (`now_from_last`), if a gyroscope tells.
    pub(crate) turn: Option<UnitQuaternion<f64>>,
    /// Frames without a pose since.
    pub(crate) missed_count: u32,
    /// When points of known range last told where the camera was.
    placed_at: Timestamp,
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
            placed_at: last.captured_at,
            last,
            velocity: None,
            turn: None,
            missed_count: 0,
        }
    }

    /// Whether the camera cannot have turned like this, as the gyroscope tells it: a place that
    /// looks like another.
    pub(crate) fn contradicts(
        &self,
        map: &VslamMap,
        camera_from_map: &Transform<Camera, Map>,
    ) -> bool {
        let Some((turn, last)) = self.turn.zip(self.last_pose(map)) else {
            return false;
        };
        let seen = *(*camera_from_map * last.inverse()).rotation();
        turn.angle_to(&seen) > TURN_ERROR_RAD_MAX
    }

    /// How the camera's axes turned from the last frame to this place; `None` after a gap.
    pub(crate) fn turn_to(&self, map: &VslamMap, next: &Place) -> Option<UnitQuaternion<f64>> {
        let later = map.pose(next).filter(|_| self.missed_count == 0)?;
        Some(*(later * self.last_pose(map)?.inverse()).rotation())
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
        let points = next.points.iter().filter_map(|point| map.point(point.id));
        if points.filter(|point| point.has_range()).count() >= PLACED_MIN {
            self.placed_at = next.captured_at;
        }
        self.last = next;
        self.turn = None;
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

    /// Whether it is too long ago that a place was measured, for one that is only expected.
    pub(crate) fn is_adrift(&self, at: Timestamp) -> bool {
        at - self.placed_at > UNPLACED_MAX_S
    }

    /// Where the camera was last, and should be now.
    pub(crate) fn whereabouts(&self, map: &VslamMap, at: Timestamp) -> Option<Whereabouts> {
        let centre = |pose: Transform<Camera, Map>| *pose.inverse().translation();
        Some(Whereabouts {
            last_in_map: centre(self.last_pose(map)?),
            expected_in_map: centre(self.predict(map, at)?),
            keyframe: map.holder(self.last.place.keyframe)?,
        })
    }

    /// The pose at this time, if the camera went on as it did.
    pub(crate) fn predict(&self, map: &VslamMap, at: Timestamp) -> Option<Transform<Camera, Map>> {
        let moved = self.moved(at);
        let moved = match self.turn {
            // The path of the camera stays, its axes are those that the gyroscope tells.
            Some(turn) => Transform::new(turn, turn * -*moved.inverse().translation()),
            None => moved,
        };
        Some(moved * self.last_pose(map)?)
    }

    fn moved(&self, at: Timestamp) -> Transform<Camera, Camera> {
        let Some(velocity) = self.velocity else {
            return Transform::identity();
        };
        let intervals = (at - self.last.captured_at) / velocity.interval_s;
        let tangent = velocity.later_from_earlier.log() * intervals.clamp(0.0, EXTRAPOLATION_MAX);
        Transform::exp(&tangent)
    }
}

//! Where the camera should be now.

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::UnitQuaternion;

use super::refine::STEP_KEPT;
use super::{TrackedFrame, Whereabouts};
use crate::VslamMap;
use crate::held::{are_placing, misfit};
use crate::map::Place;

/// Velocity is carried on for at most this many frame intervals.
const EXTRAPOLATION_MAX: f64 = 4.0;

/// A gyroscope and the camera agree on a turn of some frames within this.
const TURN_ERROR_RAD_MAX: f64 = 0.1;
/// How much of a frame's misfit enters into what is usual.
const MISFIT_LEARNED: f64 = 0.1;
/// A doubtful pose of which the points miss by so much more than usual was found by chance.
const MISFIT_RATIO_MAX: f64 = 1.8;
/// A camera that only turns may go on for so long; what it does beside is not known.
const UNPLACED_MAX_S: f64 = 1.0;

/// The last tracked frame and how the camera moved there.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) last: TrackedFrame,
    velocity: Option<Velocity>,
    /// How the camera's axes turned since the last frame (`now_from_last`), if a gyroscope tells
    /// that the pictures confirmed.
    pub(crate) turn: Option<UnitQuaternion<f64>>,
    /// The same of one that they did not confirm: to be tried, and nothing else.
    pub(crate) hinted_turn: Option<UnitQuaternion<f64>>,
    /// Frames without a pose since.
    pub(crate) missed_count: u32,
    /// When points of known range last told where the camera was.
    placed_at: Timestamp,
    /// How fast it may still be since, per second.
    speed_max: f64,
    /// By how much points miss keypoints, usually.
    usual_misfit: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Velocity {
    later_from_earlier: Transform<Camera, Camera>,
    interval_s: f64,
}

impl Velocity {
    fn speed(&self) -> f64 {
        self.later_from_earlier.translation().norm() / self.interval_s
    }
}

impl Motion {
    /// A camera of which nothing but one frame is known.
    pub(crate) fn starting_at(last: TrackedFrame) -> Self {
        Self {
            placed_at: last.captured_at,
            last,
            velocity: None,
            turn: None,
            hinted_turn: None,
            missed_count: 0,
            speed_max: 0.0,
            usual_misfit: None,
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
        let pose = pose(&next);
        let misfit = pose.and_then(|pose| misfit(map, &pose, &next.observations));
        if let Some(misfit) = misfit {
            let usual = self.usual_misfit.get_or_insert(misfit);
            *usual += MISFIT_LEARNED * (misfit - *usual);
        }
        if pose.is_some_and(|pose| are_placing(map, &pose, &next.observations)) {
            self.placed_at = next.captured_at;
            self.speed_max = self.velocity.map_or(0.0, |velocity| velocity.speed());
        } else {
            self.speed_max *= STEP_KEPT;
        }
        self.last = next;
        self.turn = None;
        self.hinted_turn = None;
        self.missed_count = 0;
    }

    /// Follows a correction of the map that made lengths around the camera grow by this factor.
    pub(crate) fn stretch(&mut self, factor: f64) {
        if let Some(velocity) = &mut self.velocity {
            let motion = &velocity.later_from_earlier;
            let way = motion.translation() * factor;
            velocity.later_from_earlier = Transform::new(*motion.rotation(), way);
        }
        self.speed_max *= factor;
    }

    /// The pose of the last frame, corrected with the map since.
    pub(crate) fn last_pose(&self, map: &VslamMap) -> Option<Transform<Camera, Map>> {
        map.pose(&self.last.place)
    }

    /// Whether the points of a doubtful pose miss its keypoints by far more than they usually do,
    /// and no gyroscope says where they must be: in a smeared image of a fast turn they do miss.
    pub(crate) fn is_chance(&self, doubtful_misfit: Option<f64>) -> bool {
        let pair = doubtful_misfit.zip(self.usual_misfit);
        let pair = pair.filter(|_| self.turn.is_none());
        pair.is_some_and(|(misfit, usual)| misfit > MISFIT_RATIO_MAX * usual)
    }

    /// Whether it is too long ago that a place was measured, for one that is only expected.
    pub(crate) fn is_adrift(&self, at: Timestamp) -> bool {
        at - self.placed_at > UNPLACED_MAX_S
    }

    /// Whether a pose by so many keypoints is as good as can be hoped for where none tells where
    /// the camera is: that was so at the last frame, and much of what it showed is still there.
    pub(crate) fn expects_no_more_than(&self, inlier_count: usize) -> bool {
        let shown = self.last.observations.iter();
        let shown_count = shown.filter(|one| one.point.is_some()).count();
        self.placed_at < self.last.captured_at && 2 * inlier_count >= shown_count
    }

    /// Where the camera was last, and should be now.
    pub(crate) fn whereabouts(&self, map: &VslamMap, at: Timestamp) -> Option<Whereabouts> {
        let centre = |pose: Transform<Camera, Map>| *pose.inverse().translation();
        let last_in_map = centre(self.last_pose(map)?);
        let step = centre(self.predict(map, at)?) - last_in_map;
        let step_max = self.speed_max * (at - self.last.captured_at);
        Some(Whereabouts {
            last_in_map,
            expected_in_map: last_in_map + step.cap_magnitude(step_max),
            keyframe: map.holder(self.last.place.keyframe)?,
        })
    }

    /// The pose at this time, if the camera went on as it did.
    pub(crate) fn predict(&self, map: &VslamMap, at: Timestamp) -> Option<Transform<Camera, Map>> {
        self.predict_turned(map, at, self.turn)
    }

    /// The same for a camera that turned like this since the last frame, if that is known.
    pub(crate) fn predict_turned(
        &self,
        map: &VslamMap,
        at: Timestamp,
        turn: Option<UnitQuaternion<f64>>,
    ) -> Option<Transform<Camera, Map>> {
        let moved = self.moved(at);
        let moved = match turn {
            // The path of the camera stays, its axes are those that the turn tells.
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

#[cfg(test)]
mod tests;

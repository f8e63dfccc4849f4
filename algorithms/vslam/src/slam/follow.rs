//! Frames while there is a map: tracked, found again, or lost.

use geometry::Timestamp;

use super::grow_map::Unmapped;
use super::{Backfill, Mode, Outcome, Vslam};
use crate::frame::Frame;
use crate::inertia::GyroState;
use crate::mapping::Settling;
use crate::start::Starter;
use crate::tracking::{KeyframeClock, Motion, Tracked, TrackedFrame, track};
use crate::{LostReason, MapId, TrackingState, VslamMap};

/// After so many frames without a pose the last motion says nothing any more.
const COASTED_MAX: u32 = 3;
/// With a gyroscope the camera's axes are still known.
const COASTED_WITH_GYRO_MAX: u32 = 15;
/// A map with fewer keyframes is given up soon when it is lost, and not kept.
const SMALL_MAP_KEYFRAMES: usize = 6;
/// How long a small map is looked for, frames.
const SMALL_MAP_PATIENCE: u32 = 10;
/// How long a map is looked for before a new one is begun beside it, seconds.
pub(super) const PATIENCE_S: f64 = 2.5;
/// Maps that are kept beside the one that is followed.
const EARLIER_MAX: usize = 4;
/// Every so many frames the camera is looked for in an earlier map, while there is no map.
const STARTING_INTERVAL_FRAMES: u64 = 2;
/// The same while a younger map is followed.
const FOLLOWING_INTERVAL_FRAMES: u64 = 5;
/// How often the camera is seen in an earlier map before the younger one is left for it.
const JOIN_PATIENCE: u32 = 6;

impl Vslam {
    pub(super) fn follow(&mut self, mut frame: Frame) -> Outcome {
        if let Some(tracked) = self.return_to_earlier(&mut frame) {
            return self.accept(frame, tracked);
        }
        let Mode::Following { motion, .. } = &mut self.mode else {
            unreachable!("called only while following");
        };
        let turn = self
            .inertia
            .turn(motion.last.captured_at, frame.captured_at);
        let is_confirmed = self.inertia.gyro_state() == GyroState::Confirmed;
        motion.turn = turn.filter(|_| is_confirmed);
        motion.hinted_turn = turn.filter(|_| !is_confirmed);
        let coasted_max = match motion.turn {
            Some(_) => COASTED_WITH_GYRO_MAX,
            None => COASTED_MAX,
        };
        let mut result = Err(LostReason::UnknownPlace);
        if motion.missed_count <= coasted_max {
            result = track(
                &self.optics,
                &mut self.map,
                motion,
                &mut frame,
                &mut self.rng,
            );
        }
        let result = result.or_else(|reason| {
            frame.forget_points();
            self.relocaliser
                .locate(
                    (&self.optics, &self.places),
                    &mut self.map,
                    &mut frame,
                    &mut self.rng,
                )
                .ok_or(reason)
        });
        let result = result.and_then(|tracked| self.check_turn(tracked, frame.captured_at));
        match result {
            Ok(tracked) => self.accept(frame, tracked),
            Err(reason) => {
                self.waiting.remember(&frame);
                self.miss(&frame, reason)
            }
        }
    }

    /// Refuses a pose that the gyroscope contradicts, for a while; then it is the gyroscope that
    /// is doubted, before the map is given up for its sake.
    fn check_turn(&mut self, tracked: Tracked, at: Timestamp) -> Result<Tracked, LostReason> {
        let Mode::Following { motion, .. } = &self.mode else {
            return Ok(tracked);
        };
        if !motion.contradicts(&self.map, &tracked.camera_from_map) {
            return Ok(tracked);
        }
        let refusals_max = if self.map.keyframe_count() < SMALL_MAP_KEYFRAMES {
            SMALL_MAP_PATIENCE / 2
        } else {
            COASTED_WITH_GYRO_MAX
        };
        let lost_s = at - motion.last.captured_at;
        if motion.missed_count <= refusals_max && lost_s <= 0.5 * PATIENCE_S {
            return Err(LostReason::AgainstGyroscope);
        }
        self.inertia.doubt();
        Ok(tracked)
    }

    /// Takes a pose that was found; what it means for the map waits until the pose is out.
    pub(super) fn accept(&mut self, frame: Frame, mut tracked: Tracked) -> Outcome {
        let rank = self.map.rank();
        let largest = self.earlier.iter().map(VslamMap::rank).max();
        let in_doubt = self.mapper.settling().is_in_doubt(frame.captured_at);
        let reason = if tracked.is_placed {
            LostReason::MapUnsettled
        } else {
            LostReason::OnlyDirections
        };
        tracked.is_placed &= !in_doubt;
        let placed = tracked.is_placed;
        if !placed || largest.is_some_and(|largest| largest > rank) {
            // The map may never be joined to the largest; the frame may still be found there. And
            // what was not measured now may be when the map has grown.
            self.waiting.remember(&frame);
        }
        self.unmapped = Some(Unmapped::Tracked(Box::new((frame, tracked.clone()))));
        if !placed {
            return Outcome::without_pose(TrackingState::Lost { reason });
        }
        Outcome {
            state: TrackingState::Tracking,
            tracked: Some(tracked),
        }
    }

    fn miss(&mut self, frame: &Frame, reason: LostReason) -> Outcome {
        let Mode::Following { motion, .. } = &mut self.mode else {
            unreachable!("called only while following");
        };
        motion.missed_count += 1;
        let lost_s = frame.captured_at - motion.last.captured_at;
        let small = self.map.keyframe_count() < SMALL_MAP_KEYFRAMES;
        // An image in which nothing can be seen is no new place.
        let unseen = self.look.fault(&self.usual_look).is_some();
        let missed = small && motion.missed_count >= SMALL_MAP_PATIENCE && !unseen;
        let give_up = missed || lost_s > PATIENCE_S;
        if give_up {
            self.restart();
        }
        Outcome::without_pose(TrackingState::Lost { reason })
    }

    /// Gives up a map that had a wrong start, and does not keep it unless there is more to it.
    pub(super) fn give_up_hopeless(&mut self) {
        let following = matches!(self.mode, Mode::Following { .. });
        if following && self.mapper.settling().is_hopeless() {
            let old = self.begin_anew();
            if old.rank() > (false, Settling::HOPELESS_KEYFRAMES_MAX) {
                self.leave(old);
            } else {
                self.hand_on_backfill();
            }
        }
    }

    /// Begins a new map; the old one is kept unless it is small.
    pub(super) fn restart(&mut self) {
        let old = self.begin_anew();
        self.leave(old);
    }

    /// Begins a new map and hands out the old one.
    fn begin_anew(&mut self) -> VslamMap {
        let successor = self.map.successor(MapId(self.map_count));
        self.map_count += 1;
        self.mode = Mode::Starting(Starter::default());
        std::mem::replace(&mut self.map, successor)
    }

    /// Follows the camera from a frame of which nothing but the pose is known.
    pub(super) fn follow_from(&mut self, start: TrackedFrame) {
        self.mode = Mode::Following {
            clock: KeyframeClock {
                last_keyframe_at: start.captured_at,
            },
            motion: Motion::starting_at(start),
        };
    }

    /// Frames from before the map that was left may be found in another.
    fn hand_on_backfill(&mut self) {
        self.seen_earlier_count = 0;
        for frame in self.backfill.take_frames() {
            self.waiting.remember(&frame);
        }
        self.backfill = Backfill::default();
    }

    /// Keeps a map that was left, so that the camera may come back to it; of too many the smallest
    /// is dropped.
    pub(super) fn leave(&mut self, left: VslamMap) {
        self.hand_on_backfill();
        if left.rank() < (false, SMALL_MAP_KEYFRAMES) {
            return;
        }
        self.earlier.push(left);
        if self.earlier.len() > EARLIER_MAX {
            let ranks = self.earlier.iter().map(VslamMap::rank).enumerate();
            let smallest = ranks.min_by_key(|(_, rank)| *rank);
            self.earlier.remove(smallest.map_or(0, |(idx, _)| idx));
        }
    }

    /// Looks now and then whether the camera is back in a map that it lost. A younger map that is
    /// being followed should be joined to it; only if that fails again and again it is left.
    pub(super) fn return_to_earlier(&mut self, frame: &mut Frame) -> Option<Tracked> {
        let starting = matches!(self.mode, Mode::Starting(_));
        let interval = if starting {
            STARTING_INTERVAL_FRAMES
        } else {
            FOLLOWING_INTERVAL_FRAMES
        };
        if self.earlier.is_empty() || !frame.frame_idx.is_multiple_of(interval) {
            return None;
        }
        let idx = (frame.frame_idx / interval) as usize % self.earlier.len();
        let earlier = &mut self.earlier[idx];
        if earlier.rank() <= self.map.rank() {
            return None;
        }
        let index = (&self.optics, &self.places);
        let found = self
            .relocaliser
            .locate(index, earlier, frame, &mut self.rng);
        self.seen_earlier_count += u32::from(found.is_some());
        let join_awaited = !starting && self.seen_earlier_count < JOIN_PATIENCE;
        let Some(tracked) = found.filter(|_| !join_awaited) else {
            frame.forget_points();
            return None;
        };
        let place = earlier.place(tracked.reference, &tracked.camera_from_map)?;
        earlier.reserve_ids_before(&self.map);
        let earlier = self.earlier.remove(idx);
        let left = std::mem::replace(&mut self.map, earlier);
        self.leave(left);
        self.mapper.resume();
        self.follow_from(TrackedFrame {
            captured_at: frame.captured_at,
            place,
            observations: frame.observations.clone(),
        });
        Some(tracked)
    }
}

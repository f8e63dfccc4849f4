//! What a tracked frame does to the map, once its pose is out.

use super::backfill::Missed;
use super::revisit::Revisit;
use super::waiting::Search;
use super::{Mode, Vslam};
use crate::frame::Frame;
use crate::mapping::Insertion;
use crate::tracking::{Tracked, TrackedFrame, wants_keyframe};
use crate::{KeyframeId, MappingReport, VslamMap};

/// What the newest frame leaves to do when its pose is known.
#[derive(Debug)]
pub(super) enum Unmapped {
    /// The map began with it; it is a keyframe already.
    Started(KeyframeId),
    Tracked(Box<(Frame, Tracked)>),
}

impl Vslam {
    /// Does what the newest frame leaves to do for the map: to insert it as a keyframe with new
    /// points and a local adjustment, or to find one of the frames from before the map was born.
    ///
    /// Call it when the pose of [`Vslam::track`] is out. `track` makes up for a call that was left
    /// out, and then nobody learns what mapping came to.
    pub fn map_frame(&mut self) -> MappingReport {
        let done = match self.unmapped.take() {
            None => None,
            Some(Unmapped::Started(keyframe)) => Some(Insertion {
                keyframe,
                settled: Vec::new(),
            }),
            Some(Unmapped::Tracked(newest)) => self.absorb(*newest),
        };
        let keyframe = done
            .as_ref()
            .and_then(|one| self.map.keyframe(one.keyframe));
        MappingReport {
            map_id: self.map.id(),
            map_revision: self.map.revision(),
            new_keyframe: keyframe.map(crate::Keyframe::id),
            map_from_keyframe: keyframe.map(crate::Keyframe::map_from_camera),
            settled: done.map_or_else(Vec::new, |one| one.settled),
        }
    }

    fn absorb(&mut self, (frame, mut tracked): (Frame, Tracked)) -> Option<Insertion> {
        let Mode::Following { motion, clock } = &mut self.mode else {
            unreachable!("a frame is tracked in a map");
        };
        let captured_at = frame.captured_at;
        let frame_idx = frame.frame_idx as usize;
        let mut insertion = None;
        let observations;
        if wants_keyframe((&self.optics, &self.map), clock, &frame, &tracked) {
            let pose = (tracked.camera_from_map, tracked.reference);
            let inserted = self.mapper.insert(&self.optics, &mut self.map, frame, pose);
            let revisit = Revisit {
                optics: &self.optics,
                places: &mut self.places,
                loops: &mut self.loops,
                earlier: &mut self.earlier,
                trajectory: &mut self.trajectory,
            };
            let keyframe_count = self.map.keyframe_count();
            let stretch = revisit.by(inserted.keyframe, &mut self.map, &mut self.rng);
            if self.map.keyframe_count() > keyframe_count {
                // It was joined to another: what it was alone no longer counts.
                self.mapper.settle_anew();
            }
            motion.stretch(stretch);
            let keyframe = self
                .map
                .keyframe(inserted.keyframe)
                .expect("the newest keyframe is never culled");
            observations = keyframe.observations.clone();
            tracked.camera_from_map = *keyframe.camera_from_map();
            tracked.reference = inserted.keyframe;
            clock.last_keyframe_at = captured_at;
            self.ups.note(inserted.keyframe);
            insertion = Some(inserted);
        } else {
            observations = frame.observations;
        }
        let place = self
            .map
            .place(tracked.reference, &tracked.camera_from_map)
            .expect("the reference is in the map");
        let record = self.trajectory.get_mut(frame_idx);
        if let Some(record) = record.filter(|_| tracked.is_placed) {
            record.place = Some(place);
        }
        if let Some(turn) = motion.turn_to(&self.map, &place) {
            let interval = (motion.last.captured_at, captured_at);
            self.inertia
                .learn(interval, &turn, self.optics.keypoint_sigma());
        }
        motion.advance(
            &self.map,
            TrackedFrame {
                captured_at,
                place,
                observations,
            },
        );
        if insertion.is_none() {
            self.look_back();
        }
        insertion
    }

    /// Does what can wait: the adjustment of the whole map, or one of the frames without a pose.
    fn look_back(&mut self) {
        if self.loops.adjust_further(&mut self.map) {
            return;
        }
        let mut search = Search {
            optics: &self.optics,
            places: &self.places,
            relocaliser: &mut self.relocaliser,
            rng: &mut self.rng,
        };
        let (map, trajectory) = (&mut self.map, &mut self.trajectory);
        let is_smaller = |earlier: &VslamMap| earlier.rank() > map.rank();
        if !self.backfill.is_empty() {
            let missed = self
                .backfill
                .step((search.optics, map), trajectory, search.rng);
            match missed {
                Some(Missed::Lost(frame)) => self.waiting.remember(&frame),
                Some(Missed::Unsure(frame)) => self.waiting.remember_for_end(&frame),
                None => {}
            }
        } else if !self.earlier.iter().any(is_smaller) {
            self.waiting.step(&mut search, map, trajectory);
        }
    }
}

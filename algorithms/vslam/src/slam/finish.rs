//! The end of a recording: what later frames say about earlier ones.

use super::waiting::Search;
use super::{Mode, Vslam};
use crate::loops::find_in;
use crate::tracking::{KeyframeClock, Motion, TrackedFrame};
use crate::{Keyframe, KeyframeId, VslamMap};

/// Keyframes of a smaller map that are asked whether they show the largest one.
const ASKED_MAX: usize = 60;

impl Vslam {
    /// Does what is left when no frame follows: joins the maps that show the same places after
    /// all, adjusts the largest as a whole, and looks in it for the frames without a pose.
    ///
    /// The machine may go on afterwards, in that map.
    pub fn finish(&mut self) {
        self.map_frame();
        self.follow_largest();
        self.join_all();
        self.loops.adjust_all(&mut self.map);
        let mut waiting = std::mem::take(&mut self.waiting);
        for frame in self.backfill.take_frames() {
            waiting.remember(&frame);
        }
        let mut search = Search {
            optics: &self.optics,
            places: &self.places,
            relocaliser: &mut self.relocaliser,
            rng: &mut self.rng,
        };
        waiting.finish(&mut search, &mut self.map, &mut self.trajectory);
    }

    /// Makes the largest map the one that is followed; where the camera is in it is not known.
    fn follow_largest(&mut self) {
        let ranks = self.earlier.iter().map(VslamMap::rank);
        let largest = (0..).zip(ranks).max_by_key(|(_, rank)| *rank);
        let Some((idx, _)) = largest.filter(|(_, rank)| *rank > self.map.rank()) else {
            return;
        };
        let mut largest = self.earlier.remove(idx);
        largest.reserve_ids_before(&self.map);
        let left = std::mem::replace(&mut self.map, largest);
        self.leave(left);
        self.mapper.resume();
        let newest = self.map.keyframes().next_back().and_then(|keyframe| {
            Some(TrackedFrame {
                captured_at: keyframe.captured_at,
                place: self.map.place(keyframe.id, &keyframe.camera_from_map)?,
                observations: Vec::new(),
            })
        });
        if let Some(newest) = newest {
            let clock = KeyframeClock {
                last_keyframe_at: newest.captured_at,
            };
            let motion = Motion::starting_at(newest);
            self.mode = Mode::Following { motion, clock };
        }
    }

    fn join_all(&mut self) {
        for other in std::mem::take(&mut self.earlier) {
            let ids: Vec<KeyframeId> = other.keyframes().map(Keyframe::id).collect();
            let stride = ids.len().div_ceil(ASKED_MAX).max(1);
            let index = (&self.optics, &self.places);
            let found = ids
                .iter()
                .step_by(stride)
                .find_map(|id| find_in(index, &self.map, (&other, *id), &mut self.rng));
            let Some(found) = found else {
                self.earlier.push(other);
                continue;
            };
            let largest = std::mem::replace(&mut self.map, other);
            let joined = self
                .loops
                .join(&self.optics, &mut self.map, largest, &found);
            for record in &mut self.trajectory {
                record.follow(&joined);
            }
        }
    }
}

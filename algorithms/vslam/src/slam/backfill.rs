//! Finds the frames from before the map was born in the map, one with each later frame.

use std::collections::VecDeque;

use rand_chacha::ChaCha8Rng;

use super::sureness::is_sure;
use crate::VslamMap;
use crate::frame::Frame;
use crate::optics::Optics;
use crate::tracking::{Motion, TrackedFrame, track};
use crate::trajectory::FrameRecord;

/// Frames remembered; the oldest give their place to new ones.
const FRAMES_MAX: usize = 120;

/// Frames that wait to be localised from their own image.
#[derive(Debug, Default)]
pub(super) struct Backfill {
    frames: VecDeque<Frame>,
    /// The last frame that was found; the next one to find came just before it.
    later: Option<TrackedFrame>,
}

/// A frame without a place.
#[derive(Debug)]
pub(super) enum Missed {
    Lost(Frame),
    /// It leads to the one before it all the same.
    Unsure(Frame),
}

impl Backfill {
    /// Remembers a frame; returns the one that gives its place to it.
    pub(super) fn remember(&mut self, frame: &Frame) -> Option<Frame> {
        let full = self.frames.len() == FRAMES_MAX;
        let forgotten = full.then(|| self.frames.pop_front()).flatten();
        self.frames.push_back(frame.clone());
        forgotten
    }

    /// The newest frame remembered is the one with which the map started.
    pub(super) fn begin(&mut self, start: TrackedFrame) {
        self.frames.pop_back();
        self.later = Some(start);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// When the frame was captured from which the next is looked for.
    #[cfg(test)]
    pub(super) fn leads_from(&self) -> Option<geometry::Timestamp> {
        Some(self.later.as_ref()?.captured_at)
    }

    /// Gives up the frames that were not found, oldest first.
    pub(super) fn take_frames(&mut self) -> VecDeque<Frame> {
        std::mem::take(&mut self.frames)
    }

    /// Looks for the newest of the frames, going backward from the start of the map; returns it if
    /// it then has no place.
    pub(super) fn step(
        &mut self,
        (optics, map): (&Optics, &mut VslamMap),
        trajectory: &mut [FrameRecord],
        rng: &mut ChaCha8Rng,
    ) -> Option<Missed> {
        let (mut frame, later) = (self.frames.pop_back()?, self.later.as_ref()?);
        let (place, sure) = match find_keyframe(map, &frame) {
            Some(keyframe) => {
                let place = keyframe.place;
                self.later = Some(keyframe);
                (place, true)
            }
            None => {
                let motion = Motion::starting_at(later.clone());
                let tracked = track(optics, map, &motion, &mut frame, rng).ok();
                let Some(tracked) = tracked.filter(|tracked| tracked.is_placed) else {
                    return Some(Missed::Lost(frame));
                };
                let place = map.place(tracked.reference, &tracked.camera_from_map)?;
                self.later = Some(TrackedFrame {
                    captured_at: frame.captured_at,
                    place,
                    observations: frame.observations.clone(),
                });
                let sure = is_sure(map, trajectory, (&frame.observations, &tracked));
                (place, sure)
            }
        };
        if !sure {
            return Some(Missed::Unsure(frame));
        }
        if let Some(record) = trajectory.get_mut(frame.frame_idx as usize) {
            record.find(map.id(), place);
        }
        None
    }
}

/// The keyframe that the frame became, if it did.
fn find_keyframe(map: &VslamMap, frame: &Frame) -> Option<TrackedFrame> {
    let is_same = |one: &&crate::Keyframe| one.frame_idx == Some(frame.frame_idx);
    let keyframe = map.keyframes().find(is_same)?;
    Some(TrackedFrame {
        captured_at: frame.captured_at,
        place: map.place(keyframe.id, &keyframe.camera_from_map)?,
        observations: keyframe.observations.clone(),
    })
}

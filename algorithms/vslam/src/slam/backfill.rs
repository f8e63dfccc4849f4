//! Finds the frames from before the map was born in the map, one with each later frame.

use std::collections::VecDeque;

use rand_chacha::ChaCha8Rng;

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

    /// Gives up the frames that were not found, oldest first.
    pub(super) fn take_frames(&mut self) -> VecDeque<Frame> {
        std::mem::take(&mut self.frames)
    }

    /// Looks for the newest of the frames, going backward from the start of the map; returns it if
    /// it is not found.
    pub(super) fn step(
        &mut self,
        (optics, map): (&Optics, &mut VslamMap),
        trajectory: &mut [FrameRecord],
        rng: &mut ChaCha8Rng,
    ) -> Option<Frame> {
        let (mut frame, later) = (self.frames.pop_back()?, self.later.as_ref()?);
        let Some(found) = find(optics, map, later, &mut frame, rng) else {
            return Some(frame);
        };
        if let Some(record) = trajectory.get_mut(frame.frame_idx as usize) {
            record.map_id = map.id();
            record.place = Some(found.place);
        }
        self.later = Some(found);
        None
    }
}

fn find(
    optics: &Optics,
    map: &mut VslamMap,
    later: &TrackedFrame,
    frame: &mut Frame,
    rng: &mut ChaCha8Rng,
) -> Option<TrackedFrame> {
    let captured_at = frame.captured_at;
    let is_same = |one: &&crate::Keyframe| one.frame_idx == Some(frame.frame_idx);
    let keyframe = map.keyframes().find(is_same);
    if let Some(keyframe) = keyframe {
        return Some(TrackedFrame {
            captured_at,
            place: map.place(keyframe.id, &keyframe.camera_from_map)?,
            observations: keyframe.observations.clone(),
        });
    }
    let tracked = track(optics, map, &Motion::starting_at(later.clone()), frame, rng).ok()?;
    if !tracked.is_placed {
        return None;
    }
    Some(TrackedFrame {
        captured_at,
        place: map.place(tracked.reference, &tracked.camera_from_map)?,
        observations: frame.observations.clone(),
    })
}

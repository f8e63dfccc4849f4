//! Frames without a pose in the largest map, kept until it shows where they were.

use std::collections::VecDeque;

use features::Descriptor;
use geometry::Timestamp;
use nalgebra::Vector2;
use rand_chacha::ChaCha8Rng;

use super::sureness::is_sure;
use crate::frame::Frame;
use crate::map::Place;
use crate::optics::Optics;
use crate::places::Places;
use crate::plane_grid::PlaneGrid;
use crate::relocalise::Relocaliser;
use crate::tracking::{Motion, Tracked, TrackedFrame, track};
use crate::trajectory::FrameRecord;
use crate::{Observation, VslamMap};

/// Frames kept, about 50 kB each; the oldest are forgotten first.
const FRAMES_MAX: usize = 600;
/// A frame is tried again when the map has so many more keyframes, or was corrected.
const GROWTH_KEYFRAMES: usize = 3;
/// Tries while the camera goes on; the end has one more.
const TRIES_MAX: u32 = 4;
/// A frame with a pose this many frames away says where to look first.
const NEAR_FRAMES: usize = 5;

/// The frames that wait, oldest first.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    frames: VecDeque<WaitingFrame>,
}

#[derive(Debug)]
struct WaitingFrame {
    frame_idx: u64,
    captured_at: Timestamp,
    keypoints: Box<[Keypoint]>,
    tries: u32,
    /// Keyframes and revision of the map when it was tried.
    tried_at: Option<(usize, u64)>,
}

/// An observation in half its size: only what it takes to find the camera.
#[derive(Debug)]
struct Keypoint {
    position: [f32; 2],
    sigma: f32,
    angle_rad: f32,
    descriptor: Descriptor,
    level: u8,
}

/// What it takes to find a frame.
pub(super) struct Search<'a> {
    pub(super) optics: &'a Optics,
    pub(super) places: &'a Places,
    pub(super) relocaliser: &'a mut Relocaliser,
    pub(super) rng: &'a mut ChaCha8Rng,
}

impl Waiting {
    pub(super) fn remember(&mut self, frame: &Frame) {
        self.push(frame, 0);
    }

    /// The same for a frame of which the place is known as well as it can be for now: it is tried
    /// when the map is done.
    pub(super) fn remember_for_end(&mut self, frame: &Frame) {
        self.push(frame, TRIES_MAX);
    }

    fn push(&mut self, frame: &Frame, tries: u32) {
        if self.frames.len() == FRAMES_MAX {
            self.frames.pop_front();
        }
        let keypoints = frame.observations.iter().map(Keypoint::of).collect();
        self.frames.push_back(WaitingFrame {
            frame_idx: frame.frame_idx,
            captured_at: frame.captured_at,
            keypoints,
            tries,
            tried_at: None,
        });
    }

    /// Tries the newest frame for which there is new hope; whether there was one.
    pub(super) fn step(
        &mut self,
        search: &mut Search,
        map: &mut VslamMap,
        trajectory: &mut [FrameRecord],
    ) -> bool {
        let size = (map.keyframe_count(), map.revision());
        let changed = |(keyframe_count, revision): (usize, u64)| {
            size.0 >= keyframe_count + GROWTH_KEYFRAMES || size.1 > revision
        };
        let hopeful =
            |frame: &WaitingFrame| frame.tries < TRIES_MAX && frame.tried_at.is_none_or(changed);
        let Some(idx) = self.frames.iter().rposition(hopeful) else {
            return false;
        };
        let frame = &mut self.frames[idx];
        frame.tries += 1;
        frame.tried_at = Some(size);
        if frame.find(search, map, trajectory) {
            self.frames.remove(idx);
        }
        true
    }

    /// Tries all frames, to and fro until no more are found: each may lead to the one beside it.
    pub(super) fn finish(
        &mut self,
        search: &mut Search,
        map: &mut VslamMap,
        trajectory: &mut [FrameRecord],
    ) {
        loop {
            let before = self.frames.len();
            self.frames
                .retain_mut(|frame| !frame.find(search, map, trajectory));
            let backward: Vec<WaitingFrame> = self.frames.drain(..).rev().collect();
            let still = backward.into_iter();
            self.frames = still
                .filter_map(|frame| (!frame.find(search, map, trajectory)).then_some(frame))
                .collect();
            self.frames.make_contiguous().reverse();
            if self.frames.len() == before {
                return;
            }
        }
    }
}

impl WaitingFrame {
    /// Looks for the frame in the map, and notes its pose; also `true` if it has one by now.
    fn find(
        &self,
        search: &mut Search,
        map: &mut VslamMap,
        trajectory: &mut [FrameRecord],
    ) -> bool {
        let frame_idx = self.frame_idx as usize;
        let known = |idx: usize| {
            let record: &FrameRecord = trajectory.get(idx)?;
            record.place.filter(|_| record.map_id == map.id())
        };
        if known(frame_idx).is_some() {
            return true;
        }
        let near = (1..=NEAR_FRAMES).find_map(|steps| {
            let before = frame_idx.checked_sub(steps).and_then(known);
            before.or_else(|| known(frame_idx + steps))
        });
        let mut frame = self.unpack(search.optics);
        let found = locate(search, map, &mut frame, near);
        let sure = found.filter(|found| is_sure(map, trajectory, (&frame.observations, found)));
        let Some(place) = sure.and_then(|found| map.place(found.reference, &found.camera_from_map))
        else {
            return false;
        };
        if let Some(record) = trajectory.get_mut(frame_idx) {
            record.find(map.id(), place);
        }
        true
    }

    fn unpack(&self, optics: &Optics) -> Frame {
        let observations: Vec<Observation> =
            self.keypoints.iter().map(Keypoint::observation).collect();
        Frame {
            frame_idx: self.frame_idx,
            captured_at: self.captured_at,
            grid: PlaneGrid::new(optics, &observations),
            observations,
        }
    }
}

/// Looks first near a frame that was captured about the same time, then everywhere.
fn locate(
    search: &mut Search,
    map: &mut VslamMap,
    frame: &mut Frame,
    near: Option<Place>,
) -> Option<Tracked> {
    let by_time = near.and_then(|place| {
        let keyframe = map.keyframe(map.holder(place.keyframe)?)?;
        let motion = Motion::starting_at(TrackedFrame {
            captured_at: frame.captured_at,
            place,
            observations: keyframe.observations.clone(),
        });
        track(search.optics, map, &motion, frame, search.rng).ok()
    });
    let by_time = by_time.filter(Tracked::is_certain);
    by_time.or_else(|| {
        frame.forget_points();
        let index = (search.optics, search.places);
        let found = search.relocaliser.locate(index, map, frame, search.rng);
        found.filter(Tracked::is_certain)
    })
}

impl Keypoint {
    fn of(observation: &Observation) -> Self {
        Self {
            position: [observation.position.x as f32, observation.position.y as f32],
            sigma: observation.sigma as f32,
            angle_rad: observation.angle_rad,
            descriptor: observation.descriptor,
            level: observation.level,
        }
    }

    fn observation(&self) -> Observation {
        Observation {
            position: Vector2::new(self.position[0].into(), self.position[1].into()),
            // Only keyframes are asked for it.
            position_px: Vector2::zeros(),
            sigma: self.sigma.into(),
            level: self.level,
            angle_rad: self.angle_rad,
            descriptor: self.descriptor,
            point: None,
        }
    }
}

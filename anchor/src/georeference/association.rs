//! Ties fixes to camera poses: interpolated in time, held relative to a keyframe.

use std::collections::{BTreeMap, VecDeque};

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Unit, Vector3};
use vslam::KeyframeId;

use super::LocalFix;
use crate::{FrameInput, GeoreferenceSettings, KeyframePose};

/// Frames that are remembered, so that a late fix still finds its place: 20 s at 30 Hz.
const FRAME_COUNT_MAX: usize = 600;
/// Fixes that wait for their frame.
const PENDING_COUNT_MAX: usize = 256;

/// A fix and where the camera was, relative to a keyframe that carries both along when it moves.
#[derive(Clone, Debug)]
pub(super) struct Tie {
    pub(super) keyframe: KeyframeId,
    pub(super) keyframe_from_camera: Transform<Camera, Camera>,
    /// [`KeyframePose::unit`] of the keyframe at the time.
    unit: f64,
    pub(super) up_in_camera: Option<Unit<Vector3<f64>>>,
    pub(super) fix: LocalFix,
}

impl Tie {
    /// The same with lengths as they are in the map now, where the keyframe has this unit.
    pub(super) fn in_unit(&self, unit: f64) -> Self {
        let pose = &self.keyframe_from_camera;
        let way = pose.translation() * (unit / self.unit);
        Self {
            keyframe_from_camera: Transform::new(*pose.rotation(), way),
            unit,
            ..self.clone()
        }
    }
}

#[derive(Debug)]
pub(super) struct Association {
    gap_max_s: f64,
    tie_count_max: usize,
    frames: VecDeque<Frame>,
    pending: VecDeque<LocalFix>,
    ties: VecDeque<Tie>,
    tied_count: u64,
    unmatched_count: u64,
}

#[derive(Clone, Copy, Debug)]
struct Frame {
    captured_at: Timestamp,
    keyframe: KeyframeId,
    keyframe_from_camera: Transform<Camera, Camera>,
    up_in_camera: Option<Unit<Vector3<f64>>>,
}

type Keyframes = BTreeMap<KeyframeId, KeyframePose>;

impl Association {
    pub(super) fn new(settings: &GeoreferenceSettings) -> Self {
        Self {
            gap_max_s: settings.frame_gap_max_s,
            tie_count_max: settings.fix_count_max,
            frames: VecDeque::new(),
            pending: VecDeque::new(),
            ties: VecDeque::new(),
            tied_count: 0,
            unmatched_count: 0,
        }
    }

    pub(super) fn insert_frame(&mut self, frame: &FrameInput, keyframes: &Keyframes) {
        let newest = self.frames.back().map(|frame| frame.captured_at);
        if newest.is_some_and(|newest| frame.captured_at <= newest) {
            return;
        }
        // The newest keyframe taken by then; it is near, and what moves it moves the frame.
        let reference = keyframes
            .values()
            .rev()
            .find(|keyframe| keyframe.captured_at <= frame.captured_at);
        let Some(reference) = reference else { return };
        if self.frames.len() == FRAME_COUNT_MAX {
            self.frames.pop_front();
        }
        self.frames.push_back(Frame {
            captured_at: frame.captured_at,
            keyframe: reference.id,
            keyframe_from_camera: reference.map_from_camera.inverse() * frame.map_from_camera,
            up_in_camera: frame.up_in_camera,
        });
        while self
            .pending
            .front()
            .is_some_and(|fix| fix.captured_at <= frame.captured_at)
        {
            let fix = self
                .pending
                .pop_front()
                .expect("it was there in the condition");
            self.tie(fix, keyframes);
        }
    }

    pub(super) fn insert_fix(&mut self, fix: LocalFix, keyframes: &Keyframes) {
        let newest = self.frames.back().map(|frame| frame.captured_at);
        if newest.is_some_and(|newest| newest >= fix.captured_at) {
            return self.tie(fix, keyframes);
        }
        if self.pending.len() == PENDING_COUNT_MAX {
            self.pending.pop_front();
            self.unmatched_count += 1;
        }
        self.pending.push_back(fix);
    }

    pub(super) fn ties(&self) -> impl Iterator<Item = &Tie> {
        self.ties.iter()
    }

    pub(super) fn tied_count(&self) -> u64 {
        self.tied_count
    }

    pub(super) fn unmatched_count(&self) -> u64 {
        self.unmatched_count
    }

    fn tie(&mut self, fix: LocalFix, keyframes: &Keyframes) {
        let Some(tie) = self.interpolate(&fix, keyframes) else {
            self.unmatched_count += 1;
            return;
        };
        if self.ties.len() == self.tie_count_max {
            self.ties.pop_front();
        }
        self.tied_count += 1;
        self.ties.push_back(tie);
    }

    fn interpolate(&self, fix: &LocalFix, keyframes: &Keyframes) -> Option<Tie> {
        let after_idx = self
            .frames
            .partition_point(|frame| frame.captured_at < fix.captured_at);
        let after = self.frames.get(after_idx)?;
        let exact = after.captured_at == fix.captured_at;
        let before = if exact {
            after
        } else {
            self.frames.get(after_idx.checked_sub(1)?)?
        };
        let gap_s = after.captured_at - before.captured_at;
        if gap_s > self.gap_max_s {
            return None;
        }
        let keyframe = keyframes.get(&before.keyframe)?;
        let (reference, unit) = (keyframe.map_from_camera, keyframe.unit);
        let share = if exact {
            0.0
        } else {
            (fix.captured_at - before.captured_at) / gap_s
        };
        let before_pose: Transform<Map, Camera> = reference * before.keyframe_from_camera;
        let after_pose =
            keyframes.get(&after.keyframe)?.map_from_camera * after.keyframe_from_camera;
        let step = before_pose.inverse() * after_pose;
        let pose = before_pose * Transform::exp(&(step.log() * share));
        Some(Tie {
            keyframe: before.keyframe,
            keyframe_from_camera: reference.inverse() * pose,
            unit,
            up_in_camera: if share < 0.5 {
                before.up_in_camera
            } else {
                after.up_in_camera
            },
            fix: fix.clone(),
        })
    }
}

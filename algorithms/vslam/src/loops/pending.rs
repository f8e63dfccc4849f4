//! When a global adjustment is worked on, and when it counts.
//!
//! It counts so many frames after it began as the size of the map says, those that became keyframes
//! left out, no matter where and how fast the work was done: a recording gives the same trajectory
//! on one thread and on several.

use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Weak};

use super::global::{GlobalAdjustment, STEPS_MAX};
use crate::settings::Background;
use crate::{MapId, VslamMap};

/// Observations that a frame's share of a step has at most: about 15 ms on a small core.
const OBSERVATIONS_PER_FRAME: usize = 40_000;

/// A global adjustment that has begun.
#[derive(Debug)]
pub(super) struct Pending {
    map: MapId,
    work: Work,
    frames_per_step: usize,
    frame_count: usize,
}

#[derive(Debug)]
enum Work {
    /// Done a step at a time, between frames.
    Here(Box<GlobalAdjustment>),
    /// Done elsewhere, as long as somebody waits for it.
    Elsewhere {
        result: Receiver<GlobalAdjustment>,
        _wanted: Arc<()>,
    },
}

impl Pending {
    pub(super) fn new(map: &VslamMap, background: Option<Background>) -> Self {
        let adjustment = GlobalAdjustment::new(map);
        let frames_per_step = adjustment
            .observation_count()
            .div_ceil(OBSERVATIONS_PER_FRAME)
            .max(1);
        let work = match background {
            None => Work::Here(Box::new(adjustment)),
            Some(run) => {
                let wanted = Arc::new(());
                let (sender, result) = channel();
                let still_wanted = Arc::downgrade(&wanted);
                run(Box::new(move || {
                    // A failure to send says that nobody waits any more.
                    let _ = sender.send(solved(adjustment, &still_wanted));
                }));
                Work::Elsewhere {
                    result,
                    _wanted: wanted,
                }
            }
        };
        Self {
            map: map.id(),
            work,
            frames_per_step,
            frame_count: 0,
        }
    }

    pub(super) fn is_of(&self, map: &VslamMap) -> bool {
        self.map == map.id()
    }

    /// Notes a frame; whether it is one of those that lend their time.
    pub(super) fn pass_frame(&mut self) -> bool {
        self.frame_count += 1;
        let lends = self.frame_count.is_multiple_of(self.frames_per_step);
        if let Work::Here(adjustment) = &mut self.work
            && lends
        {
            adjustment.advance(1);
        }
        lends
    }

    pub(super) fn is_due(&self) -> bool {
        self.frame_count >= STEPS_MAX * self.frames_per_step
    }

    /// Corrects the map, and waits for what is not done yet.
    ///
    /// Work that was lost elsewhere leaves the map as it is.
    pub(super) fn finish(self, map: &mut VslamMap) {
        match self.work {
            Work::Here(adjustment) => adjustment.finish(map),
            Work::Elsewhere { result, _wanted } => {
                if let Ok(adjustment) = result.recv() {
                    adjustment.finish(map);
                }
            }
        }
    }
}

/// Takes all steps, unless nobody waits for them any more.
fn solved(mut adjustment: GlobalAdjustment, wanted: &Weak<()>) -> GlobalAdjustment {
    for _ in 0..STEPS_MAX {
        if wanted.strong_count() == 0 {
            break;
        }
        adjustment.advance(1);
    }
    adjustment
}

//! Images as they are due, and what the front end finds in them.

use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use geometry::Timestamp;
use vslam::{ExtractedFrame, FrontEnd};

use crate::cli::output::Progress;
use crate::dataset::{Camera, CameraEvent, UnreadableImage};

/// When frames are due if the recording plays at its own speed.
#[derive(Default)]
pub struct Pace {
    first: Option<(Instant, Timestamp)>,
}

impl Pace {
    fn due(&mut self, captured_at: Timestamp) -> Instant {
        let (start, first_captured_at) = *self.first.get_or_insert((Instant::now(), captured_at));
        start + captured_at.since(first_captured_at)
    }
}

/// A frame that waits to be tracked.
pub struct Arrival {
    pub frame: ExtractedFrame,
    /// When its image was there: at real time when it was due, else when it was taken up.
    pub came_at: Instant,
    /// When its keypoints were found; from then on it waits for the map.
    pub found_at: Instant,
}

/// What was taken in, and what was not.
#[derive(Default)]
pub struct IntakeCounts {
    pub dropped: usize,
    pub unreadable_count: usize,
    pub first_unreadable: Option<UnreadableImage>,
}

/// Takes images from a camera when they are due.
pub struct Intake<'a, C> {
    camera: C,
    front_end: FrontEnd,
    pace: Option<Pace>,
    /// At real time a frame is late once its successor is due.
    next: Option<CameraEvent>,
    counts: IntakeCounts,
    progress: &'a Progress,
}

impl<'a, C: Camera> Intake<'a, C> {
    pub fn new(
        mut camera: C,
        front_end: FrontEnd,
        pace: Option<Pace>,
        progress: &'a Progress,
    ) -> Self {
        Self {
            next: camera.next_event(),
            camera,
            front_end,
            pace,
            counts: IntakeCounts::default(),
            progress,
        }
    }

    /// Gives each frame to `take`, found in the same thread.
    pub fn run_inline(mut self, mut take: impl FnMut(Arrival)) -> IntakeCounts {
        while let Some(arrival) = self.next_arrival() {
            take(arrival);
        }
        self.counts
    }

    /// Gives each frame to `take` while a thread of its own looks at the next one.
    ///
    /// At real time two frames wait at most for one that changes the map at length, else one: more
    /// would only wait longer. The frames are the same as those of [`Self::run_inline`], unless
    /// late ones are dropped.
    pub fn run_ahead(self, mut take: impl FnMut(Arrival)) -> IntakeCounts {
        let (sender, receiver) = sync_channel(usize::from(self.pace.is_some()));
        let mut intake = self;
        std::thread::scope(|scope| {
            let worker = scope.spawn(move || {
                while let Some(arrival) = intake.next_arrival() {
                    if sender.send(arrival).is_err() {
                        break;
                    }
                }
                intake.counts
            });
            for arrival in receiver {
                take(arrival);
            }
            worker
                .join()
                .unwrap_or_else(|fault| std::panic::resume_unwind(fault))
        })
    }

    /// The next frame that is readable and not late, waited for.
    fn next_arrival(&mut self) -> Option<Arrival> {
        loop {
            let event = self.next.take()?;
            self.next = self.camera.next_event();
            self.progress.advance(1);
            let frame = match event {
                CameraEvent::Frame(frame) => frame,
                CameraEvent::Unreadable { error, .. } => {
                    self.counts.unreadable_count += 1;
                    self.counts.first_unreadable.get_or_insert(error);
                    continue;
                }
            };
            let Some(came_at) = self.wait_for(frame.captured_at) else {
                self.counts.dropped += 1;
                continue;
            };
            let frame = self.front_end.extract(&frame.image, frame.captured_at);
            return Some(Arrival {
                frame,
                came_at,
                found_at: Instant::now(),
            });
        }
    }

    /// Waits until a frame is due, and tells since when it is there; `None` if it is late.
    fn wait_for(&mut self, captured_at: Timestamp) -> Option<Instant> {
        let Some(pace) = &mut self.pace else {
            return Some(Instant::now());
        };
        let due = pace.due(captured_at);
        let next = self.next.as_ref().map(CameraEvent::captured_at);
        if next.is_some_and(|next| pace.due(next) <= Instant::now()) {
            return None;
        }
        let early: Duration = due.saturating_duration_since(Instant::now());
        std::thread::sleep(early);
        Some(due)
    }
}

//! A recording, played as a camera.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

use camera::{Calibration, Image};
use geometry::Timestamp;

use super::{Dataset, DatasetImages, FrameEntry, UnreadableImage};

/// One decoded image of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The number of the frame in the whole recording, from zero.
    pub frame_idx: usize,
    pub captured_at: Timestamp,
    pub image: Image,
}

/// What a camera gives next.
#[derive(Debug)]
pub enum CameraEvent {
    Frame(Frame),
    /// An image is there and cannot be used; the caller counts and skips it.
    Unreadable {
        frame_idx: usize,
        captured_at: Timestamp,
        error: UnreadableImage,
    },
}

impl CameraEvent {
    pub fn captured_at(&self) -> Timestamp {
        match self {
            Self::Frame(frame) => frame.captured_at,
            Self::Unreadable { captured_at, .. } => *captured_at,
        }
    }
}

/// A source of images in the order of their time stamps: a recording now, hardware later.
pub trait Camera: Send {
    fn calibration(&self) -> &Calibration;

    /// The next image, waited for; `None` when there will be no more.
    fn next_event(&mut self) -> Option<CameraEvent>;
}

/// How many decoded images wait at most; the decoding thread pauses when they do.
const DECODED_AHEAD_MAX: usize = 4;

/// A recording as a [`Camera`], decoding in the caller's thread or ahead in its own.
pub struct DatasetCamera {
    calibration: Calibration,
    source: Source,
}

enum Source {
    Inline {
        frames: std::vec::IntoIter<FrameEntry>,
        images: Box<DatasetImages>,
    },
    Ahead(Receiver<CameraEvent>),
}

impl DatasetCamera {
    /// Decodes each image when it is asked for.
    pub fn inline(dataset: Dataset) -> Self {
        Self {
            calibration: dataset.calibration().clone(),
            source: Source::Inline {
                images: Box::new(dataset.images()),
                frames: dataset.frames.into_iter(),
            },
        }
    }

    /// Decodes on a thread of its own, a few images ahead. The images are the same.
    pub fn decoding_ahead(dataset: Dataset) -> Self {
        let calibration = dataset.calibration().clone();
        let (sender, receiver) = sync_channel(DECODED_AHEAD_MAX);
        thread::spawn(move || {
            let mut images = dataset.images();
            for entry in dataset.frames() {
                // The receiver is gone when the reader stops early.
                if sender.send(read_event(&mut images, entry)).is_err() {
                    return;
                }
            }
        });
        Self {
            calibration,
            source: Source::Ahead(receiver),
        }
    }
}

impl Camera for DatasetCamera {
    fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    fn next_event(&mut self) -> Option<CameraEvent> {
        match &mut self.source {
            Source::Inline { frames, images } => Some(read_event(images, &frames.next()?)),
            Source::Ahead(receiver) => receiver.recv().ok(),
        }
    }
}

fn read_event(images: &mut DatasetImages, entry: &FrameEntry) -> CameraEvent {
    match images.read(entry) {
        Ok(image) => CameraEvent::Frame(Frame {
            frame_idx: entry.frame_idx,
            captured_at: entry.captured_at,
            image,
        }),
        Err(error) => CameraEvent::Unreadable {
            frame_idx: entry.frame_idx,
            captured_at: entry.captured_at,
            error,
        },
    }
}

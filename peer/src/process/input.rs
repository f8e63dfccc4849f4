//! Cameras and position sources as one stream of inputs in the order of time.

mod recording;
mod stamp_gate;
mod stream;

use std::sync::mpsc::{Receiver, Sender, SyncSender, channel};
use std::time::{Duration, Instant};

use anchor::PositionFix;
use anyhow::bail;
use camera::{Calibration, Image};
use geometry::Timestamp;
use nalgebra::Vector3;

use super::Arrival;
use crate::config::VehicleConfig;
use crate::dataset::CalibrationFile;
use crate::station::StationWindow;
use recording::Recording;
use stream::StreamSource;

/// What a driver brings.
#[derive(Debug)]
pub enum Input {
    Frame {
        captured_at: Timestamp,
        image: Image,
    },
    /// There was an image, and it cannot be used.
    Unreadable {
        captured_at: Timestamp,
        reason: String,
    },
    Fix(PositionFix),
    /// Something came that cannot even be placed in time; it is counted.
    Skipped {
        what: Skipped,
        reason: String,
    },
    /// So many fixes of a file are not used; more do not follow.
    FixesLeftOut {
        count: u64,
        reason: String,
    },
    /// The driver failed: nothing more comes, though more should.
    BrokenOff {
        reason: String,
    },
    End,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Skipped {
    Frame,
    Fix,
}

impl Input {
    /// What cannot be placed in time is due at once.
    pub fn captured_at(&self) -> Timestamp {
        match self {
            Self::Frame { captured_at, .. } | Self::Unreadable { captured_at, .. } => *captured_at,
            Self::Fix(fix) => fix.captured_at,
            Self::Skipped { .. }
            | Self::FixesLeftOut { .. }
            | Self::BrokenOff { .. }
            | Self::End => Timestamp::from_nanoseconds(i64::MIN),
        }
    }

    /// Whether the driver waits for an acknowledgement.
    pub fn is_frame(&self) -> bool {
        matches!(self, Self::Frame { .. } | Self::Unreadable { .. })
    }
}

/// Takes velocities for the autopilot: when they are from, and forward, left and up in the heading
/// frame. False once nobody takes them.
pub type VelocitySink = Box<dyn FnMut(Timestamp, &Vector3<f64>) -> bool + Send>;

/// A camera with a position source or without.
pub trait Source: Send {
    fn calibration(&self) -> &Calibration;

    /// When the first frame was captured, if that is known beforehand.
    fn first_captured_at(&self) -> Option<Timestamp>;

    /// The next input, waited for. Fixes come before the frames that are newer than them.
    fn next_input(&mut self) -> Option<Input>;

    /// The frame's pose has been published.
    fn acknowledge(&mut self, captured_at: Timestamp);

    /// Whether the stamps say when a frame is due, or frames come when they come.
    fn is_recorded(&self) -> bool;

    /// The way to the autopilot, if the driver is one.
    fn velocity_sink(&self) -> Option<VelocitySink> {
        None
    }
}

/// So long may a stream driver take to answer, and to finish a message that it began.
const STREAM_PATIENCE: Duration = Duration::from_secs(10);

/// Opens what the configuration names.
pub fn open(config: &VehicleConfig) -> anyhow::Result<Box<dyn Source>> {
    let camera = &config.camera;
    match (&camera.dataset, &camera.stream, &camera.calibration) {
        (Some(dataset), _, _) => Ok(Box::new(Recording::open(config, &dataset.parse()?)?)),
        (None, Some(address), Some(calibration)) => {
            let file = CalibrationFile::read(calibration)?;
            let takes_fixes = config.position.as_ref().is_some_and(|one| one.stream);
            let mut source = StreamSource::connect(address, file.calibration, STREAM_PATIENCE)?;
            source.takes_fixes = takes_fixes;
            Ok(Box::new(source))
        }
        _ => bail!("[camera] needs a dataset, or a stream with a calibration"),
    }
}

/// Feeds the vehicle's loop from a thread, one frame at a time, recordings by their stamps.
///
/// - `station`: sees each image before the loop does, and answers it on its own.
pub(super) fn start(
    source: Box<dyn Source>,
    arrivals: SyncSender<Arrival>,
    station: Option<StationWindow>,
) -> Sender<Timestamp> {
    let (sender, acknowledged) = channel();
    std::thread::spawn(move || feed(source, &arrivals, &acknowledged, station.as_ref()));
    sender
}

fn feed(
    mut source: Box<dyn Source>,
    arrivals: &SyncSender<Arrival>,
    acknowledged: &Receiver<Timestamp>,
    station: Option<&StationWindow>,
) {
    let mut start: Option<(Instant, Timestamp)> = None;
    while let Some(input) = source.next_input() {
        let (captured_at, is_frame) = (input.captured_at(), input.is_frame());
        if source.is_recorded() && is_frame {
            let (began, first) = *start.get_or_insert((Instant::now(), captured_at));
            let due = began + captured_at.since(first);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        if let (Some(station), Input::Frame { captured_at, image }) = (station, &input) {
            station.show(*captured_at, image.clone());
        }
        if arrivals.send(Arrival::Input(input)).is_err() {
            return;
        }
        if is_frame {
            let Ok(captured_at) = acknowledged.recv() else {
                return;
            };
            if let Some(station) = station {
                station.wait_until_answered();
            }
            source.acknowledge(captured_at);
        }
    }
    // The loop may have ended for another reason.
    let _ = arrivals.send(Arrival::Input(Input::End));
    // A simulator waits for the connection to close.
    drop(source);
}

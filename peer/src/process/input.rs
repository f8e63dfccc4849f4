//! Cameras and position sources as one stream of inputs in the order of time.

use std::collections::VecDeque;
use std::io::BufReader;
use std::net::TcpStream;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel};
use std::time::{Duration, Instant};

use anchor::{FixPosition, PositionFix};
use anyhow::{Context, bail};
use camera::{Calibration, Image};
use geometry::Timestamp;
use sim::stream;

use super::Arrival;
use crate::config::{PositionConfig, VehicleConfig};
use crate::dataset::{Camera, CameraEvent, Dataset, DatasetArgument, DatasetCamera};

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
    End,
}

impl Input {
    pub fn captured_at(&self) -> Timestamp {
        match self {
            Self::Frame { captured_at, .. } | Self::Unreadable { captured_at, .. } => *captured_at,
            Self::Fix(fix) => fix.captured_at,
            Self::End => Timestamp::default(),
        }
    }

    pub fn is_frame(&self) -> bool {
        matches!(self, Self::Frame { .. } | Self::Unreadable { .. })
    }
}

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
}

/// Opens what the configuration names.
pub fn open(config: &VehicleConfig) -> anyhow::Result<Box<dyn Source>> {
    let calibration = match &config.camera.calibration {
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read the calibration {}", path.display()))?;
            let parsed = Calibration::from_euroc_yaml(&text)
                .with_context(|| format!("calibration refused: {}", path.display()))?;
            Some(parsed)
        }
        None => None,
    };
    let camera = &config.camera;
    match (&camera.dataset, &camera.stream, calibration) {
        (Some(dataset), _, calibration) => {
            let argument: DatasetArgument = dataset.parse()?;
            let recording = Recording::open(&argument, calibration, config.position.as_ref())?;
            Ok(Box::new(recording))
        }
        (None, Some(address), Some(calibration)) => {
            Ok(Box::new(StreamSource::connect(address, calibration)?))
        }
        _ => bail!("[camera] needs a dataset, or a stream with a calibration"),
    }
}

/// A recording and a file of fixes.
struct Recording {
    camera: DatasetCamera,
    calibration: Calibration,
    first_captured_at: Option<Timestamp>,
    fixes: VecDeque<PositionFix>,
    pending: Option<CameraEvent>,
}

impl Recording {
    fn open(
        argument: &DatasetArgument,
        calibration: Option<Calibration>,
        position: Option<&PositionConfig>,
    ) -> anyhow::Result<Self> {
        let dataset = Dataset::open(argument)?;
        let stamps = dataset.frames().iter().map(|frame| frame.captured_at);
        let (first, last) = (stamps.clone().min(), stamps.max());
        let mut fixes = VecDeque::new();
        if let Some((position, path)) = position.and_then(|one| Some((one, one.file.as_ref()?))) {
            let file = crate::position::read_fixes(position, path)?;
            if file.malformed_count + file.out_of_order_count > 0 {
                tracing::warn!(
                    malformed = file.malformed_count,
                    out_of_order = file.out_of_order_count,
                    "lines of fixes left out"
                );
            }
            // What the vehicle has not flown yet, or not any more, is none of its business.
            let within = |fix: &PositionFix| {
                first.is_some_and(|first| fix.captured_at >= first)
                    && last.is_some_and(|last| fix.captured_at <= last)
            };
            fixes = file.fixes.into_iter().filter(within).collect();
        }
        let calibration = calibration.unwrap_or_else(|| dataset.calibration().clone());
        Ok(Self {
            camera: DatasetCamera::decoding_ahead(dataset),
            calibration,
            first_captured_at: first,
            fixes,
            pending: None,
        })
    }
}

impl Source for Recording {
    fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    fn first_captured_at(&self) -> Option<Timestamp> {
        self.first_captured_at
    }

    fn next_input(&mut self) -> Option<Input> {
        let Some(event) = self.pending.take().or_else(|| self.camera.next_event()) else {
            return self.fixes.pop_front().map(Input::Fix);
        };
        let captured_at = event.captured_at();
        let due = self
            .fixes
            .front()
            .is_some_and(|fix| fix.captured_at <= captured_at);
        if due && let Some(fix) = self.fixes.pop_front() {
            self.pending = Some(event);
            return Some(Input::Fix(fix));
        }
        Some(match event {
            CameraEvent::Frame(frame) => Input::Frame {
                captured_at,
                image: frame.image,
            },
            CameraEvent::Unreadable { error, .. } => Input::Unreadable {
                captured_at,
                reason: error.to_string(),
            },
        })
    }

    fn acknowledge(&mut self, _captured_at: Timestamp) {}

    fn is_recorded(&self) -> bool {
        true
    }
}

/// A stream driver: frames and fixes over TCP, each frame acknowledged.
struct StreamSource {
    calibration: Calibration,
    reader: BufReader<TcpStream>,
    writer: TcpStream,
}

impl StreamSource {
    fn connect(address: &str, calibration: Calibration) -> anyhow::Result<Self> {
        let mut writer = TcpStream::connect(address)
            .with_context(|| format!("cannot reach the stream driver at {address}"))?;
        writer.set_nodelay(true)?;
        let mut reader = BufReader::new(writer.try_clone()?);
        stream::write_message(&mut writer, &stream::Message::Hello)?;
        match stream::read_message(&mut reader) {
            Ok(stream::Message::Hello) => {}
            Ok(other) => bail!("the stream driver at {address} did not say hello but {other:?}"),
            Err(error) => bail!("the stream driver at {address} did not say hello: {error}"),
        }
        Ok(Self {
            calibration,
            reader,
            writer,
        })
    }
}

impl Source for StreamSource {
    fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    fn first_captured_at(&self) -> Option<Timestamp> {
        None
    }

    fn next_input(&mut self) -> Option<Input> {
        loop {
            match stream::read_message(&mut self.reader) {
                Ok(stream::Message::Frame(frame)) => {
                    return Some(Input::Frame {
                        captured_at: frame.captured_at,
                        image: frame.image,
                    });
                }
                Ok(stream::Message::Fix(fix)) => {
                    return Some(Input::Fix(PositionFix {
                        captured_at: fix.captured_at,
                        position: FixPosition::Local(fix.position_in_site),
                        covariance: fix.covariance_in_site,
                        heading: None,
                    }));
                }
                Ok(stream::Message::End) => return None,
                Ok(stream::Message::Hello | stream::Message::Acknowledgement { .. }) => {}
                Err(error) => {
                    tracing::error!(%error, "the stream ended early");
                    return None;
                }
            }
        }
    }

    fn acknowledge(&mut self, captured_at: Timestamp) {
        let message = stream::Message::Acknowledgement { captured_at };
        if let Err(error) = stream::write_message(&mut self.writer, &message) {
            tracing::debug!(%error, "the stream driver has gone");
        }
    }

    fn is_recorded(&self) -> bool {
        false
    }
}

/// Feeds the vehicle's loop from a thread, one frame at a time, recordings by their stamps.
pub(super) fn start(source: Box<dyn Source>, arrivals: SyncSender<Arrival>) -> Sender<Timestamp> {
    let (sender, acknowledged) = channel();
    std::thread::spawn(move || feed(source, &arrivals, &acknowledged));
    sender
}

fn feed(
    mut source: Box<dyn Source>,
    arrivals: &SyncSender<Arrival>,
    acknowledged: &Receiver<Timestamp>,
) {
    let mut start: Option<(Instant, Timestamp)> = None;
    while let Some(input) = source.next_input() {
        let (captured_at, is_frame) = (input.captured_at(), input.is_frame());
        if source.is_recorded() && is_frame {
            let (began, first) = *start.get_or_insert((Instant::now(), captured_at));
            let due = began + captured_at.since(first);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        if arrivals.send(Arrival::Input(input)).is_err() {
            return;
        }
        if is_frame {
            match acknowledged.recv() {
                Ok(captured_at) => source.acknowledge(captured_at),
                Err(_) => return,
            }
        }
    }
    // The loop may have ended for another reason.
    let _ = arrivals.send(Arrival::Input(Input::End));
    // A simulator waits for the connection to close, which dropping the source does.
    std::thread::sleep(Duration::from_millis(1));
}

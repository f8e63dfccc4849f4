//! A stream driver: frames and fixes over TCP, each frame acknowledged.

use std::io::{self, BufRead, BufReader, ErrorKind};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anchor::{FixPosition, PositionFix};
use anyhow::{Context, bail};
use camera::Calibration;
use geometry::Timestamp;
use sim::stream::{self, Malformed, Message, ReadError};

use super::stamp_gate::StampGate;
use super::{Input, Skipped, Source, VelocitySink};
use crate::dataset::ImageError;

/// Acknowledgements and velocities come from different threads. Nothing is left of it once a
/// message could not be written: a part of one would spoil all that follow.
type Writer = Arc<Mutex<Option<TcpStream>>>;

/// The vehicle's side of the connection.
pub struct StreamSource {
    address: String,
    calibration: Calibration,
    /// Whether somebody waits for fixes; otherwise they are left alone.
    pub takes_fixes: bool,
    patience: Duration,
    reader: BufReader<TcpStream>,
    writer: Writer,
    frame_gate: StampGate,
    fix_gate: StampGate,
    has_ended: bool,
}

impl StreamSource {
    /// - `patience`: how long the driver may take to answer, and between the first and the last
    ///   byte of a message. Between messages it may be silent for as long as it likes.
    pub fn connect(
        address: &str,
        calibration: Calibration,
        patience: Duration,
    ) -> anyhow::Result<Self> {
        let mut writer = connect(address, patience)
            .with_context(|| format!("cannot reach the stream driver at {address}"))?;
        writer.set_nodelay(true)?;
        writer.set_read_timeout(Some(patience))?;
        writer.set_write_timeout(Some(patience))?;
        let mut reader = BufReader::new(writer.try_clone()?);
        let greeting = stream::write_message(&mut writer, &Message::Hello)
            .map_err(ReadError::from)
            .and_then(|()| stream::read_message(&mut reader));
        match greeting {
            Ok(Message::Hello) => {}
            Ok(_) => bail!("the stream driver at {address} sends before it has said hello"),
            Err(error) => bail!(
                "the stream driver at {address} did not say hello: {}",
                describe(&error, patience)
            ),
        }
        Ok(Self {
            address: address.to_owned(),
            calibration,
            takes_fixes: true,
            patience,
            reader,
            writer: Arc::new(Mutex::new(Some(writer))),
            frame_gate: StampGate::default(),
            fix_gate: StampGate::default(),
            has_ended: false,
        })
    }

    fn read(&mut self) -> Result<Message, ReadError> {
        // A camera may pause, but not in the middle of a message.
        self.reader.get_ref().set_read_timeout(None)?;
        while let Err(error) = self.reader.fill_buf() {
            if error.kind() != ErrorKind::Interrupted {
                return Err(error.into());
            }
        }
        if self.reader.buffer().is_empty() {
            let reason = "the connection was closed without an end message";
            return Err(io::Error::other(reason).into());
        }
        self.reader
            .get_ref()
            .set_read_timeout(Some(self.patience))?;
        stream::read_message(&mut self.reader)
    }

    fn take_frame(&mut self, frame: stream::Frame) -> Input {
        let captured_at = frame.captured_at;
        if let Err(reason) = self.frame_gate.admit(captured_at) {
            // The vehicle's clock is the camera's: it must not hear of such a stamp.
            self.acknowledge(captured_at);
            return self.skip(Skipped::Frame, &reason);
        }
        let image = frame.image;
        let camera = &self.calibration.camera;
        if (image.width(), image.height()) == (camera.width(), camera.height()) {
            return Input::Frame { captured_at, image };
        }
        let error = ImageError::Size {
            got_width: image.width(),
            got_height: image.height(),
            expected_width: camera.width(),
            expected_height: camera.height(),
        };
        Input::Unreadable {
            captured_at,
            reason: format!("{error}: stream driver at {}", self.address),
        }
    }

    fn take_fix(&mut self, fix: stream::Fix) -> Input {
        if let Err(reason) = self.fix_gate.admit(fix.captured_at) {
            return self.skip(Skipped::Fix, &reason);
        }
        let fix = PositionFix {
            captured_at: fix.captured_at,
            position: FixPosition::Local(fix.position_in_site),
            covariance: fix.covariance_in_site,
            heading: None,
        };
        if fix.is_well_formed() {
            Input::Fix(fix)
        } else {
            self.skip(
                Skipped::Fix,
                "its covariance is none, or it is out of range",
            )
        }
    }

    fn skip(&self, what: Skipped, reason: &str) -> Input {
        Input::Skipped {
            what,
            reason: format!("{reason}: stream driver at {}", self.address),
        }
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
        while !self.has_ended {
            match self.read() {
                Ok(Message::Frame(frame)) => return Some(self.take_frame(frame)),
                Ok(Message::Fix(fix)) if self.takes_fixes => return Some(self.take_fix(fix)),
                Ok(Message::End) => self.has_ended = true,
                Ok(
                    Message::Hello
                    | Message::Acknowledgement { .. }
                    | Message::Fix(_)
                    | Message::Velocity(_),
                ) => {}
                Err(ReadError::Malformed(error @ Malformed::NotFinite { .. })) => {
                    if self.takes_fixes {
                        return Some(self.skip(Skipped::Fix, &error.to_string()));
                    }
                }
                Err(error) => {
                    self.has_ended = true;
                    return Some(Input::BrokenOff {
                        reason: format!(
                            "the stream broke off: {}: stream driver at {}",
                            describe(&error, self.patience),
                            self.address
                        ),
                    });
                }
            }
        }
        None
    }

    fn acknowledge(&mut self, captured_at: Timestamp) {
        send(&self.writer, &Message::Acknowledgement { captured_at });
    }

    fn is_recorded(&self) -> bool {
        false
    }

    fn velocity_sink(&self) -> Option<VelocitySink> {
        let writer = Arc::clone(&self.writer);
        Some(Box::new(move |captured_at, velocity_in_heading| {
            let command = stream::VelocityCommand {
                captured_at,
                velocity_in_heading: *velocity_in_heading,
            };
            send(&writer, &Message::Velocity(command))
        }))
    }
}

/// False if the driver takes nothing more; whoever reads the stream learns why.
fn send(writer: &Writer, message: &Message) -> bool {
    let mut writer = writer.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(stream) = writer.as_mut() else {
        return false;
    };
    let Err(error) = stream::write_message(stream, message) else {
        return true;
    };
    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) {
        tracing::warn!("the stream driver does not read what is sent to it, and is given up");
    } else {
        tracing::debug!(%error, "the stream driver has gone");
    }
    // So that reading ends too.
    let _ = stream.shutdown(Shutdown::Both);
    *writer = None;
    false
}

fn connect(address: &str, patience: Duration) -> io::Result<TcpStream> {
    let mut failure = io::Error::new(ErrorKind::NotFound, "the name has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, patience) {
            Ok(stream) => return Ok(stream),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// What is wrong, for a person: the system's words for these are about buffers and resources.
fn describe(error: &ReadError, patience: Duration) -> String {
    let ReadError::Io(io) = error else {
        return error.to_string();
    };
    match io.kind() {
        ErrorKind::UnexpectedEof => "the connection was closed in the middle of a message".into(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut => {
            format!("no byte came for {} s", patience.as_secs_f64())
        }
        _ => io.to_string(),
    }
}

#[cfg(test)]
mod tests;

//! The wire between the simulator and one vehicle.
//!
//! A message is a header and a payload, integers and floats little-endian:
//!
//! ```text
//! 0      4      5        6          8             16      20       24           28
//! +------+------+--------+----------+-------------+-------+--------+------------+-----------
//! | SLS1 | kind | format | 0 0      | captured_at | width | height | byte count | payload …
//! +------+------+--------+----------+-------------+-------+--------+------------+-----------
//! | 4 B  | u8   | u8     | reserved | i64, ns     | u32   | u32    | u32        |
//! ```
//!
//! The vehicle connects and says [`Message::Hello`]; the simulator answers with the same.
//! Then come fixes and frames in the order of their time stamps. The vehicle acknowledges each
//! frame once its pose is published, and the next frame waits for that. A vehicle that commands
//! its own flight says [`Message::Velocity`] whenever it wants, and what it wants because of a
//! frame before it acknowledges that frame. The one with the frame's stamp flies, or else the
//! newest. [`Message::End`] closes the route. No pose, no depth and no identity is on this wire.

use std::io::{self, Read, Write};

use camera::Image;
use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};

pub const HEADER_BYTES: usize = 28;
/// No image is larger: 4096 × 4096 grey pixels.
pub const PAYLOAD_BYTES_MAX: usize = 1 << 24;

const MAGIC: [u8; 4] = *b"SLS1";
const FORMAT_NONE: u8 = 0;
const FORMAT_GREY8: u8 = 1;
/// Position, then the upper triangle of the covariance by rows, each as an f64.
const FIX_BYTES: usize = 9 * 8;
/// Forward, left and up, each as an f64.
const VELOCITY_BYTES: usize = 3 * 8;
const SIDE_PX_MAX: u32 = 4096;

/// What travels between simulator and vehicle.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Either side is ready.
    Hello,
    Frame(Frame),
    Fix(Fix),
    /// The frame captured then is dealt with.
    Acknowledgement {
        captured_at: Timestamp,
    },
    /// Nothing follows.
    End,
    /// From a vehicle whose flight is commanded: so it wants to fly from now on.
    Velocity(VelocityCommand),
}

/// A grey image, stamped at the middle of its exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    pub captured_at: Timestamp,
    pub image: Image,
}

/// A measured position of the camera in the site frame, with the covariance its source states.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    pub captured_at: Timestamp,
    pub position_in_site: Vector3<f64>,
    pub covariance_in_site: Matrix3<f64>,
}

/// A velocity that a vehicle wants its autopilot to fly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityCommand {
    /// The vehicle's clock when it was commanded.
    pub captured_at: Timestamp,
    /// m/s along the heading frame's axes: x horizontally along the vehicle's heading, y to the
    /// left, z up.
    pub velocity_in_heading: Vector3<f64>,
}

/// Bytes that are not a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    #[error("message starts with {got:02x?}, expected {MAGIC:02x?}")]
    Magic { got: [u8; 4] },
    #[error("message kind {got} is unknown")]
    Kind { got: u8 },
    #[error("pixel format {got}, expected {expected}")]
    Format { got: u8, expected: u8 },
    #[error("reserved bytes are {got:02x?}, expected zero")]
    Reserved { got: [u8; 2] },
    #[error("image of {width}×{height}, expected 1 to {SIDE_PX_MAX} pixels a side")]
    ImageSize { width: u32, height: u32 },
    #[error("payload of {got} bytes, expected {expected}")]
    PayloadSize { got: usize, expected: usize },
    /// The one of these after which the next message can be read: its length was right.
    #[error("{what} holds a number that is not finite")]
    NotFinite { what: &'static str },
}

/// Why no message could be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    #[error(transparent)]
    Malformed(#[from] Malformed),
    #[error("stream: {0}")]
    Io(#[from] io::Error),
}

/// Appends the bytes of `message` to `bytes`.
pub fn encode(message: &Message, bytes: &mut Vec<u8>) {
    match message {
        Message::Hello => encode_header(Kind::Hello, Timestamp::default(), 0, bytes),
        Message::End => encode_header(Kind::End, Timestamp::default(), 0, bytes),
        Message::Acknowledgement { captured_at } => {
            encode_header(Kind::Acknowledgement, *captured_at, 0, bytes);
        }
        Message::Frame(frame) => encode_frame(frame.captured_at, &frame.image, bytes),
        Message::Fix(fix) => encode_fix(fix, bytes),
        Message::Velocity(command) => {
            let velocity = &command.velocity_in_heading;
            encode_header(Kind::Velocity, command.captured_at, VELOCITY_BYTES, bytes);
            encode_numbers(velocity.as_slice(), bytes);
        }
    }
}

/// [`encode`] for a frame whose image is borrowed.
pub fn encode_frame(captured_at: Timestamp, image: &Image, bytes: &mut Vec<u8>) {
    let header = Header {
        kind: Kind::Frame,
        format: FORMAT_GREY8,
        captured_at,
        width: image.width() as u32,
        height: image.height() as u32,
        payload_bytes: image.pixels().len(),
    };
    header.encode(bytes);
    bytes.extend_from_slice(image.pixels());
}

/// The first message in `bytes` and its length, or `None` if more bytes are needed.
pub fn decode(bytes: &[u8]) -> Result<Option<(Message, usize)>, Malformed> {
    let Some(header_bytes) = bytes.first_chunk::<HEADER_BYTES>() else {
        return Ok(None);
    };
    let header = Header::decode(header_bytes)?;
    let end = HEADER_BYTES + header.payload_bytes;
    match bytes.get(HEADER_BYTES..end) {
        Some(payload) => Ok(Some((header.message(payload.to_vec())?, end))),
        None => Ok(None),
    }
}

/// Waits for one message. At most [`PAYLOAD_BYTES_MAX`] bytes are buffered.
pub fn read_message(reader: &mut impl Read) -> Result<Message, ReadError> {
    let mut header_bytes = [0; HEADER_BYTES];
    reader.read_exact(&mut header_bytes)?;
    let header = Header::decode(&header_bytes)?;
    let mut payload = vec![0; header.payload_bytes];
    reader.read_exact(&mut payload)?;
    Ok(header.message(payload)?)
}

/// Writes one message in one piece.
pub fn write_message(writer: &mut impl Write, message: &Message) -> io::Result<()> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    writer.write_all(&bytes)?;
    writer.flush()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Kind {
    Hello = 1,
    Frame = 2,
    Fix = 3,
    Acknowledgement = 4,
    End = 5,
    Velocity = 6,
}

impl Kind {
    fn from_byte(byte: u8) -> Result<Self, Malformed> {
        [
            Self::Hello,
            Self::Frame,
            Self::Fix,
            Self::Acknowledgement,
            Self::End,
            Self::Velocity,
        ]
        .into_iter()
        .find(|kind| *kind as u8 == byte)
        .ok_or(Malformed::Kind { got: byte })
    }
}

struct Header {
    kind: Kind,
    format: u8,
    captured_at: Timestamp,
    width: u32,
    height: u32,
    payload_bytes: usize,
}

impl Header {
    fn encode(&self, bytes: &mut Vec<u8>) {
        assert!(self.payload_bytes <= PAYLOAD_BYTES_MAX);
        bytes.reserve(HEADER_BYTES + self.payload_bytes);
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&[self.kind as u8, self.format, 0, 0]);
        bytes.extend_from_slice(&self.captured_at.nanoseconds().to_le_bytes());
        bytes.extend_from_slice(&self.width.to_le_bytes());
        bytes.extend_from_slice(&self.height.to_le_bytes());
        bytes.extend_from_slice(&(self.payload_bytes as u32).to_le_bytes());
    }

    /// Checks everything that can be known before the payload is there.
    fn decode(bytes: &[u8; HEADER_BYTES]) -> Result<Self, Malformed> {
        let magic = array_at::<4>(bytes, 0);
        if magic != MAGIC {
            return Err(Malformed::Magic { got: magic });
        }
        let reserved = array_at::<2>(bytes, 6);
        if reserved != [0, 0] {
            return Err(Malformed::Reserved { got: reserved });
        }
        let header = Self {
            kind: Kind::from_byte(bytes[4])?,
            format: bytes[5],
            captured_at: Timestamp::from_nanoseconds(i64::from_le_bytes(array_at(bytes, 8))),
            width: u32::from_le_bytes(array_at(bytes, 16)),
            height: u32::from_le_bytes(array_at(bytes, 20)),
            payload_bytes: u32::from_le_bytes(array_at(bytes, 24)) as usize,
        };
        header.check()?;
        Ok(header)
    }

    fn check(&self) -> Result<(), Malformed> {
        let is_frame = self.kind == Kind::Frame;
        let expected_format = if is_frame { FORMAT_GREY8 } else { FORMAT_NONE };
        if self.format != expected_format {
            return Err(Malformed::Format {
                got: self.format,
                expected: expected_format,
            });
        }
        let (width, height) = (self.width, self.height);
        let sides = if is_frame { 1..=SIDE_PX_MAX } else { 0..=0 };
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(Malformed::ImageSize { width, height });
        }
        let expected = match self.kind {
            Kind::Frame => width as usize * height as usize,
            Kind::Fix => FIX_BYTES,
            Kind::Velocity => VELOCITY_BYTES,
            Kind::Hello | Kind::Acknowledgement | Kind::End => 0,
        };
        if self.payload_bytes != expected {
            return Err(Malformed::PayloadSize {
                got: self.payload_bytes,
                expected,
            });
        }
        Ok(())
    }

    fn message(&self, payload: Vec<u8>) -> Result<Message, Malformed> {
        let captured_at = self.captured_at;
        Ok(match self.kind {
            Kind::Hello => Message::Hello,
            Kind::End => Message::End,
            Kind::Acknowledgement => Message::Acknowledgement { captured_at },
            Kind::Fix => Message::Fix(decode_fix(captured_at, &payload)?),
            Kind::Velocity => Message::Velocity(decode_velocity(captured_at, &payload)?),
            Kind::Frame => {
                let image = Image::from_pixels(self.width as usize, self.height as usize, payload)
                    .expect("the byte count was checked against the size");
                Message::Frame(Frame { captured_at, image })
            }
        })
    }
}

fn encode_header(kind: Kind, captured_at: Timestamp, payload_bytes: usize, bytes: &mut Vec<u8>) {
    let header = Header {
        kind,
        format: FORMAT_NONE,
        captured_at,
        width: 0,
        height: 0,
        payload_bytes,
    };
    header.encode(bytes);
}

fn encode_fix(fix: &Fix, bytes: &mut Vec<u8>) {
    encode_header(Kind::Fix, fix.captured_at, FIX_BYTES, bytes);
    let (p, c) = (&fix.position_in_site, &fix.covariance_in_site);
    let numbers = [p.x, p.y, p.z, c.m11, c.m12, c.m13, c.m22, c.m23, c.m33];
    encode_numbers(&numbers, bytes);
}

fn encode_numbers(numbers: &[f64], bytes: &mut Vec<u8>) {
    for number in numbers {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
}

fn decode_fix(captured_at: Timestamp, payload: &[u8]) -> Result<Fix, Malformed> {
    let [x, y, z, m11, m12, m13, m22, m23, m33] = decode_numbers(payload, "a fix")?;
    Ok(Fix {
        captured_at,
        position_in_site: Vector3::new(x, y, z),
        covariance_in_site: Matrix3::new(m11, m12, m13, m12, m22, m23, m13, m23, m33),
    })
}

fn decode_velocity(captured_at: Timestamp, payload: &[u8]) -> Result<VelocityCommand, Malformed> {
    Ok(VelocityCommand {
        captured_at,
        velocity_in_heading: Vector3::from(decode_numbers(payload, "a velocity")?),
    })
}

fn decode_numbers<const COUNT: usize>(
    payload: &[u8],
    what: &'static str,
) -> Result<[f64; COUNT], Malformed> {
    let numbers = std::array::from_fn(|idx| f64::from_le_bytes(array_at(payload, 8 * idx)));
    if numbers.iter().all(|number: &f64| number.is_finite()) {
        Ok(numbers)
    } else {
        Err(Malformed::NotFinite { what })
    }
}

fn array_at<const COUNT: usize>(bytes: &[u8], start: usize) -> [u8; COUNT] {
    *bytes[start..]
        .first_chunk()
        .expect("callers pass a start that leaves room")
}

#[cfg(test)]
mod tests;

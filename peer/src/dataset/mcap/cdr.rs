//! ROS messages, field by field.

/// How ROS wrote a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RosEncoding {
    /// ROS 2: numbers are aligned, the first bytes say in which order their bytes are.
    Cdr,
    /// ROS 1: nothing is aligned, and all is little-endian.
    Ros1,
}

pub struct RosReader<'a> {
    bytes: &'a [u8],
    position: usize,
    encoding: RosEncoding,
    is_big_endian: bool,
    alignment_max: usize,
}

/// The message ends before the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageEnds;

/// Bytes before the body, from whose start numbers are aligned.
const ENCAPSULATION_BYTES: usize = 4;

impl<'a> RosReader<'a> {
    pub fn new(encoding: RosEncoding, bytes: &'a [u8]) -> Result<Self, MessageEnds> {
        let mut reader = Self {
            bytes,
            position: 0,
            encoding,
            is_big_endian: false,
            alignment_max: 1,
        };
        if encoding == RosEncoding::Cdr {
            let kind = reader.take(ENCAPSULATION_BYTES)?[1];
            reader.is_big_endian = kind.is_multiple_of(2);
            // From the second version on nothing is aligned to more than four bytes.
            reader.alignment_max = if kind < 6 { 8 } else { 4 };
        }
        Ok(reader)
    }

    pub fn u8(&mut self) -> Result<u8, MessageEnds> {
        Ok(self.take(1)?[0])
    }

    pub fn u32(&mut self) -> Result<u32, MessageEnds> {
        let bytes = self.number()?;
        Ok(if self.is_big_endian {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        })
    }

    pub fn f64(&mut self) -> Result<f64, MessageEnds> {
        let bytes = self.number()?;
        Ok(if self.is_big_endian {
            f64::from_be_bytes(bytes)
        } else {
            f64::from_le_bytes(bytes)
        })
    }

    pub fn f64s(&mut self, count: usize) -> Result<Vec<f64>, MessageEnds> {
        // A damaged count must not ask for the whole memory.
        if count > self.bytes.len() {
            return Err(MessageEnds);
        }
        (0..count).map(|_| self.f64()).collect()
    }

    /// A sequence of bytes after their count.
    pub fn bytes(&mut self) -> Result<&'a [u8], MessageEnds> {
        let count = self.u32()?;
        self.take(count as usize)
    }

    /// Without the zero that ROS 2 ends it with.
    pub fn text(&mut self) -> Result<&'a str, MessageEnds> {
        let bytes = self.bytes()?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(text).map_err(|_| MessageEnds)
    }

    /// `std_msgs/Header`: the stamp in nanoseconds.
    pub fn header_stamp_ns(&mut self) -> Result<i64, MessageEnds> {
        if self.encoding == RosEncoding::Ros1 {
            // A sequence number that nobody sets.
            self.u32()?;
        }
        let seconds = self.u32()?;
        let nanoseconds = self.u32()?;
        // ROS 2 has signed seconds, ROS 1 has not; both are written alike.
        let seconds = match self.encoding {
            RosEncoding::Cdr => i64::from(seconds as i32),
            RosEncoding::Ros1 => i64::from(seconds),
        };
        Ok(seconds * 1_000_000_000 + i64::from(nanoseconds))
    }

    fn number<const SIZE: usize>(&mut self) -> Result<[u8; SIZE], MessageEnds> {
        let alignment = SIZE.min(self.alignment_max);
        if self.encoding == RosEncoding::Cdr {
            let offset = self.position - ENCAPSULATION_BYTES;
            self.position += offset.next_multiple_of(alignment) - offset;
        }
        let mut number = [0; SIZE];
        number.copy_from_slice(self.take(SIZE)?);
        Ok(number)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], MessageEnds> {
        let end = self.position.checked_add(count).ok_or(MessageEnds)?;
        let taken = self.bytes.get(self.position..end).ok_or(MessageEnds)?;
        self.position = end;
        Ok(taken)
    }
}

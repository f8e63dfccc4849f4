//! Writes messages as ROS and protobuf do.

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Style {
    Cdr,
    CdrBigEndian,
    /// The second version of CDR, which aligns to at most four bytes.
    Cdr2,
    Ros1,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field<'a> {
    /// Seconds and nanoseconds.
    Header(u32, u32),
    U8(u8),
    U32(u32),
    F64(f64),
    Text(&'a str),
    Bytes(&'a [u8]),
    /// Of protobuf alone.
    Varint(u64),
}

struct RosWriter {
    style: Style,
    bytes: Vec<u8>,
}

pub fn ros_message(style: Style, fields: &[Field]) -> Vec<u8> {
    let bytes = match style {
        Style::Cdr => vec![0, 1, 0, 0],
        Style::CdrBigEndian => vec![0, 0, 0, 0],
        Style::Cdr2 => vec![0, 7, 0, 0],
        Style::Ros1 => Vec::new(),
    };
    let mut writer = RosWriter { style, bytes };
    for field in fields {
        match *field {
            Field::Header(seconds, nanoseconds) => {
                if style == Style::Ros1 {
                    writer.number(77_u32.to_le_bytes());
                }
                writer.u32(seconds);
                writer.u32(nanoseconds);
            }
            Field::U8(value) => writer.bytes.push(value),
            Field::U32(value) => writer.u32(value),
            Field::F64(value) => writer.number(value.to_le_bytes()),
            Field::Text(text) => {
                let zero: &[u8] = if style == Style::Ros1 { &[] } else { &[0] };
                writer.counted(&[text.as_bytes(), zero].concat());
            }
            Field::Bytes(bytes) => writer.counted(bytes),
            Field::Varint(_) => unreachable!("ROS has no such numbers"),
        }
    }
    writer.bytes
}

impl RosWriter {
    fn u32(&mut self, value: u32) {
        self.number(value.to_le_bytes());
    }

    fn counted(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.bytes.extend_from_slice(bytes);
    }

    fn number<const SIZE: usize>(&mut self, mut little_endian: [u8; SIZE]) {
        let alignment = match self.style {
            Style::Cdr | Style::CdrBigEndian => SIZE,
            Style::Cdr2 => SIZE.min(4),
            Style::Ros1 => 1,
        };
        if self.style != Style::Ros1 {
            while !(self.bytes.len() - 4).is_multiple_of(alignment) {
                self.bytes.push(0xee);
            }
        }
        if self.style == Style::CdrBigEndian {
            little_endian.reverse();
        }
        self.bytes.extend_from_slice(&little_endian);
    }
}

pub fn protobuf_message(fields: &[(u8, Field)]) -> Vec<u8> {
    let mut message = Vec::new();
    for (number, field) in fields {
        let key = |wire: u8| (number << 3) | wire;
        let bytes = match *field {
            Field::Varint(value) => {
                message.push(key(0));
                message.extend(varint(value));
                continue;
            }
            Field::U32(value) => {
                message.push(key(5));
                message.extend(value.to_le_bytes());
                continue;
            }
            Field::Text(text) => text.as_bytes(),
            Field::Bytes(bytes) => bytes,
            _ => unreachable!("not used in protobuf"),
        };
        message.push(key(2));
        message.extend(varint(bytes.len() as u64));
        message.extend_from_slice(bytes);
    }
    message
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

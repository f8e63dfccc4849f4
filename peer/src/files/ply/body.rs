//! The rows after the header, read number by number.

use std::str::SplitWhitespace;

use super::header::{Element, Encoding, Header, Scalar};
use crate::files::error::Refused;

/// The part of a file after its header.
pub enum Body<'a> {
    Ascii {
        lines: std::str::Lines<'a>,
        line: usize,
    },
    Binary {
        bytes: &'a [u8],
        offset_bytes: usize,
        big_endian: bool,
    },
}

/// The numbers of one row, in order.
pub enum Row<'a> {
    Ascii(SplitWhitespace<'a>),
    Binary {
        bytes: &'a [u8],
        offset_bytes: usize,
        big_endian: bool,
    },
}

impl<'a> Body<'a> {
    pub fn new(header: &Header, bytes: &'a [u8]) -> Result<Self, Refused> {
        let bytes = &bytes[header.size_bytes..];
        Ok(match header.encoding {
            Encoding::Ascii => Self::Ascii {
                lines: std::str::from_utf8(bytes)
                    .map_err(|_| Refused::whole("the text after the header is not UTF-8"))?
                    .lines(),
                line: header.line_count,
            },
            Encoding::BinaryLittleEndian => Self::Binary {
                bytes,
                offset_bytes: 0,
                big_endian: false,
            },
            Encoding::BinaryBigEndian => Self::Binary {
                bytes,
                offset_bytes: 0,
                big_endian: true,
            },
        })
    }

    /// Reads the next row with `read`, which must use it up.
    pub fn read_row(
        &mut self,
        element: &Element,
        element_idx: usize,
        read: impl FnOnce(&mut Row<'a>) -> Result<(), String>,
    ) -> Result<(), Refused> {
        let position = || format!("{} {element_idx} of {}", element.name, element.count);
        match self {
            Self::Ascii { lines, line } => {
                let text = loop {
                    *line += 1;
                    let text = lines.next().ok_or_else(|| {
                        Refused::at(*line, format!("truncated before {}", position()))
                    })?;
                    if !text.trim().is_empty() {
                        break text;
                    }
                };
                let mut row = Row::Ascii(text.split_whitespace());
                read(&mut row)
                    .and_then(|()| row.expect_end())
                    .map_err(|reason| Refused::at(*line, format!("{}: {reason}", position())))
            }
            Self::Binary {
                bytes,
                offset_bytes,
                big_endian,
            } => {
                let mut row = Row::Binary {
                    bytes,
                    offset_bytes: *offset_bytes,
                    big_endian: *big_endian,
                };
                read(&mut row)
                    .map_err(|reason| Refused::whole(format!("{}: {reason}", position())))?;
                if let Row::Binary {
                    offset_bytes: end, ..
                } = row
                {
                    *offset_bytes = end;
                }
                Ok(())
            }
        }
    }
}

impl Row<'_> {
    pub fn value(&mut self, scalar: Scalar) -> Result<f64, String> {
        match self {
            Self::Ascii(words) => {
                let word = words.next().ok_or("truncated: too few numbers")?;
                word.parse().map_err(|_| format!("{word:?} is no number"))
            }
            Self::Binary {
                bytes,
                offset_bytes,
                big_endian,
            } => {
                let end = *offset_bytes + scalar.size_bytes();
                let raw = bytes
                    .get(*offset_bytes..end)
                    .ok_or("truncated: the file ends before it")?;
                *offset_bytes = end;
                let mut little = [0; 8];
                little[..raw.len()].copy_from_slice(raw);
                if *big_endian {
                    little[..raw.len()].reverse();
                }
                Ok(decode(scalar, little))
            }
        }
    }

    /// The length of a list.
    pub fn count(&mut self, scalar: Scalar) -> Result<usize, String> {
        let value = self.value(scalar)?;
        if value >= 0.0 && value.fract() == 0.0 && value <= f64::from(u32::MAX) {
            Ok(value as usize)
        } else {
            Err(format!("{value} is no length of a list"))
        }
    }

    fn expect_end(&mut self) -> Result<(), String> {
        match self {
            Self::Ascii(words) => match words.next() {
                Some(word) => Err(format!("{word:?} after the last number")),
                None => Ok(()),
            },
            Self::Binary { .. } => Ok(()),
        }
    }
}

fn decode(scalar: Scalar, little: [u8; 8]) -> f64 {
    let bits = u64::from_le_bytes(little);
    match scalar {
        Scalar::Int8 => f64::from(bits as i8),
        Scalar::Uint8 => f64::from(bits as u8),
        Scalar::Int16 => f64::from(bits as i16),
        Scalar::Uint16 => f64::from(bits as u16),
        Scalar::Int32 => f64::from(bits as i32),
        Scalar::Uint32 => f64::from(bits as u32),
        Scalar::Float32 => f64::from(f32::from_bits(bits as u32)),
        Scalar::Float64 => f64::from_bits(bits),
    }
}

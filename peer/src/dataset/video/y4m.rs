//! YUV4MPEG2, the plain form of video that tools pass to each other.

use std::io::{BufRead, Read};

use crate::dataset::decode::{Raster, RasterKind, SIDE_MAX_PX, Samples};

pub const SIGNATURE: &[u8] = b"YUV4MPEG2 ";

/// What stands before the frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Y4mHeader {
    pub width: usize,
    pub height: usize,
    /// Frames per so many seconds: numerator and denominator.
    pub rate: (u64, u64),
    bit_count: u32,
    /// Of colour, after the brightness.
    colour_values: usize,
}

/// Lines are parameters; longer ones are taken for damage.
const LINE_MAX_BYTES: u64 = 4096;

impl Y4mHeader {
    /// Reads the first line.
    pub fn read(input: &mut impl BufRead) -> Result<Self, String> {
        let line = read_line(input)?.ok_or("it is empty")?;
        let parameters = line
            .strip_prefix("YUV4MPEG2")
            .ok_or("it does not begin with YUV4MPEG2")?;
        let (mut width, mut height, mut rate, mut colour) = (0, 0, (0, 0), "420");
        for parameter in parameters.split_ascii_whitespace() {
            let (tag, value) = parameter.split_at_checked(1).unwrap_or_default();
            let number = || {
                value
                    .parse()
                    .map_err(|_| format!("parameter {parameter:?}"))
            };
            match tag {
                "W" => width = number()?,
                "H" => height = number()?,
                "C" => colour = value,
                "F" => {
                    let numbers = value.split_once(':');
                    let numbers = numbers
                        .and_then(|(top, bottom)| Some((top.parse().ok()?, bottom.parse().ok()?)));
                    rate = numbers.ok_or_else(|| format!("parameter {parameter:?}"))?;
                }
                _ => {}
            }
        }
        let sides = 1..=SIDE_MAX_PX;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(format!("a size of {width}×{height}"));
        }
        let (bit_count, colour_values) = planes(colour, width, height)
            .ok_or_else(|| format!("colour space {colour:?} is not supported"))?;
        Ok(Self {
            width,
            height,
            rate,
            bit_count,
            colour_values,
        })
    }

    fn value_bytes(&self) -> usize {
        if self.bit_count > 8 { 2 } else { 1 }
    }

    /// Of a frame without its own line.
    pub fn frame_bytes(&self) -> usize {
        (self.width * self.height + self.colour_values) * self.value_bytes()
    }

    /// The next frame's brightness; `None` at the end.
    pub fn read_frame(&self, input: &mut impl BufRead) -> Result<Option<Raster>, String> {
        if !read_frame_line(input)? {
            return Ok(None);
        }
        let mut luma = vec![0; self.width * self.height * self.value_bytes()];
        let ends = |_| "it ends in a frame".to_owned();
        input.read_exact(&mut luma).map_err(ends)?;
        let rest = (self.frame_bytes() - luma.len()) as u64;
        let skipped = std::io::copy(&mut input.take(rest), &mut std::io::sink());
        if skipped.ok() != Some(rest) {
            return Err("it ends in a frame".to_owned());
        }
        if self.bit_count > 8 {
            let shift = self.bit_count - 8;
            let values = luma.as_chunks().0.iter().copied().map(u16::from_le_bytes);
            luma = values
                .map(|value| (value >> shift).min(255) as u8)
                .collect();
        }
        Ok(Some(Raster {
            width: self.width,
            height: self.height,
            samples: Samples::Eight(luma),
            kind: RasterKind::Colour,
        }))
    }
}

/// Whether there is a frame: its line is `FRAME` with parameters that nobody uses.
pub fn read_frame_line(input: &mut impl BufRead) -> Result<bool, String> {
    match read_line(input)? {
        None => Ok(false),
        Some(line) if line.starts_with("FRAME") => Ok(true),
        Some(_) => Err("a frame does not begin with FRAME".to_owned()),
    }
}

fn read_line(input: &mut impl BufRead) -> Result<Option<String>, String> {
    let mut line = Vec::new();
    let read = input.take(LINE_MAX_BYTES).read_until(b'\n', &mut line);
    match read {
        Err(error) => Err(error.to_string()),
        Ok(0) => Ok(None),
        Ok(_) if line.last() != Some(&b'\n') => Err("it ends in a line".to_owned()),
        Ok(_) => Ok(Some(String::from_utf8_lossy(&line).trim_end().to_owned())),
    }
}

/// Bits of a value, and values of colour in a frame.
fn planes(colour: &str, width: usize, height: usize) -> Option<(u32, usize)> {
    let halved = |side: usize| side.div_ceil(2);
    let (name, bits) = match colour.strip_prefix("mono") {
        Some(bits) => ("mono", bits),
        None => match colour.split_at_checked(3) {
            Some((name, rest)) => (name, rest.strip_prefix('p').unwrap_or("")),
            None => return None,
        },
    };
    // `420paldv` and the like are about where colours are.
    let bit_count = match bits {
        "" => 8,
        bits => bits.parse().unwrap_or(8),
    };
    if !(8..=16).contains(&bit_count) {
        return None;
    }
    let colour_values = match name {
        "mono" => 0,
        "420" => 2 * halved(width) * halved(height),
        "422" => 2 * halved(width) * height,
        "411" => 2 * width.div_ceil(4) * height,
        "444" if colour == "444alpha" => 3 * width * height,
        "444" => 2 * width * height,
        _ => return None,
    };
    Some((bit_count, colour_values))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A film of frames that are even, each a shade brighter.
    fn film(header: &str, value_bytes: usize, colour_values: usize) -> Vec<u8> {
        let mut bytes = format!("YUV4MPEG2 {header}\n").into_bytes();
        for frame in 1..4_u8 {
            bytes.extend_from_slice(b"FRAME Ip\n");
            for _ in 0..15 {
                bytes.push(frame * 10);
                bytes.resize(bytes.len() + value_bytes - 1, 1);
            }
            bytes.resize(bytes.len() + colour_values * value_bytes, 99);
        }
        bytes
    }

    #[test]
    fn reads_the_brightness_of_every_colour_space() {
        let check = |header: &str, value_bytes, colour_values, expected: [u8; 3]| {
            let bytes = film(header, value_bytes, colour_values);
            let mut input = bytes.as_slice();
            let header = Y4mHeader::read(&mut input).unwrap();
            for shade in expected {
                let raster = header.read_frame(&mut input).unwrap().unwrap();
                assert_eq!(raster.size_px(), (5, 3));
                assert_eq!(
                    raster.samples,
                    Samples::Eight(vec![shade; 15]),
                    "{header:?}"
                );
            }
            assert_eq!(header.read_frame(&mut input), Ok(None));
        };
        let plain = [10, 20, 30];
        check("W5 H3 F30:1 Ip A1:1 C420jpeg", 1, 12, plain);
        check("W5 H3 F30000:1001", 1, 12, plain);
        check("W5 H3 F25:1 C422", 1, 18, plain);
        check("W5 H3 F25:1 C444", 1, 30, plain);
        check("W5 H3 F25:1 C444alpha", 1, 45, plain);
        check("W5 H3 F25:1 C411", 1, 12, plain);
        check("W5 H3 F25:1 Cmono XCOLORRANGE=FULL", 1, 0, plain);
        // The bytes are 10, 1 and so on: 266 of 1023.
        check("W5 H3 F25:1 C420p10 XYSCSS=420P10", 2, 12, [66, 69, 71]);
        check("W5 H3 F25:1 Cmono16", 2, 0, [1, 1, 1]);
    }

    #[test]
    fn damage_is_named() {
        let check = |bytes: &[u8], expected: &str| {
            let mut input = bytes;
            let header = Y4mHeader::read(&mut input);
            let error = header.and_then(|header| header.read_frame(&mut input));
            let error = error.unwrap_err();
            assert!(error.contains(expected), "{error}");
        };
        check(b"", "it is empty");
        check(b"RIFF\n", "does not begin");
        check(b"YUV4MPEG2 W5", "it ends in a line");
        check(b"YUV4MPEG2 W5 H0\n", "a size of 5×0");
        check(b"YUV4MPEG2 W5 Hx\n", "parameter \"Hx\"");
        check(b"YUV4MPEG2 W5 H3 Fast\n", "parameter \"Fast\"");
        check(b"YUV4MPEG2 W5 H3 C999\n", "colour space \"999\"");
        check(b"YUV4MPEG2 W5 H3\nFROG\n", "does not begin with FRAME");
        check(b"YUV4MPEG2 W5 H3\nFRAME\nabc", "it ends in a frame");
    }
}

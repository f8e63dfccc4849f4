//! PGM and PPM in their binary kinds (`P5`, `P6`), as small cameras and their tools write them.

use super::colour::{luma, luma_of_bytes};
use super::{ImageError, Raster, RasterKind, SIDE_MAX_PX, Samples};

/// What stands before the pixels.
struct Header<'a> {
    width: usize,
    height: usize,
    channel_count: usize,
    value_max: usize,
    pixels: &'a [u8],
}

/// Whether these bytes begin as a binary PGM or PPM does.
pub fn is_pnm(bytes: &[u8]) -> bool {
    matches!(bytes, [b'P', b'5' | b'6', separator, ..] if separator.is_ascii_whitespace())
}

/// Values are scaled to what the header says is the largest; where that is all 16 bits, cameras
/// with fewer say so too, and the values are kept. What follows the first image is not looked at.
pub fn decode(bytes: &[u8]) -> Result<Raster, ImageError> {
    let Header {
        width,
        height,
        channel_count,
        value_max,
        pixels,
    } = read_header(bytes)?;
    let value_size_bytes = if value_max > 255 { 2 } else { 1 };
    let expected_bytes = width * height * channel_count * value_size_bytes;
    let values = pixels.get(..expected_bytes).ok_or_else(|| {
        ImageError::Pnm(format!(
            "{} bytes of pixels, expected {expected_bytes}",
            pixels.len()
        ))
    })?;
    let wide = || values.as_chunks().0.iter().copied().map(u16::from_be_bytes);
    let scaled = |value: usize| ((value.min(value_max) * 255 + value_max / 2) / value_max) as u8;
    let samples = match value_max {
        65535 => Samples::Sixteen {
            values: grey_of_sixteen(wide().collect(), channel_count),
            bit_count: None,
        },
        256.. => {
            let bytes = wide().map(|value| scaled(usize::from(value)));
            Samples::Eight(grey_of_eight(bytes.collect(), channel_count))
        }
        _ => {
            let bytes = values.iter().map(|value| scaled(usize::from(*value)));
            Samples::Eight(grey_of_eight(bytes.collect(), channel_count))
        }
    };
    let kind = match channel_count {
        1 => RasterKind::Grey,
        _ => RasterKind::Colour,
    };
    Ok(Raster {
        width,
        height,
        samples,
        kind,
    })
}

fn grey_of_eight(values: Vec<u8>, channel_count: usize) -> Vec<u8> {
    match channel_count {
        1 => values,
        _ => values.chunks_exact(3).map(luma_of_bytes).collect(),
    }
}

fn grey_of_sixteen(values: Vec<u16>, channel_count: usize) -> Vec<u16> {
    match channel_count {
        1 => values,
        _ => {
            let pixels = values.chunks_exact(3);
            let grey = pixels.map(|pixel| luma([pixel[0], pixel[1], pixel[2]]));
            grey.collect()
        }
    }
}

fn read_header(bytes: &[u8]) -> Result<Header<'_>, ImageError> {
    let damaged = |what: &str| ImageError::Pnm(what.to_owned());
    let channel_count = if bytes.starts_with(b"P6") { 3 } else { 1 };
    let mut rest = bytes.get(2..).ok_or_else(|| damaged("no header"))?;
    let mut numbers = [0; 3];
    for number in &mut numbers {
        rest = skip_blanks(rest);
        let end = rest.iter().position(|byte| !byte.is_ascii_digit());
        let (digits, after) = rest.split_at(end.ok_or_else(|| damaged("the header ends early"))?);
        let digits = std::str::from_utf8(digits).unwrap_or_default();
        *number = digits
            .parse()
            .map_err(|_| damaged("no number in the header"))?;
        rest = after;
    }
    let [width, height, value_max] = numbers;
    let sides = 1..=SIDE_MAX_PX;
    if !sides.contains(&width) || !sides.contains(&height) {
        return Err(ImageError::Pnm(format!("a size of {width}×{height}")));
    }
    if !(1..=65535).contains(&value_max) {
        return Err(ImageError::Pnm(format!("a largest value of {value_max}")));
    }
    // Exactly one blank ends the header.
    let pixels = rest
        .get(1..)
        .ok_or_else(|| damaged("the header ends early"))?;
    Ok(Header {
        width,
        height,
        channel_count,
        value_max,
        pixels,
    })
}

/// Skips blanks, and comments up to the ends of their lines.
fn skip_blanks(mut bytes: &[u8]) -> &[u8] {
    loop {
        bytes = match bytes {
            [b'#', ..] => {
                let end = bytes.iter().position(|byte| *byte == b'\n');
                &bytes[end.unwrap_or(bytes.len())..]
            }
            [blank, rest @ ..] if blank.is_ascii_whitespace() => rest,
            _ => return bytes,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::super::BitDepth;
    use super::*;

    #[test]
    fn reads_grey_and_colour_and_scales_to_eight_bits() {
        let cases: [(&[u8], [u8; 2]); 4] = [
            (b"P5 2 1 255\n\x07\xff", [7, 255]),
            (b"P5\n# by a camera\n2 1\n15\n\x03\x0f", [51, 255]),
            (b"P5 2 1 65535\n\x12\x34\xff\xff", [18, 255]),
            (b"P6 2 1 255\n\x09\x09\x09\xff\xff\xff and more", [9, 255]),
        ];
        for (bytes, expected) in cases {
            assert!(is_pnm(bytes));
            let raster = decode(bytes).unwrap();
            assert_eq!(raster.size_px(), (2, 1));
            let image = raster.into_image(BitDepth::FULL, false);
            assert_eq!(image.pixels(), expected);
        }
    }

    #[test]
    fn damage_is_named() {
        let cases: [(&[u8], &str); 6] = [
            (b"P5 2 1 255\n\x07", "1 bytes of pixels, expected 2"),
            (b"P5 2 1 255", "the header ends early"),
            (b"P5 2 x 255\n", "no number in the header"),
            (b"P5 0 1 255\n", "a size of 0×1"),
            (b"P5 99999 1 255\n", "a size of 99999×1"),
            (b"P5 2 1 0\n\x00\x00", "a largest value of 0"),
        ];
        for (bytes, expected) in cases {
            let error = decode(bytes).unwrap_err().to_string();
            assert_eq!(error, format!("damaged PGM or PPM: {expected}"));
        }
        for length in 0..12 {
            assert!(decode(&b"P6 2 1 255\n\x09"[..length]).is_err());
        }
    }
}

//! PNG of every kind to grey.

use std::io::Cursor;

use png::{BitDepth, ColorType, Transformations};

use super::colour::{luma, luma_of_bytes};
use super::{ImageError, Raster, RasterKind, SIDE_MAX_PX, Samples};

pub const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

pub fn decode(bytes: &[u8]) -> Result<Raster, ImageError> {
    // 16 bit colour with alpha needs eight bytes a pixel.
    let limits = png::Limits {
        bytes: 8 * SIDE_MAX_PX * SIDE_MAX_PX,
    };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let significant = reader.info().sbit.as_ref().and_then(|bits| bits.first());
    let bit_count = significant.map(|bits| u32::from(*bits).clamp(1, 16));
    let size_bytes = reader
        .output_buffer_size()
        .ok_or(png::DecodingError::LimitsExceeded)?;
    let mut pixels = vec![0; size_bytes];
    let frame = reader.next_frame(&mut pixels)?;
    pixels.truncate(frame.buffer_size());
    let channel_count = frame.color_type.samples();
    let samples = if frame.bit_depth == BitDepth::Sixteen {
        let values = pixels.as_chunks().0.iter().copied().map(u16::from_be_bytes);
        Samples::Sixteen {
            values: grey_of_sixteen(values.collect(), channel_count),
            bit_count,
        }
    } else {
        Samples::Eight(grey_of_eight(pixels, channel_count))
    };
    let kind = match frame.color_type {
        ColorType::Grayscale | ColorType::GrayscaleAlpha => RasterKind::Grey,
        ColorType::Indexed | ColorType::Rgb | ColorType::Rgba => RasterKind::Colour,
    };
    Ok(Raster {
        width: frame.width as usize,
        height: frame.height as usize,
        samples,
        kind,
    })
}

fn grey_of_eight(pixels: Vec<u8>, channel_count: usize) -> Vec<u8> {
    match channel_count {
        1 => pixels,
        2 => pixels.chunks_exact(2).map(|pixel| pixel[0]).collect(),
        _ => {
            let pixels = pixels.chunks_exact(channel_count);
            pixels.map(luma_of_bytes).collect()
        }
    }
}

fn grey_of_sixteen(values: Vec<u16>, channel_count: usize) -> Vec<u16> {
    match channel_count {
        1 => values,
        2 => values.chunks_exact(2).map(|pixel| pixel[0]).collect(),
        _ => {
            let pixels = values.chunks_exact(channel_count);
            let grey = pixels.map(|pixel| luma([pixel[0], pixel[1], pixel[2]]));
            grey.collect()
        }
    }
}

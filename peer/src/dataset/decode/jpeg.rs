//! JPEG to grey.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::colour::luma_of_bytes;
use super::{ImageError, Raster, RasterKind, SIDE_MAX_PX, Samples};

pub const SIGNATURE: &[u8] = b"\xff\xd8\xff";
const END: [u8; 2] = [0xff, 0xd9];
/// Cameras pad their JPEGs; the end marker is looked for this far from the end.
const PADDING_MAX_BYTES: usize = 4096;

pub fn decode(bytes: &[u8]) -> Result<Raster, ImageError> {
    // The decoder fills what is missing with grey; half an image must not look like a whole one.
    let tail = &bytes[bytes.len().saturating_sub(PADDING_MAX_BYTES)..];
    if !tail.windows(2).any(|pair| pair == END) {
        return Err(ImageError::TruncatedJpeg);
    }
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options());
    decoder.decode_headers().map_err(damage)?;
    let (width, height) = decoder.dimensions().unwrap_or_default();
    let input = decoder.input_colorspace();
    let has_luma = matches!(input, Some(ColorSpace::YCbCr | ColorSpace::Luma));
    let output = if has_luma {
        ColorSpace::Luma
    } else {
        ColorSpace::RGB
    };
    decoder.set_options(options().jpeg_set_out_colorspace(output));
    let pixels = decoder.decode().map_err(damage)?;
    let grey = if has_luma {
        pixels
    } else {
        pixels.chunks_exact(3).map(luma_of_bytes).collect()
    };
    if grey.len() != width * height {
        let reason = format!("{} pixels for {width}×{height}", grey.len());
        return Err(ImageError::Jpeg(reason));
    }
    Ok(Raster {
        width,
        height,
        samples: Samples::Eight(grey),
        kind: match input {
            Some(ColorSpace::Luma) => RasterKind::Grey,
            _ => RasterKind::Colour,
        },
    })
}

fn options() -> DecoderOptions {
    DecoderOptions::default()
        .set_max_width(SIDE_MAX_PX)
        .set_max_height(SIDE_MAX_PX)
}

fn damage(error: impl std::fmt::Display) -> ImageError {
    ImageError::Jpeg(error.to_string())
}

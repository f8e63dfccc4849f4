//! PNG, JPEG, PGM and PPM bytes to grey images.

mod pnm;

use std::io::Cursor;

use camera::Image;
use png::{ColorType, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Why an image is skipped.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    #[error("cannot read the file: {0}")]
    File(std::io::Error),
    #[error("a folder, pipe or device, expected a file")]
    NoFile,
    #[error("a file of {got_bytes} bytes, expected at most {IMAGE_BYTES_MAX}")]
    TooLarge { got_bytes: u64 },
    #[error("neither PNG, JPEG, PGM nor PPM")]
    UnknownFormat,
    #[error("damaged PNG: {0}")]
    Png(#[from] png::DecodingError),
    #[error("damaged PGM or PPM: {0}")]
    Pnm(String),
    #[error("damaged JPEG: {0}")]
    Jpeg(String),
    #[error("JPEG ends before its end marker")]
    TruncatedJpeg,
    #[error(
        "image of {got_width}×{got_height}, the calibration is for \
         {expected_width}×{expected_height}"
    )]
    Size {
        got_width: usize,
        got_height: usize,
        expected_width: usize,
        expected_height: usize,
    },
}

/// No image file is read that is longer.
pub const IMAGE_BYTES_MAX: u64 = 1 << 28;

/// The longest side that is decoded: a damaged header must not ask for the whole memory.
const SIDE_MAX_PX: usize = 16384;

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
const JPEG_SIGNATURE: &[u8] = b"\xff\xd8\xff";
const JPEG_END: [u8; 2] = [0xff, 0xd9];
/// Cameras pad their JPEGs; the end marker is looked for this far from the end.
const JPEG_PADDING_MAX_BYTES: usize = 4096;

/// Width and height from the header alone.
pub fn image_size(bytes: &[u8]) -> Result<(usize, usize), ImageError> {
    if bytes.starts_with(PNG_SIGNATURE) {
        let mut decoder = png::Decoder::new(Cursor::new(bytes));
        let header = decoder.read_header_info()?;
        Ok((header.width as usize, header.height as usize))
    } else if bytes.starts_with(JPEG_SIGNATURE) {
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), jpeg_options());
        decoder.decode_headers().map_err(jpeg_error)?;
        Ok(decoder.dimensions().unwrap_or_default())
    } else if pnm::is_pnm(bytes) {
        pnm::size(bytes)
    } else {
        Err(ImageError::UnknownFormat)
    }
}

/// Decodes PNG (1 to 16 bits, grey or colour), JPEG, or binary PGM or PPM to grey.
///
/// Of 16 bits the upper eight are kept. Colours are weighted as in Rec. 601; alpha is ignored.
pub fn decode_grey(bytes: &[u8]) -> Result<Image, ImageError> {
    if bytes.starts_with(PNG_SIGNATURE) {
        decode_png(bytes)
    } else if bytes.starts_with(JPEG_SIGNATURE) {
        decode_jpeg(bytes)
    } else if pnm::is_pnm(bytes) {
        pnm::decode(bytes)
    } else {
        Err(ImageError::UnknownFormat)
    }
}

fn decode_png(bytes: &[u8]) -> Result<Image, ImageError> {
    // 16 bit colour with alpha needs eight bytes a pixel.
    let limits = png::Limits {
        bytes: 8 * SIDE_MAX_PX * SIDE_MAX_PX,
    };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
    let mut reader = decoder.read_info()?;
    let size_bytes = reader
        .output_buffer_size()
        .ok_or(png::DecodingError::LimitsExceeded)?;
    let mut pixels = vec![0; size_bytes];
    let frame = reader.next_frame(&mut pixels)?;
    pixels.truncate(frame.buffer_size());
    let grey = match frame.color_type {
        ColorType::Grayscale | ColorType::Indexed => pixels,
        ColorType::GrayscaleAlpha => pixels.chunks_exact(2).map(|pixel| pixel[0]).collect(),
        ColorType::Rgb => pixels.chunks_exact(3).map(luma).collect(),
        ColorType::Rgba => pixels.chunks_exact(4).map(luma).collect(),
    };
    Ok(grey_image(
        frame.width as usize,
        frame.height as usize,
        grey,
    ))
}

fn decode_jpeg(bytes: &[u8]) -> Result<Image, ImageError> {
    // The decoder fills what is missing with grey; half an image must not look like a whole one.
    let tail = &bytes[bytes.len().saturating_sub(JPEG_PADDING_MAX_BYTES)..];
    if !tail.windows(2).any(|pair| pair == JPEG_END) {
        return Err(ImageError::TruncatedJpeg);
    }
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), jpeg_options());
    decoder.decode_headers().map_err(jpeg_error)?;
    let (width, height) = decoder.dimensions().unwrap_or_default();
    let has_luma = matches!(
        decoder.input_colorspace(),
        Some(ColorSpace::YCbCr | ColorSpace::Luma)
    );
    let output = if has_luma {
        ColorSpace::Luma
    } else {
        ColorSpace::RGB
    };
    decoder.set_options(jpeg_options().jpeg_set_out_colorspace(output));
    let pixels = decoder.decode().map_err(jpeg_error)?;
    let grey = if has_luma {
        pixels
    } else {
        pixels.chunks_exact(3).map(luma).collect()
    };
    if grey.len() != width * height {
        let reason = format!("{} pixels for {width}×{height}", grey.len());
        return Err(ImageError::Jpeg(reason));
    }
    Ok(grey_image(width, height, grey))
}

fn jpeg_options() -> DecoderOptions {
    DecoderOptions::default()
        .set_max_width(SIDE_MAX_PX)
        .set_max_height(SIDE_MAX_PX)
}

fn jpeg_error(error: impl std::fmt::Display) -> ImageError {
    ImageError::Jpeg(error.to_string())
}

/// The grey of a colour, weighted as in Rec. 601 with weights out of 256.
fn luma(pixel: &[u8]) -> u8 {
    let [red, green, blue] = [pixel[0], pixel[1], pixel[2]].map(u32::from);
    ((77 * red + 150 * green + 29 * blue + 128) >> 8) as u8
}

fn grey_image(width: usize, height: usize, grey: Vec<u8>) -> Image {
    Image::from_pixels(width, height, grey)
        .expect("the decoder gives one byte for each pixel of the size that it reports")
}

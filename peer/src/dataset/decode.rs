//! PNG, JPEG, PGM, PPM and raw pixels to grey images.

mod colour;
mod jpeg;
mod mosaic;
mod png;
mod pnm;
mod raster;
mod raw;

use camera::Image;

pub use raster::{BitDepth, Raster, RasterKind, Samples};
pub use raw::RawImage;
pub use raw::decode as decode_raw;

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
    Png(#[from] ::png::DecodingError),
    #[error("damaged PGM or PPM: {0}")]
    Pnm(String),
    #[error("damaged JPEG: {0}")]
    Jpeg(String),
    #[error("JPEG ends before its end marker")]
    TruncatedJpeg,
    #[error("damaged image: {0}")]
    Raw(String),
    #[error(
        "encoding {got:?} is not supported, expected mono, rgb, bgr, rgba, bgra, bayer, yuv422 \
         or nv12"
    )]
    Encoding { got: String },
    #[error("damaged message: {0}")]
    Message(String),
    #[error("the recording ends before this image: {0}")]
    Ended(String),
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
pub const SIDE_MAX_PX: usize = 16384;

/// Decodes PNG (1 to 16 bits, grey or colour), JPEG, or binary PGM or PPM to grey.
///
/// Colours are weighted as in Rec. 601; alpha is ignored.
pub fn decode(bytes: &[u8]) -> Result<Raster, ImageError> {
    if bytes.starts_with(png::SIGNATURE) {
        png::decode(bytes)
    } else if bytes.starts_with(jpeg::SIGNATURE) {
        jpeg::decode(bytes)
    } else if pnm::is_pnm(bytes) {
        pnm::decode(bytes)
    } else {
        Err(ImageError::UnknownFormat)
    }
}

/// [`decode`] of a single image, of whose 16 bits the upper eight are kept.
pub fn decode_grey(bytes: &[u8]) -> Result<Image, ImageError> {
    Ok(decode(bytes)?.into_image(BitDepth::FULL, false))
}

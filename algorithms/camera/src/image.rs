//! Grey images.

use std::fmt;

/// A grey image, 8 bits a pixel, row by row from the top left, without padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// The number of bytes is not width × height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSizeMismatch {
    pub width: usize,
    pub height: usize,
    pub got_bytes: usize,
}

impl fmt::Display for ImageSizeMismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            width,
            height,
            got_bytes,
        } = self;
        write!(
            f,
            "image of {width}×{height} needs {} bytes, got {got_bytes}",
            width * height
        )
    }
}

impl std::error::Error for ImageSizeMismatch {}

impl Image {
    /// An image of one shade.
    pub fn filled(width: usize, height: usize, shade: u8) -> Self {
        Self {
            width,
            height,
            pixels: vec![shade; width * height],
        }
    }

    /// An image over these pixels.
    pub fn from_pixels(
        width: usize,
        height: usize,
        pixels: Vec<u8>,
    ) -> Result<Self, ImageSizeMismatch> {
        if width.checked_mul(height) != Some(pixels.len()) {
            return Err(ImageSizeMismatch {
                width,
                height,
                got_bytes: pixels.len(),
            });
        }
        Ok(Self {
            width,
            height,
            pixels,
        })
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// Row `y` from the top.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel in column `x` and row `y`.
    pub fn get(&self, x: usize, y: usize) -> u8 {
        self.pixels[y * self.width + x]
    }

    /// The buffer, to be filled again.
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }
}

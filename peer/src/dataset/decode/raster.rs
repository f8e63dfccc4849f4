//! A decoded image whose values have not been brought to 8 bits yet.

use camera::Image;

use super::mosaic;

/// Grey values, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    pub width: usize,
    pub height: usize,
    pub samples: Samples,
    pub kind: RasterKind,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    Eight(Vec<u8>),
    Sixteen {
        values: Vec<u16>,
        /// How many bits are said to mean something: the values may fill them from below, or may
        /// have been scaled to all 16.
        bit_count: Option<u32>,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RasterKind {
    /// One channel, which a calibration may call a mosaic.
    Grey,
    /// Made of colours.
    Colour,
    /// One channel of a mosaic of colours.
    Mosaic,
}

/// How many of 16 bits the values of a recording fill. Of these the upper eight are kept.
///
/// One for all images: they would flicker otherwise, and exposure would be hidden.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitDepth(u32);

impl BitDepth {
    pub const FULL: Self = Self(16);

    /// - `bits_needed`: the most that any of the images needs.
    pub fn of(bits_needed: Option<u32>) -> Self {
        Self(bits_needed.unwrap_or(16).clamp(8, 16))
    }

    fn eight(self, value: u16) -> u8 {
        (value >> (self.0 - 8)).min(255) as u8
    }
}

impl Raster {
    pub fn size_px(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// `None` of 8-bit images: they are as they are.
    pub fn bits_needed(&self) -> Option<u32> {
        let Samples::Sixteen { values, bit_count } = &self.samples else {
            return None;
        };
        let highest = values.iter().max().copied().unwrap_or_default();
        let needed = u16::BITS - highest.leading_zeros();
        Some(match bit_count {
            Some(bit_count) if needed <= *bit_count => *bit_count,
            _ => needed,
        })
    }

    /// The image in 8 bits.
    ///
    /// - `grey_is_mosaic`: the calibration says so.
    pub fn into_image(self, depth: BitDepth, grey_is_mosaic: bool) -> Image {
        let (width, height) = self.size_px();
        let pixels = match self.samples {
            Samples::Eight(pixels) => pixels,
            Samples::Sixteen { values, .. } => {
                values.into_iter().map(|value| depth.eight(value)).collect()
            }
        };
        let image = Image::from_pixels(width, height, pixels)
            .expect("decoders give one value for each pixel of the size that they report");
        match self.kind {
            RasterKind::Mosaic => mosaic::grey_from_mosaic(&image),
            RasterKind::Grey if grey_is_mosaic => mosaic::grey_from_mosaic(&image),
            RasterKind::Grey | RasterKind::Colour => image,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sixteen(values: &[u16], bit_count: Option<u32>) -> Raster {
        Raster {
            width: values.len(),
            height: 1,
            samples: Samples::Sixteen {
                values: values.to_vec(),
                bit_count,
            },
            kind: RasterKind::Grey,
        }
    }

    #[test]
    fn the_depth_is_the_least_that_holds_all_values() {
        let check = |rasters: &[Raster], value: u16, expected: u8| {
            let depth = BitDepth::of(rasters.iter().filter_map(Raster::bits_needed).max());
            let image = sixteen(&[value], None).into_image(depth, false);
            assert_eq!(image.pixels(), [expected], "{depth:?}");
        };
        let ten_bits = [sixteen(&[3, 700], None), sixteen(&[1023, 9], None)];
        check(&ten_bits, 1020, 255);
        // A later, brighter image saturates instead of starting again from black.
        check(&ten_bits, 5000, 255);
        check(&[sixteen(&[3000], None)], 2048, 128);
        check(&[sixteen(&[40_000], None)], 0x1234, 0x12);
        // Dark images of a camera that says how many bits it has.
        check(&[sixteen(&[100], Some(12))], 160, 10);
        // Scaled to 16 bits, as PNG wants it, the same numbers mean something else.
        check(&[sixteen(&[50_000], Some(12))], 0x1234, 0x12);
        check(&[sixteen(&[5], None)], 5, 5);
        check(&[], 0x1234, 0x12);
    }
}

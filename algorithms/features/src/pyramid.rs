//! The image at several scales.

use camera::Image;

use crate::plane::Plane;
use crate::simd::{InstructionSet, multiversion};

/// Positions on larger levels would not fit in 32 bits with their fractions.
const SIDE_PX_MAX: usize = 16384;

/// Bits of the weights of the interpolation.
const WEIGHT_BITS: u32 = 8;

/// An image at ever coarser scales, each resampled from the one before.
///
/// Pixel (x, y) of a level lies at `(x + ½) s - ½` of the image, with `s` the exact scale of the
/// level: no rounding of sizes bends the coordinates.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pyramid {
    levels: Vec<Plane>,
    level_count: usize,
    columns: Vec<Tap>,
    /// One row between the vertical and the horizontal pass.
    row: Vec<u8>,
}

/// Two neighbours and the weight of the second.
#[derive(Clone, Copy, Debug, Default)]
struct Tap {
    first: u32,
    second_weight: u32,
}

/// Which levels a pyramid has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PyramidShape {
    /// Image pixels per pixel of level 0.
    pub(crate) finest_scale: f64,
    pub(crate) scale_factor: f64,
    pub(crate) level_count_max: usize,
    /// Levels smaller than this in either direction are left out.
    pub(crate) side_px_min: usize,
}

impl PyramidShape {
    pub(crate) fn scale(&self, level: usize) -> f64 {
        self.finest_scale * self.scale_factor.powi(level as i32)
    }

    fn size(&self, image: &Image, level: usize) -> (usize, usize) {
        let scale = self.scale(level);
        let side = |side: usize| (side as f64 / scale + 1e-9) as usize;
        (side(image.width()), side(image.height()))
    }
}

impl Pyramid {
    /// Replaces all levels. Allocates only for the first image and for larger ones.
    pub(crate) fn build(
        &mut self,
        instructions: InstructionSet,
        image: &Image,
        shape: &PyramidShape,
    ) {
        self.level_count = (0..shape.level_count_max)
            .take_while(|&level| {
                let (width, height) = shape.size(image, level);
                width.min(height) >= shape.side_px_min.max(2) && width.max(height) <= SIDE_PX_MAX
            })
            .count();
        if self.levels.len() < self.level_count {
            self.levels.resize(self.level_count, Plane::default());
        }
        let stride = shape.size(image, 0).0;
        for level in 0..self.level_count {
            let (width, height) = shape.size(image, level);
            let (before, after) = self.levels.split_at_mut(level);
            let target = &mut after[0];
            target.resize(width, height, stride);
            let source = match before.last() {
                Some(finer) => Source {
                    pixels: finer.pixels(),
                    stride,
                    width: finer.width(),
                },
                None => Source {
                    pixels: image.pixels(),
                    stride: image.width(),
                    width: image.width(),
                },
            };
            let factor = if level == 0 {
                shape.finest_scale
            } else {
                shape.scale_factor
            };
            if factor == 1.0 {
                copy(&source, target);
            } else {
                resample(
                    instructions,
                    &source,
                    factor,
                    target,
                    &mut self.columns,
                    &mut self.row,
                );
            }
        }
    }

    pub(crate) fn levels(&self) -> &[Plane] {
        &self.levels[..self.level_count]
    }
}

struct Source<'a> {
    pixels: &'a [u8],
    stride: usize,
    width: usize,
}

impl Source<'_> {
    fn height(&self) -> usize {
        // The last row of an image may end without the rest of its stride.
        self.pixels.len().div_ceil(self.stride)
    }

    fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.stride..][..self.width]
    }
}

fn copy(source: &Source, target: &mut Plane) {
    for y in 0..target.height() {
        target.row_mut(y).copy_from_slice(source.row(y));
    }
}

fn resample(
    instructions: InstructionSet,
    source: &Source,
    factor: f64,
    target: &mut Plane,
    columns: &mut Vec<Tap>,
    row: &mut Vec<u8>,
) {
    columns.clear();
    columns.extend((0..target.width()).map(|x| tap(x, factor, source.width)));
    row.clear();
    row.resize(source.width, 0);
    for y in 0..target.height() {
        let Tap {
            first,
            second_weight,
        } = tap(y, factor, source.height());
        let rows = [source.row(first as usize), source.row(first as usize + 1)];
        blend_rows(instructions, &rows, second_weight as u16, row);
        blend_columns(row, columns, target.row_mut(y));
    }
}

/// Where pixel `idx` of a coarser row of pixels lies between those of the finer row.
fn tap(idx: usize, factor: f64, source_count: usize) -> Tap {
    let position = ((idx as f64 + 0.5) * factor - 0.5).clamp(0.0, source_count as f64 - 1.0);
    let first = (position as usize).min(source_count - 2);
    let unit = f64::from(1 << WEIGHT_BITS);
    Tap {
        first: first as u32,
        second_weight: ((position - first as f64) * unit).round() as u32,
    }
}

multiversion! {
    fn blend_rows(rows: &[&[u8]; 2], second_weight: u16, blended: &mut [u8]) = blend_rows_body
}

#[inline(always)]
fn blend_rows_body(rows: &[&[u8]; 2], second_weight: u16, blended: &mut [u8]) {
    let count = blended.len();
    let [first, second] = rows.map(|row| &row[..count]);
    let first_weight = (1 << WEIGHT_BITS) - second_weight;
    for x in 0..count {
        let sum = u16::from(first[x]) * first_weight + u16::from(second[x]) * second_weight;
        blended[x] = ((sum + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS) as u8;
    }
}

fn blend_columns(row: &[u8], taps: &[Tap], blended: &mut [u8]) {
    for (pixel, tap) in blended.iter_mut().zip(taps) {
        let [first, second] = [row[tap.first as usize], row[tap.first as usize + 1]];
        let first_weight = (1 << WEIGHT_BITS) - tap.second_weight;
        let sum = u32::from(first) * first_weight + u32::from(second) * tap.second_weight;
        *pixel = ((sum + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS) as u8;
    }
}

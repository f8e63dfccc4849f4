//! The surroundings of a corner, turned upright.

use nalgebra::Vector2;

use crate::plane::Plane;
use crate::simd::InstructionSet;

/// Samples along a side of the patch: a grid of 16 and one more around it for differences.
pub(crate) const SIDE: usize = 18;
/// Distance of neighbouring samples.
pub(crate) const STEP_PX: f32 = 1.75;
/// No sample, with the pixels it is interpolated from, lies further from the corner: half the
/// diagonal of the grid, 21.04 px, and one pixel.
pub(crate) const REACH_PX: usize = 23;

/// Brightness on a grid, in 1/32768 of a grey value; exact in `f32`.
pub(crate) type Patch = [[f32; SIDE]; SIDE];

/// Where a patch lies: its centre in the plane, and the direction of its x axis (unit length).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    pub(crate) centre_px: Vector2<f32>,
    pub(crate) direction: Vector2<f32>,
}

/// One step along the grid and its origin, in 1/65536 px.
#[derive(Clone, Copy)]
struct Grid {
    origin: [i32; 2],
    along: [i32; 2],
}

const FRACTION_BITS: u32 = 16;

impl Grid {
    fn new(placement: &Placement) -> Self {
        let unit = (1 << FRACTION_BITS) as f32;
        let along = (placement.direction * (STEP_PX * unit)).map(|step| step.round() as i32);
        let half = (SIDE as i32 - 1) * along / 2;
        let centre = (placement.centre_px * unit).map(|position| position.round() as i32);
        Self {
            // The grid's first sample lies half a side back along both axes (x, y) and (-y, x).
            origin: [centre.x - half.x + half.y, centre.y - half.y - half.x],
            along: [along.x, along.y],
        }
    }

    #[inline(always)]
    fn position(&self, column: i32, row: i32) -> [i32; 2] {
        let [along_x, along_y] = self.along;
        [
            self.origin[0] + column * along_x - row * along_y,
            self.origin[1] + column * along_y + row * along_x,
        ]
    }
}

/// Samples a plane bilinearly. The centre must be at least [`REACH_PX`] away from its border.
pub(crate) fn sample(instructions: InstructionSet, plane: &Plane, placement: &Placement) -> Patch {
    let reach = REACH_PX as f32;
    let inside = |position: f32, side: usize| position >= reach && position < side as f32 - reach;
    assert!(
        inside(placement.centre_px.x, plane.width())
            && inside(placement.centre_px.y, plane.height()),
        "patch at {} reaches out of {}×{}",
        placement.centre_px,
        plane.width(),
        plane.height()
    );
    let grid = Grid::new(placement);
    #[cfg(target_arch = "x86_64")]
    if instructions.has_avx2() {
        // SAFETY: AVX2 was detected; the assertion above keeps all samples inside the plane.
        return unsafe { avx2::sample(plane, &grid) };
    }
    let _ = instructions;
    sample_portable(plane, &grid)
}

fn sample_portable(plane: &Plane, grid: &Grid) -> Patch {
    std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let [x, y] = grid.position(column as i32, row as i32);
            let (left, top) = ((x >> FRACTION_BITS) as usize, (y >> FRACTION_BITS) as usize);
            let (right_weight, low_weight) = ((x >> 8) & 0xff, (y >> 8) & 0xff);
            let blend = |row: &[u8]| {
                let [a, b] = [row[left], row[left + 1]].map(i32::from);
                (a * (256 - right_weight) + b * right_weight) >> 1
            };
            let (upper, lower) = (blend(plane.row(top)), blend(plane.row(top + 1)));
            (upper * (256 - low_weight) + lower * low_weight) as f32
        })
    })
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;
    use std::mem::transmute;

    use super::{FRACTION_BITS, Grid, Patch, SIDE};
    use crate::plane::Plane;

    /// # Safety
    ///
    /// All samples of the grid must lie inside the plane, three pixels from its right border.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn sample(plane: &Plane, grid: &Grid) -> Patch {
        let mut patch = [[0.0; SIDE]; SIDE];
        let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        let pixels = plane.pixels().as_ptr();
        for (row, values) in patch.iter_mut().enumerate() {
            // Three overlapping blocks of eight cover 18 samples.
            for first in [0, 8, SIDE - 8] {
                let column = _mm256_add_epi32(lanes, _mm256_set1_epi32(first as i32));
                let [start_x, start_y] = grid.position(0, row as i32);
                let step = |start: i32, along: i32| {
                    let steps = _mm256_mullo_epi32(column, _mm256_set1_epi32(along));
                    _mm256_add_epi32(_mm256_set1_epi32(start), steps)
                };
                let (x, y) = (step(start_x, grid.along[0]), step(start_y, grid.along[1]));
                // SAFETY: the caller keeps the samples inside.
                let block = unsafe { blend(pixels, plane.stride() as i32, x, y) };
                // SAFETY: a vector is eight numbers.
                let block = unsafe { transmute::<__m256, [f32; 8]>(block) };
                values[first..first + 8].copy_from_slice(&block);
            }
        }
        patch
    }

    /// # Safety
    ///
    /// `pixels` must hold four bytes from each position on, and on the row below it.
    #[target_feature(enable = "avx2")]
    unsafe fn blend(pixels: *const u8, stride: i32, x: __m256i, y: __m256i) -> __m256 {
        const SHIFT: i32 = FRACTION_BITS as i32;
        let left = _mm256_srai_epi32::<SHIFT>(x);
        let top = _mm256_srai_epi32::<SHIFT>(y);
        let offsets = _mm256_add_epi32(_mm256_mullo_epi32(top, _mm256_set1_epi32(stride)), left);
        // SAFETY: the caller's promise.
        let (upper, lower) = unsafe {
            let below = pixels.add(stride as usize);
            (
                _mm256_i32gather_epi32::<1>(pixels.cast(), offsets),
                _mm256_i32gather_epi32::<1>(below.cast(), offsets),
            )
        };
        // Two weights as 16-bit halves of a lane: 256 minus the fraction, and the fraction.
        let weights = |position: __m256i| {
            let fraction =
                _mm256_and_si256(_mm256_srai_epi32::<8>(position), _mm256_set1_epi32(0xff));
            let rest = _mm256_sub_epi32(_mm256_set1_epi32(256), fraction);
            _mm256_or_si256(rest, _mm256_slli_epi32::<16>(fraction))
        };
        let (across, down) = (weights(x), weights(y));
        let blend_row = |bytes: __m256i| {
            let first = _mm256_and_si256(bytes, _mm256_set1_epi32(0xff));
            let second = _mm256_and_si256(bytes, _mm256_set1_epi32(0xff00));
            let both = _mm256_or_si256(first, _mm256_slli_epi32::<8>(second));
            _mm256_srli_epi32::<1>(_mm256_madd_epi16(both, across))
        };
        let rows = _mm256_or_si256(blend_row(upper), _mm256_slli_epi32::<16>(blend_row(lower)));
        _mm256_cvtepi32_ps(_mm256_madd_epi16(rows, down))
    }
}

//! Corners by the segment test.

use nalgebra::Vector2;

use crate::plane::Plane;
use crate::simd::{BLOCK, InstructionSet, multiversion};

/// A local maximum of the corner score.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Corner {
    pub(crate) x: u16,
    pub(crate) y: u16,
    /// Scores of the pixels around, row by row; the corner's own is in the middle.
    pub(crate) scores: [[u8; AROUND]; AROUND],
}

/// Radius of the ring of the segment test.
pub(crate) const RING_RADIUS_PX: usize = 3;
/// Scores are kept this far around a corner.
const AROUND_RADIUS_PX: usize = 2;
const AROUND: usize = 2 * AROUND_RADIUS_PX + 1;
/// Nothing is found closer to the border.
pub(crate) const MARGIN_PX_MIN: usize = RING_RADIUS_PX + AROUND_RADIUS_PX;

impl Corner {
    pub(crate) fn score(&self) -> u8 {
        self.scores[AROUND_RADIUS_PX][AROUND_RADIUS_PX]
    }

    /// From the pixel to the top of the paraboloid that fits the scores around it best under a
    /// Gaussian weight of σ = 1 px; at most one pixel in each direction.
    ///
    /// Of what was tried this repeats best between views of known homography (median distance,
    /// pixels of the level): whole pixel 0.62, Förstner's intersection of gradients 0.67,
    /// paraboloid over 3 × 3 pixels 0.34, this one 0.29.
    pub(crate) fn shift_px(&self) -> Vector2<f64> {
        // Σ w g p over p = x, y, xy, and x², y² less their weighted mean: orthogonal under a
        // separable weight, so each coefficient is a quotient of its own.
        let [mut along_x, mut along_y, mut twist, mut bend_x, mut bend_y] = [0.0_f64; 5];
        for (row, v) in self.scores.iter().zip(-2_i32..) {
            for (&score, u) in row.iter().zip(-2_i32..) {
                let weight = weight(u) * weight(v) * f64::from(score);
                let (x, y) = (f64::from(u), f64::from(v));
                along_x += weight * x;
                along_y += weight * y;
                twist += weight * x * y;
                bend_x += weight * (x * x - MEAN_SQUARE);
                bend_y += weight * (y * y - MEAN_SQUARE);
            }
        }
        let slope = Vector2::new(along_x, along_y) / (SUM_0 * SUM_2);
        let twist = twist / (SUM_2 * SUM_2);
        let bends = 2.0 / (SUM_0 * (SUM_4 - MEAN_SQUARE * SUM_2));
        let (bend_x, bend_y) = (bend_x * bends, bend_y * bends);
        let determinant = bend_x * bend_y - twist * twist;
        if bend_x >= 0.0 || determinant <= 0.0 {
            return Vector2::zeros();
        }
        let shift = Vector2::new(
            twist * slope.y - bend_y * slope.x,
            twist * slope.x - bend_x * slope.y,
        ) / determinant;
        shift / shift.amax().max(1.0)
    }
}

/// exp(-u²/2) for u = 0, 1, 2.
const GAUSSIAN: [f64; AROUND_RADIUS_PX + 1] = [1.0, 0.606_530_66, 0.135_335_28];
/// Σ of the weights along one axis, and with u² and u⁴.
const SUM_0: f64 = 1.0 + 2.0 * (GAUSSIAN[1] + GAUSSIAN[2]);
const SUM_2: f64 = 2.0 * (GAUSSIAN[1] + 4.0 * GAUSSIAN[2]);
const SUM_4: f64 = 2.0 * (GAUSSIAN[1] + 16.0 * GAUSSIAN[2]);
const MEAN_SQUARE: f64 = SUM_2 / SUM_0;

fn weight(u: i32) -> f64 {
    GAUSSIAN[u.unsigned_abs() as usize]
}

/// Finds corners; keeps its buffers from image to image.
#[derive(Clone, Debug, Default)]
pub(crate) struct CornerFinder {
    /// Scores of five neighbouring rows, used in turn.
    scores: [Vec<u8>; AROUND],
    peaks: Vec<u8>,
}

impl CornerFinder {
    /// Appends all corners whose score is above `threshold`, row by row, at least `margin_px`
    /// away from the border.
    ///
    /// FAST-9 (Rosten and Drummond 2006) with a score: the largest threshold at which nine
    /// neighbours on the ring of 16 are all brighter or all darker than the centre. The score is
    /// computed everywhere without a branch, which is cheaper than to decide where. Of neighbours
    /// with one score the first in reading order stays.
    pub(crate) fn find(
        &mut self,
        instructions: InstructionSet,
        plane: &Plane,
        margin_px: usize,
        threshold: u8,
        corners: &mut Vec<Corner>,
    ) {
        let margin_px = margin_px.max(MARGIN_PX_MIN);
        if plane.width() <= 2 * margin_px || plane.height() <= 2 * margin_px {
            return;
        }
        let inner_width = plane.width() - 2 * margin_px;
        let score_width = inner_width + 2 * AROUND_RADIUS_PX;
        for row in &mut self.scores {
            row.clear();
            row.resize(score_width, 0);
        }
        self.peaks.clear();
        self.peaks.resize(inner_width, 0);
        let first_column = margin_px - MARGIN_PX_MIN;
        let rows = margin_px - AROUND_RADIUS_PX..plane.height() - margin_px + AROUND_RADIUS_PX;
        for y in rows {
            let rows: [&[u8]; 7] = std::array::from_fn(|idx| {
                &plane.row(y + idx - RING_RADIUS_PX)[first_column..]
                    [..score_width + 2 * RING_RADIUS_PX]
            });
            self.scores.rotate_left(1);
            score_row(instructions, &rows, &mut self.scores[AROUND - 1]);
            if y >= margin_px + AROUND_RADIUS_PX {
                let columns = 1..score_width - 1;
                let around: [&[u8]; 3] =
                    std::array::from_fn(|idx| &self.scores[idx + 1][columns.clone()]);
                mark_peaks(instructions, &around, threshold, &mut self.peaks);
                self.collect_peaks(margin_px, y - AROUND_RADIUS_PX, corners);
            }
        }
    }

    fn collect_peaks(&self, margin_px: usize, y: usize, corners: &mut Vec<Corner>) {
        let mut push = |x: usize| {
            corners.push(Corner {
                x: (margin_px + x) as u16,
                y: y as u16,
                scores: self.scores.each_ref().map(|row| {
                    *row[x..]
                        .first_chunk()
                        .expect("scores reach two pixels beyond peaks")
                }),
            });
        };
        let (words, rest) = self.peaks.as_chunks::<8>();
        for (word_idx, word) in words.iter().enumerate() {
            let mut left = u64::from_le_bytes(*word);
            while left != 0 {
                let byte_idx = left.trailing_zeros() as usize / 8;
                push(8 * word_idx + byte_idx);
                left &= !(0xff << (8 * byte_idx));
            }
        }
        for (idx, _) in rest.iter().enumerate().filter(|(_, score)| **score != 0) {
            push(8 * words.len() + idx);
        }
    }
}

/// Writes the score of each pixel of the middle row, but for three at each end.
fn score_row(instructions: InstructionSet, rows: &[&[u8]; 7], scores: &mut [u8]) {
    let count = scores.len();
    let [r0, r1, r2, r3, r4, r5, r6] = rows.map(|row| &row[..count + 6]);
    // Clockwise from the top; index 0 of each slice is a neighbour of the first centre.
    #[rustfmt::skip]
    let ring: [&[u8]; RING] = [
        &r0[3..], &r0[4..], &r1[5..], &r2[6..], &r3[6..], &r4[6..], &r5[5..], &r6[4..],
        &r6[3..], &r6[2..], &r5[1..], r4, r3, r2, &r1[1..], &r0[2..],
    ].map(|row| &row[..count]);
    let centre = &r3[3..3 + count];
    #[cfg(target_arch = "x86_64")]
    if instructions.has_avx2() && count >= BLOCK {
        // SAFETY: AVX2 was detected.
        return unsafe { avx2::score_row(&ring, centre, scores) };
    }
    let _ = instructions;
    score_row_portable(&ring, centre, scores);
}

/// Pixels on the ring.
const RING: usize = 16;

/// The `$outer` extreme over all arcs of nine pixels of the `$inner` extreme within the arc.
///
/// Two arcs that start side by side share eight pixels, so eight windows of eight do for all 16.
/// For bytes and for vectors of bytes alike.
macro_rules! arc_extreme {
    ($ring:expr, $inner:path, $outer:path) => {{
        let p = $ring;
        let (mut twos, mut fours, mut extreme) = ([p[0]; 8], [p[0]; 8], p[0]);
        for i in 0..8 {
            twos[i] = $inner(p[2 * i + 1], p[(2 * i + 2) % RING]);
        }
        for i in 0..8 {
            fours[i] = $inner(twos[i], twos[(i + 1) % 8]);
        }
        for i in 0..8 {
            let eight = $inner(fours[i], fours[(i + 2) % 8]);
            let nine = $inner(eight, $outer(p[2 * i], p[(2 * i + 9) % RING]));
            extreme = if i == 0 { nine } else { $outer(extreme, nine) };
        }
        extreme
    }};
}

fn score_row_portable(ring: &[&[u8]; RING], centre: &[u8], scores: &mut [u8]) {
    for x in 0..scores.len() {
        let mut p = [0_u8; RING];
        for idx in 0..RING {
            p[idx] = ring[idx][x];
        }
        let brighter = arc_extreme!(&p, u8::min, u8::max).saturating_sub(centre[x]);
        let darker = centre[x].saturating_sub(arc_extreme!(&p, u8::max, u8::min));
        scores[x] = brighter.max(darker);
    }
}

/// Written out, because compilers vectorise the loop above only on good days: 0.25 ms or 4 ms for
/// all levels of a 324×244 image.
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;
    use std::mem::transmute;

    use super::RING;
    use crate::simd::{BLOCK, block_at, block_starts};

    /// Rows must be at least a block long.
    #[target_feature(enable = "avx2")]
    pub(super) fn score_row(ring: &[&[u8]; RING], centre: &[u8], scores: &mut [u8]) {
        for start in block_starts(scores.len()) {
            let mut p = [_mm256_setzero_si256(); RING];
            for idx in 0..RING {
                p[idx] = load(ring[idx], start);
            }
            let centre = load(centre, start);
            let brightest = arc_extreme!(&p, _mm256_min_epu8, _mm256_max_epu8);
            let darkest = arc_extreme!(&p, _mm256_max_epu8, _mm256_min_epu8);
            let block = _mm256_max_epu8(
                _mm256_subs_epu8(brightest, centre),
                _mm256_subs_epu8(centre, darkest),
            );
            // SAFETY: a vector is 32 bytes.
            let block = unsafe { transmute::<__m256i, [u8; BLOCK]>(block) };
            scores[start..start + BLOCK].copy_from_slice(&block);
        }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(row: &[u8], start: usize) -> __m256i {
        // SAFETY: any 32 bytes are a vector.
        unsafe { transmute::<[u8; BLOCK], __m256i>(block_at(row, start)) }
    }
}

multiversion! {
    /// Copies scores above the threshold that are maxima among their eight neighbours, else 0.
    fn mark_peaks(around: &[&[u8]; 3], threshold: u8, peaks: &mut [u8]) = mark_peaks_body
}

#[inline(always)]
fn mark_peaks_body(around: &[&[u8]; 3], threshold: u8, peaks: &mut [u8]) {
    let count = peaks.len();
    let [above, middle, below] = around.map(|row| &row[..count + 2]);
    let (a0, a1, a2) = (&above[..count], &above[1..=count], &above[2..]);
    let (m0, m1, m2) = (&middle[..count], &middle[1..=count], &middle[2..]);
    let (b0, b1, b2) = (&below[..count], &below[1..=count], &below[2..]);
    for x in 0..count {
        let before = a0[x].max(a1[x]).max(a2[x]).max(m0[x]).max(threshold);
        let after = m2[x].max(b0[x]).max(b1[x]).max(b2[x]);
        let score = m1[x];
        peaks[x] = if (score > before) & (score >= after) {
            score
        } else {
            0
        };
    }
}

#[cfg(test)]
mod tests;

//! Corners by the segment test.

use crate::plane::Plane;
use crate::simd::{InstructionSet, multiversion};

/// A local maximum of the corner score.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Corner {
    pub(crate) x: u16,
    pub(crate) y: u16,
    pub(crate) score: u8,
}

/// Radius of the ring of the segment test.
pub(crate) const RING_RADIUS_PX: usize = 3;

/// Finds corners; keeps its buffers from image to image.
#[derive(Clone, Debug, Default)]
pub(crate) struct CornerFinder {
    /// Scores of three neighbouring rows, used in turn.
    scores: [Vec<u8>; 3],
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
        // One more pixel around is needed to find maxima.
        let margin_px = margin_px.max(RING_RADIUS_PX + 1);
        if plane.width() <= 2 * margin_px || plane.height() <= 2 * margin_px {
            return;
        }
        let inner_width = plane.width() - 2 * margin_px;
        let score_width = inner_width + 2;
        for row in &mut self.scores {
            row.clear();
            row.resize(score_width, 0);
        }
        self.peaks.clear();
        self.peaks.resize(inner_width, 0);
        let ring_columns = margin_px - 1 - RING_RADIUS_PX..;
        for y in margin_px - 1..=plane.height() - margin_px {
            let rows: [&[u8]; 7] = std::array::from_fn(|idx| {
                &plane.row(y + idx - RING_RADIUS_PX)[ring_columns.clone()]
                    [..score_width + 2 * RING_RADIUS_PX]
            });
            self.scores.rotate_left(1);
            score_row(instructions, &rows, &mut self.scores[2]);
            if y > margin_px {
                let [above, middle, below] = &self.scores;
                let around = [above.as_slice(), middle, below];
                mark_peaks(instructions, &around, threshold, &mut self.peaks);
                collect_peaks(&self.peaks, margin_px, y - 1, corners);
            }
        }
    }
}

multiversion! {
    fn score_row(rows: &[&[u8]; 7], scores: &mut [u8]) = score_row_body
}

#[inline(always)]
fn score_row_body(rows: &[&[u8]; 7], scores: &mut [u8]) {
    let count = scores.len();
    let [r0, r1, r2, r3, r4, r5, r6] = rows.map(|row| &row[..count + 6]);
    // The ring clockwise from the top, each slice shifted so that index 0 is its first neighbour.
    let ring: [&[u8]; 16] = [
        &r0[3..],
        &r0[4..],
        &r1[5..],
        &r2[6..],
        &r3[6..],
        &r4[6..],
        &r5[5..],
        &r6[4..],
        &r6[3..],
        &r6[2..],
        &r5[1..],
        &r4,
        &r3,
        &r2,
        &r1[1..],
        &r0[2..],
    ]
    .map(|row| &row[..count]);
    let centre = &r3[3..3 + count];
    for x in 0..count {
        let p: [u8; 16] = std::array::from_fn(|idx| ring[idx][x]);
        let brighter = arc_extreme(&p, u8::min, u8::max).saturating_sub(centre[x]);
        let darker = centre[x].saturating_sub(arc_extreme(&p, u8::max, u8::min));
        scores[x] = brighter.max(darker);
    }
}

/// The `outer` extreme over all arcs of nine of the `inner` extreme within the arc.
///
/// Two arcs that start side by side share eight pixels, so eight windows of eight do for all 16.
#[inline(always)]
fn arc_extreme(p: &[u8; 16], inner: fn(u8, u8) -> u8, outer: fn(u8, u8) -> u8) -> u8 {
    let twos: [u8; 8] = std::array::from_fn(|i| inner(p[2 * i + 1], p[(2 * i + 2) % 16]));
    let fours: [u8; 8] = std::array::from_fn(|i| inner(twos[i], twos[(i + 1) % 8]));
    let nines: [u8; 8] = std::array::from_fn(|i| {
        let eight = inner(fours[i], fours[(i + 2) % 8]);
        inner(eight, outer(p[2 * i], p[(2 * i + 9) % 16]))
    });
    let halves: [u8; 4] = std::array::from_fn(|i| outer(nines[2 * i], nines[2 * i + 1]));
    outer(outer(halves[0], halves[1]), outer(halves[2], halves[3]))
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

fn collect_peaks(peaks: &[u8], first_x: usize, y: usize, corners: &mut Vec<Corner>) {
    let mut push = |x: usize, score: u8| {
        corners.push(Corner {
            x: (first_x + x) as u16,
            y: y as u16,
            score,
        });
    };
    let (words, rest) = peaks.as_chunks::<8>();
    for (word_idx, word) in words.iter().enumerate() {
        let mut left = u64::from_le_bytes(*word);
        while left != 0 {
            let byte_idx = left.trailing_zeros() as usize / 8;
            push(8 * word_idx + byte_idx, word[byte_idx]);
            left &= !(0xff << (8 * byte_idx));
        }
    }
    for (idx, &score) in rest.iter().enumerate().filter(|(_, score)| **score != 0) {
        push(8 * words.len() + idx, score);
    }
}

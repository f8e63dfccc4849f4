//! Smoothing before brightness is compared.

use crate::plane::Plane;
use crate::simd::{InstructionSet, multiversion};

const TAP_COUNT: usize = 7;
const RADIUS_PX: usize = TAP_COUNT / 2;

/// A Gaussian of σ = 2 px in 256ths.
const WEIGHTS: [u16; TAP_COUNT] = [18, 34, 48, 56, 48, 34, 18];

/// Smooths planes; keeps its buffer.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blur {
    row: Vec<u8>,
}

impl Blur {
    /// Replaces `target` by the source under a Gaussian; the border is continued by its pixels.
    pub(crate) fn smooth(
        &mut self,
        instructions: InstructionSet,
        source: &Plane,
        target: &mut Plane,
    ) {
        let (width, height) = (source.width(), source.height());
        target.resize(width, height, source.stride());
        self.row.clear();
        self.row.resize(width + 2 * RADIUS_PX, 0);
        for y in 0..height {
            let rows: [&[u8]; TAP_COUNT] = std::array::from_fn(|idx| {
                source.row((y + idx).saturating_sub(RADIUS_PX).min(height - 1))
            });
            let inner = RADIUS_PX..RADIUS_PX + width;
            weigh(instructions, &rows, &mut self.row[inner]);
            let (first, last) = (self.row[RADIUS_PX], self.row[RADIUS_PX + width - 1]);
            self.row[..RADIUS_PX].fill(first);
            self.row[RADIUS_PX + width..].fill(last);
            let columns: [&[u8]; TAP_COUNT] =
                std::array::from_fn(|idx| &self.row[idx..idx + width]);
            weigh(instructions, &columns, target.row_mut(y));
        }
    }
}

multiversion! {
    fn weigh(sources: &[&[u8]; TAP_COUNT], weighed: &mut [u8]) = weigh_body
}

#[inline(always)]
fn weigh_body(sources: &[&[u8]; TAP_COUNT], weighed: &mut [u8]) {
    let count = weighed.len();
    let s = sources.map(|source| &source[..count]);
    for x in 0..count {
        let pair = |idx: usize| u16::from(s[idx][x]) + u16::from(s[TAP_COUNT - 1 - idx][x]);
        let sum = WEIGHTS[0] * pair(0)
            + WEIGHTS[1] * pair(1)
            + WEIGHTS[2] * pair(2)
            + WEIGHTS[3] * u16::from(s[3][x]);
        weighed[x] = ((sum + 128) >> 8) as u8;
    }
}

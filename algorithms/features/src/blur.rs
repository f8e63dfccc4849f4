//! Smoothing before brightness is compared.

use crate::plane::Plane;
use crate::simd::{InstructionSet, multiversion};

const TAP_COUNT: usize = 7;
const RADIUS_PX: usize = TAP_COUNT / 2;

/// A Gaussian of σ = 1.2 px in 256ths.
const WEIGHTS: [u16; TAP_COUNT] = [4, 21, 60, 86, 60, 21, 4];

/// Smooths planes; keeps its buffer.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blur {
    row: Vec<u8>,
}

impl Blur {
    /// Replaces `target` by the source under a Gaussian, with `padding_px` around it; beyond the
    /// border the source is continued by its outermost pixels.
    pub(crate) fn smooth(
        &mut self,
        instructions: InstructionSet,
        source: &Plane,
        padding_px: usize,
        target: &mut Plane,
    ) {
        let (source_width, source_height) = (source.width(), source.height());
        let (width, height) = (
            source_width + 2 * padding_px,
            source_height + 2 * padding_px,
        );
        target.resize(width, height, width);
        let border = RADIUS_PX + padding_px;
        self.row.clear();
        self.row.resize(source_width + 2 * border, 0);
        for y in 0..height {
            let rows: [&[u8]; TAP_COUNT] = std::array::from_fn(|idx| {
                source.row((y + idx).saturating_sub(border).min(source_height - 1))
            });
            let inner = border..border + source_width;
            weigh(instructions, &rows, &mut self.row[inner]);
            let (first, last) = (self.row[border], self.row[border + source_width - 1]);
            self.row[..border].fill(first);
            self.row[border + source_width..].fill(last);
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

//! Halved images for optical flow.

use camera::Image;

use crate::plane::Plane;
use crate::simd::{InstructionSet, multiversion};

/// Levels smaller than this hold no window with room to move.
const SIDE_PX_MIN: usize = 24;

/// An image halved again and again; pixel (x, y) of level l lies at `(x + ½) 2^l - ½`.
#[derive(Clone, Debug, Default)]
pub struct FlowPyramid {
    levels: Vec<Plane>,
    level_count: usize,
    row: Vec<u8>,
}

impl FlowPyramid {
    /// Halves the image up to `level_count` levels (itself included).
    pub fn new(image: &Image, level_count: usize) -> Self {
        let mut pyramid = Self::default();
        pyramid.rebuild(image, level_count);
        pyramid
    }

    /// [`FlowPyramid::new`] in the buffers of an earlier one.
    pub fn rebuild(&mut self, image: &Image, level_count: usize) {
        let instructions = InstructionSet::detect();
        let side = image.width().min(image.height());
        self.level_count = (0..level_count.min(usize::BITS as usize))
            .take_while(|level| side >> level >= SIDE_PX_MIN)
            .count();
        if self.levels.len() < self.level_count {
            self.levels.resize(self.level_count, Plane::default());
        }
        for level in 0..self.level_count {
            let (finer, rest) = self.levels.split_at_mut(level);
            let target = &mut rest[0];
            let (width, height) = (image.width() >> level, image.height() >> level);
            target.resize(width, height, width);
            match finer.last() {
                Some(finer) => halve(instructions, finer, &mut self.row, target),
                None => (0..height).for_each(|y| target.row_mut(y).copy_from_slice(image.row(y))),
            }
        }
    }

    pub(super) fn levels(&self) -> &[Plane] {
        &self.levels[..self.level_count]
    }
}

/// Weighs four pixels by 1, 3, 3, 1 in each direction, so that halving hardly aliases.
fn halve(instructions: InstructionSet, source: &Plane, row: &mut Vec<u8>, target: &mut Plane) {
    row.clear();
    row.resize(source.width(), 0);
    let clamp = |idx: isize, count: usize| idx.clamp(0, count as isize - 1) as usize;
    for y in 0..target.height() {
        let rows = std::array::from_fn(|idx| {
            source.row(clamp(2 * y as isize + idx as isize - 1, source.height()))
        });
        weigh_rows(instructions, &rows, row);
        for (x, pixel) in target.row_mut(y).iter_mut().enumerate() {
            let at = |idx: isize| u16::from(row[clamp(2 * x as isize + idx, row.len())]);
            *pixel = ((at(-1) + 3 * (at(0) + at(1)) + at(2) + 4) >> 3) as u8;
        }
    }
}

multiversion! {
    fn weigh_rows(rows: &[&[u8]; 4], weighed: &mut [u8]) = weigh_rows_body
}

#[inline(always)]
fn weigh_rows_body(rows: &[&[u8]; 4], weighed: &mut [u8]) {
    let count = weighed.len();
    let [a, b, c, d] = rows.map(|row| &row[..count]);
    for x in 0..count {
        let outer = u16::from(a[x]) + u16::from(d[x]);
        let inner = u16::from(b[x]) + u16::from(c[x]);
        weighed[x] = ((outer + 3 * inner + 4) >> 3) as u8;
    }
}

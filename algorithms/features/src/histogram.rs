//! Gradients around a corner, by place and direction.
#![expect(
    clippy::needless_range_loop,
    reason = "one index over several slices of one length is what compilers vectorise"
)]

use crate::patch::{Patch, SIDE};
use crate::simd::multiversion;

/// Gradients along a side of the patch.
const GRID: usize = SIDE - 2;
/// Cells along a side.
const CELLS: usize = 4;
/// Directions, 45° apart.
const DIRECTIONS: usize = 8;
pub(crate) const BIN_COUNT: usize = CELLS * CELLS * DIRECTIONS;

/// Bins by direction, then row, then column.
pub(crate) type Histogram = [f32; BIN_COUNT];

/// Weight of a gradient by its distance from the middle, in steps from ½ up: a Gaussian of
/// σ = 6 px at a step of 1.75 px.
const GAUSSIAN: [f32; GRID / 2] = [
    0.989_423, 0.908_723, 0.766_563, 0.593_914, 0.422_609, 0.276_194, 0.165_783, 0.091_395,
];

/// What each gradient of the grid counts; those further than 8 steps from the middle do not.
const WEIGHTS: [[f32; GRID]; GRID] = weights();

const fn weights() -> [[f32; GRID]; GRID] {
    let mut weights = [[0.0; GRID]; GRID];
    let mut row = 0;
    while row < GRID {
        let mut column = 0;
        while column < GRID {
            // Twice the distance from the middle, so that it is whole.
            let (u, v) = (2 * column as i32 - 15, 2 * row as i32 - 15);
            if u * u + v * v <= 256 {
                weights[row][column] = GAUSSIAN[u.unsigned_abs() as usize / 2]
                    * GAUSSIAN[v.unsigned_abs() as usize / 2];
            }
            column += 1;
        }
        row += 1;
    }
    weights
}

/// What a row (or column) of gradients gives to each row (or column) of cells: linear
/// interpolation between cells of 4 steps.
const SHARES: [[f32; GRID]; CELLS] = shares();

const fn shares() -> [[f32; GRID]; CELLS] {
    let mut shares = [[0.0; GRID]; CELLS];
    let mut cell = 0;
    while cell < CELLS {
        let mut idx = 0;
        while idx < GRID {
            let twice_distance = (2 * idx as i32 - 15) - (8 * cell as i32 - 12);
            let share = 1.0 - twice_distance.abs() as f32 / 8.0;
            shares[cell][idx] = if share > 0.0 { share } else { 0.0 };
            idx += 1;
        }
        cell += 1;
    }
    shares
}

multiversion! {
    /// Sums the gradients of a patch into bins, each gradient into two directions and up to four
    /// cells; then takes the square root and scales to unit length (Arandjelović and Zisserman
    /// 2012), which makes brightness and contrast drop out.
    fn gather(patch: &Patch, histogram: &mut Histogram) = gather_body
}

#[inline(always)]
fn gather_body(patch: &Patch, histogram: &mut Histogram) {
    let mut rows = [[[0.0_f32; GRID]; DIRECTIONS]; CELLS];
    for y in 0..GRID {
        let directions = split_directions(patch, y);
        for (cell, rows) in rows.iter_mut().enumerate() {
            let share = SHARES[cell][y];
            if share == 0.0 {
                continue;
            }
            for (row, direction) in rows.iter_mut().zip(&directions) {
                for x in 0..GRID {
                    row[x] += share * direction[x];
                }
            }
        }
    }
    for direction in 0..DIRECTIONS {
        for (cell_y, rows) in rows.iter().enumerate() {
            let row = &rows[direction];
            for cell_x in 0..CELLS {
                let mut sum = 0.0;
                for x in 0..GRID {
                    if SHARES[cell_x][x] > 0.0 {
                        sum += SHARES[cell_x][x] * row[x];
                    }
                }
                histogram[(direction * CELLS + cell_y) * CELLS + cell_x] = sum;
            }
        }
    }
    normalise(histogram);
}

/// The gradients of a row, each split into the two nearest of the eight directions.
///
/// A vector with |x| > |y| is (|x| - |y|) along the axis and √2 |y| along the diagonal; so the
/// split needs no angle.
#[inline(always)]
fn split_directions(patch: &Patch, y: usize) -> [[f32; GRID]; DIRECTIONS] {
    let (above, row, below) = (&patch[y], &patch[y + 1], &patch[y + 2]);
    let mut split = [[0.0; GRID]; DIRECTIONS];
    for x in 0..GRID {
        let weight = WEIGHTS[y][x];
        let gx = weight * (row[x + 2] - row[x]);
        let gy = weight * (below[x + 1] - above[x + 1]);
        let (size_x, size_y) = (gx.abs(), gy.abs());
        let diagonal = |x: f32, y: f32| std::f32::consts::SQRT_2 * least(x, y);
        split[0][x] = positive(gx - size_y);
        split[1][x] = positive(diagonal(gx, gy));
        split[2][x] = positive(gy - size_x);
        split[3][x] = positive(diagonal(-gx, gy));
        split[4][x] = positive(-gx - size_y);
        split[5][x] = positive(diagonal(-gx, -gy));
        split[6][x] = positive(-gy - size_x);
        split[7][x] = positive(diagonal(gx, -gy));
    }
    split
}

// Plain comparisons become one instruction each; `f32::max` must also handle NaN.
#[inline(always)]
fn positive(value: f32) -> f32 {
    if value > 0.0 { value } else { 0.0 }
}

#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn normalise(histogram: &mut Histogram) {
    // Eight sums in fixed order, so that every instruction set adds alike.
    let mut sums = [0.0_f32; 8];
    for bins in histogram.as_chunks::<8>().0 {
        for (sum, bin) in sums.iter_mut().zip(bins) {
            *sum += bin;
        }
    }
    let sum =
        ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]));
    let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
    for bin in histogram {
        *bin = (*bin * scale).sqrt();
    }
}

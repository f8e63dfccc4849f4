//! Where lights may be: pixels that stand out from their surroundings on at least three sides.
//!
//! One pass of byte arithmetic without branches, which compilers turn into vector instructions.

use camera::Image;

use super::runs::{Run, RunJoiner, TooManyRuns};

/// How far away a pixel looks for its surroundings; lights up to this radius stand out.
pub(super) const ARM_PX: usize = 6;
/// Pixels that are tested at once.
const BLOCK: usize = 32;
/// Every how many rows and columns noise and brightness are sampled.
const SAMPLE_ROW_STEP: usize = 13;
const SAMPLE_COLUMN_STEP: usize = 6;
/// A difference of two pixels with normal noise has this median, in sigmas of the noise.
const MEDIAN_OF_DIFFERENCE_SIGMAS: f64 = 0.9539;

/// The standard deviation of a pixel's noise, from the median difference of near pixels.
pub(super) fn estimate_noise(image: &Image) -> f64 {
    let mut histogram = [0_u32; 256];
    let mut sample_count = 0;
    for y in (SAMPLE_ROW_STEP / 2..image.height()).step_by(SAMPLE_ROW_STEP) {
        let row = image.row(y);
        for pair in row.windows(3).step_by(SAMPLE_COLUMN_STEP) {
            histogram[usize::from(pair[0].abs_diff(pair[2]))] += 1;
            sample_count += 1;
        }
    }
    let mut below = 0;
    for (difference, count) in histogram.into_iter().enumerate() {
        if 2 * (below + count) >= sample_count && count > 0 {
            // Differences are whole numbers: the median lies inside its bin.
            let share = (0.5 * f64::from(sample_count) - f64::from(below)) / f64::from(count);
            let median = (difference as f64 - 0.5 + share).max(0.0);
            return median / MEDIAN_OF_DIFFERENCE_SIGMAS;
        }
        below += count;
    }
    0.0
}

/// The brightest of anything large; a single light is mostly missed.
pub(super) fn sample_brightest(image: &Image) -> u8 {
    (SAMPLE_ROW_STEP / 2..image.height())
        .step_by(SAMPLE_ROW_STEP)
        .map(|y| {
            image
                .row(y)
                .iter()
                .fold(0, |brightest, pixel| *pixel.max(&brightest))
        })
        .fold(0, u8::max)
}

/// Gives `joiner` the runs of pixels that are more than `threshold` brighter than at least three
/// of the four pixels [`ARM_PX`] away. Beyond the edge the picture continues with its edge.
///
/// - `padded_row`: room for a row with an arm at each end.
pub(super) fn find_bright(
    image: &Image,
    threshold: u8,
    padded_row: &mut [u8],
    joiner: &mut RunJoiner,
) -> Result<(), TooManyRuns> {
    let (width, height) = (image.width(), image.height());
    joiner.clear();
    if width < BLOCK {
        return Ok(());
    }
    for y in 0..height {
        let row = image.row(y);
        pad(row, padded_row);
        let arms = Arms {
            row,
            padded_row,
            up: image.row(y.saturating_sub(ARM_PX)),
            down: image.row((y + ARM_PX).min(height - 1)),
        };
        let mut open: Option<Run> = None;
        let mut done = 0;
        for start in (0..width).step_by(BLOCK) {
            let start = start.min(width - BLOCK);
            let hits = arms.test(start, threshold);
            if hits.iter().fold(0, |any, hit| any | hit) != 0 {
                extend_runs(&hits[done - start..], y, done, &mut open, joiner)?;
            }
            done = start + BLOCK;
        }
        if let Some(run) = open {
            joiner.push(run)?;
        }
    }
    Ok(())
}

fn pad(row: &[u8], padded_row: &mut [u8]) {
    let width = row.len();
    padded_row[..ARM_PX].fill(row[0]);
    padded_row[ARM_PX..ARM_PX + width].copy_from_slice(row);
    padded_row[ARM_PX + width..].fill(row[width - 1]);
}

/// A row and what surrounds it.
struct Arms<'a> {
    row: &'a [u8],
    padded_row: &'a [u8],
    up: &'a [u8],
    down: &'a [u8],
}

impl Arms<'_> {
    /// Not zero for each of the pixels from `start` that stands out.
    #[inline(always)]
    fn test(&self, start: usize, threshold: u8) -> [u8; BLOCK] {
        let center = block_at(self.row, start);
        let left = block_at(self.padded_row, start);
        let right = block_at(self.padded_row, start + 2 * ARM_PX);
        let up = block_at(self.up, start);
        let down = block_at(self.down, start);
        std::array::from_fn(|idx| {
            let (a, b) = (left[idx].min(right[idx]), left[idx].max(right[idx]));
            let (c, d) = (up[idx].min(down[idx]), up[idx].max(down[idx]));
            // Three of four are darker if the second brightest is.
            let second_brightest = b.min(d).max(a.max(c));
            center[idx]
                .saturating_sub(threshold)
                .saturating_sub(second_brightest)
        })
    }
}

#[inline(always)]
fn block_at(row: &[u8], start: usize) -> &[u8; BLOCK] {
    row[start..]
        .first_chunk()
        .expect("blocks end inside the row")
}

/// Appends the hits of pixels from `x_first` on to the open run, or closes it and opens others.
fn extend_runs(
    hits: &[u8],
    y: usize,
    x_first: usize,
    open: &mut Option<Run>,
    joiner: &mut RunJoiner,
) -> Result<(), TooManyRuns> {
    for (offset, _) in hits.iter().enumerate().filter(|(_, hit)| **hit != 0) {
        let x = (x_first + offset) as u16;
        match open {
            Some(run) if run.x_end == x => run.x_end += 1,
            _ => {
                let next = Run {
                    y: y as u16,
                    x_start: x,
                    x_end: x + 1,
                };
                if let Some(run) = open.replace(next) {
                    joiner.push(run)?;
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_that_stand_out_on_three_sides_are_those_of_the_definition() {
        let (width, height) = (70, 40);
        let pixels = (0..width * height).map(|idx| (idx * 7919 % 256) as u8 / (idx % 3 + 1) as u8);
        let image = Image::from_pixels(width, height, pixels.collect()).unwrap();
        let threshold = 60;
        let mut expected = 0;
        for y in 0..height {
            for x in 0..width {
                let arms = [
                    image.get(x.saturating_sub(ARM_PX), y),
                    image.get((x + ARM_PX).min(width - 1), y),
                    image.get(x, y.saturating_sub(ARM_PX)),
                    image.get(x, (y + ARM_PX).min(height - 1)),
                ];
                let level = image.get(x, y).saturating_sub(threshold);
                expected += u32::from(arms.iter().filter(|arm| level > **arm).count() >= 3);
            }
        }
        let mut joiner = RunJoiner::with_run_count_max(4096);
        let mut padded_row = vec![0; width + 2 * ARM_PX];
        find_bright(&image, threshold, &mut padded_row, &mut joiner).unwrap();
        let found: u32 = joiner
            .components()
            .iter()
            .map(|component| component.area_px)
            .sum();
        assert!(expected > 50);
        assert_eq!(found, expected);
    }
}

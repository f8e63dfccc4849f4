//! Which keypoints lie near a position.

use std::ops::RangeInclusive;

use nalgebra::Vector2;

use crate::Keypoint;

/// Keypoints of one image sorted into square buckets.
///
/// Positions outside the image (or not finite) go to the nearest bucket and are still found by
/// their true distance.
#[derive(Clone, Debug, Default)]
pub struct FeatureGrid {
    cell_px: f64,
    column_count: usize,
    row_count: usize,
    /// `entries[starts[c]..starts[c + 1]]` are the keypoints of cell `c`, by rising index.
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    position_px: Vector2<f64>,
    keypoint_idx: u32,
    level: u8,
}

impl FeatureGrid {
    /// Buckets of `cell_px` over an image of this size.
    pub fn new(width: usize, height: usize, cell_px: f64, keypoints: &[Keypoint]) -> Self {
        let mut grid = Self::default();
        grid.rebuild(width, height, cell_px, keypoints);
        grid
    }

    /// [`FeatureGrid::new`] in the buffers of an earlier one.
    pub fn rebuild(&mut self, width: usize, height: usize, cell_px: f64, keypoints: &[Keypoint]) {
        self.cell_px = if cell_px >= 1.0 { cell_px } else { 1.0 };
        self.column_count = ((width as f64 / self.cell_px).ceil() as usize).max(1);
        self.row_count = ((height as f64 / self.cell_px).ceil() as usize).max(1);
        self.starts.clear();
        self.starts
            .resize(self.column_count * self.row_count + 1, 0);
        for keypoint in keypoints {
            let cell = self.cell(&keypoint.position_px);
            self.starts[cell + 1] += 1;
        }
        for cell in 1..self.starts.len() {
            self.starts[cell] += self.starts[cell - 1];
        }
        let unplaced = Entry {
            position_px: Vector2::zeros(),
            keypoint_idx: 0,
            level: 0,
        };
        self.entries.clear();
        self.entries.resize(keypoints.len(), unplaced);
        // Filling from the back turns each start from "end of cell" into "start of cell".
        for (keypoint_idx, keypoint) in keypoints.iter().enumerate().rev() {
            let cell = self.cell(&keypoint.position_px);
            self.starts[cell + 1] -= 1;
            self.entries[self.starts[cell + 1] as usize] = Entry {
                position_px: keypoint.position_px,
                keypoint_idx: keypoint_idx as u32,
                level: keypoint.level,
            };
        }
        self.starts.remove(0);
        self.starts.push(keypoints.len() as u32);
    }

    /// Appends the indices of all keypoints within `radius_px` of `centre_px`.
    pub fn query(&self, centre_px: &Vector2<f64>, radius_px: f64, found: &mut Vec<u32>) {
        self.query_levels(centre_px, radius_px, 0..=u8::MAX, found);
    }

    /// [`FeatureGrid::query`] among keypoints of these pyramid levels.
    pub fn query_levels(
        &self,
        centre_px: &Vector2<f64>,
        radius_px: f64,
        levels: RangeInclusive<u8>,
        found: &mut Vec<u32>,
    ) {
        if self.entries.is_empty() || radius_px.is_nan() || radius_px < 0.0 {
            return;
        }
        let columns = self.columns(centre_px.x - radius_px)..=self.columns(centre_px.x + radius_px);
        let rows = self.rows(centre_px.y - radius_px)..=self.rows(centre_px.y + radius_px);
        let radius_squared = radius_px * radius_px;
        for row in rows {
            let first = self.starts[row * self.column_count + columns.start()] as usize;
            let last = self.starts[row * self.column_count + columns.end() + 1] as usize;
            for entry in &self.entries[first..last] {
                let near = (entry.position_px - centre_px).norm_squared() <= radius_squared;
                if near && levels.contains(&entry.level) {
                    found.push(entry.keypoint_idx);
                }
            }
        }
    }

    fn cell(&self, position_px: &Vector2<f64>) -> usize {
        self.rows(position_px.y) * self.column_count + self.columns(position_px.x)
    }

    // A cast from float saturates: negative and NaN become 0.
    fn columns(&self, x_px: f64) -> usize {
        ((x_px / self.cell_px) as usize).min(self.column_count - 1)
    }

    fn rows(&self, y_px: f64) -> usize {
        ((y_px / self.cell_px) as usize).min(self.row_count - 1)
    }
}

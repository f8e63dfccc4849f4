//! Which observations lie near a place or a line of the ideal plane.

use std::ops::RangeInclusive;

use nalgebra::Vector2;

use crate::Observation;
use crate::optics::Optics;

/// Cells along the longer side of the plane's visible part.
const CELLS_ALONG: f64 = 40.0;

/// Observations of one frame, sorted into square cells of the ideal plane.
#[derive(Clone, Debug, Default)]
pub(crate) struct PlaneGrid {
    origin: Vector2<f64>,
    cells_per_unit: f64,
    column_count: usize,
    row_count: usize,
    /// `entries[starts[c]..starts[c + 1]]` lie in cell `c`.
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    pub(crate) position: Vector2<f64>,
    pub(crate) observation_idx: u32,
    pub(crate) level: u8,
}

impl PlaneGrid {
    pub(crate) fn new(optics: &Optics, observations: &[Observation]) -> Self {
        let size = optics.plane_max - optics.plane_min;
        let cells_per_unit = CELLS_ALONG / size.max();
        let mut grid = Self {
            origin: optics.plane_min,
            cells_per_unit,
            column_count: (size.x * cells_per_unit).ceil() as usize + 1,
            row_count: (size.y * cells_per_unit).ceil() as usize + 1,
            starts: Vec::new(),
            entries: Vec::with_capacity(observations.len()),
        };
        grid.fill(observations);
        grid
    }

    fn fill(&mut self, observations: &[Observation]) {
        let cell_count = self.column_count * self.row_count;
        let cells: Vec<u32> = observations
            .iter()
            .map(|one| self.row(one.position.y) * self.column_count + self.column(one.position.x))
            .map(|cell| cell as u32)
            .collect();
        self.starts.resize(cell_count + 1, 0);
        for &cell in &cells {
            self.starts[cell as usize + 1] += 1;
        }
        for cell in 0..cell_count {
            self.starts[cell + 1] += self.starts[cell];
        }
        let mut order: Vec<u32> = (0..observations.len() as u32).collect();
        order.sort_by_key(|&idx| cells[idx as usize]);
        self.entries.extend(order.into_iter().map(|idx| Entry {
            position: observations[idx as usize].position,
            observation_idx: idx,
            level: observations[idx as usize].level,
        }));
    }

    /// Visits all observations of these levels within `radius` of `centre`.
    pub(crate) fn visit_near(
        &self,
        centre: &Vector2<f64>,
        radius: f64,
        levels: RangeInclusive<u8>,
        mut visit: impl FnMut(&Entry),
    ) {
        let (first, last) = (
            self.column(centre.x - radius),
            self.column(centre.x + radius),
        );
        let radius_squared = radius * radius;
        for row in self.row(centre.y - radius)..=self.row(centre.y + radius) {
            for entry in self.cells(row, first, last) {
                let near = (entry.position - centre).norm_squared() <= radius_squared;
                if near && levels.contains(&entry.level) {
                    visit(entry);
                }
            }
        }
    }

    /// Visits at least all observations within `margin` of a segment, and some more.
    pub(crate) fn visit_segment(
        &self,
        from: &Vector2<f64>,
        to: &Vector2<f64>,
        margin: f64,
        mut visit: impl FnMut(&Entry),
    ) {
        let (low, high) = (from.inf(to), from.sup(to));
        let (columns, rows) = (
            self.column(low.x - margin)..=self.column(high.x + margin),
            self.row(low.y - margin)..=self.row(high.y + margin),
        );
        let along = to - from;
        if along.y.abs() >= along.x.abs() {
            let slope = if along.y == 0.0 {
                0.0
            } else {
                along.x / along.y
            };
            for row in rows {
                let (a, b) = self.extent(row, self.origin.y, from.y, (low.y, high.y), margin);
                let (left, right) = (from.x + slope * a, from.x + slope * b);
                let first = self.column(left.min(right) - margin);
                let last = self.column(left.max(right) + margin);
                self.cells(row, first, last).iter().for_each(&mut visit);
            }
        } else {
            let slope = along.y / along.x;
            for column in columns {
                let (a, b) = self.extent(column, self.origin.x, from.x, (low.x, high.x), margin);
                let (top, bottom) = (from.y + slope * a, from.y + slope * b);
                let first = self.row(top.min(bottom) - margin);
                for row in first..=self.row(top.max(bottom) + margin) {
                    self.cells(row, column, column).iter().for_each(&mut visit);
                }
            }
        }
    }

    /// The part of a segment beside one row or column of cells, relative to the segment's start.
    fn extent(
        &self,
        cell: usize,
        origin: f64,
        start: f64,
        (low, high): (f64, f64),
        margin: f64,
    ) -> (f64, f64) {
        let begin = origin + cell as f64 / self.cells_per_unit - margin;
        let end = origin + (cell + 1) as f64 / self.cells_per_unit + margin;
        (begin.clamp(low, high) - start, end.clamp(low, high) - start)
    }

    fn cells(&self, row: usize, first_column: usize, last_column: usize) -> &[Entry] {
        let first = self.starts[row * self.column_count + first_column] as usize;
        let last = self.starts[row * self.column_count + last_column + 1] as usize;
        &self.entries[first..last.max(first)]
    }

    // A cast from float saturates: negative and NaN become 0.
    fn column(&self, x: f64) -> usize {
        (((x - self.origin.x) * self.cells_per_unit) as usize).min(self.column_count - 1)
    }

    fn row(&self, y: f64) -> usize {
        (((y - self.origin.y) * self.cells_per_unit) as usize).min(self.row_count - 1)
    }
}

#[cfg(test)]
mod tests {
    use camera::{CameraModel, Distortion, Intrinsics};
    use features::Descriptor;
    use proptest::prelude::*;

    use super::*;

    fn optics() -> Optics {
        let intrinsics = Intrinsics {
            fx: 300.0,
            fy: 300.0,
            cx: 160.0,
            cy: 120.0,
        };
        Optics::new(
            CameraModel::new(320, 240, intrinsics, Distortion::None).unwrap(),
            1.0,
        )
    }

    fn observation(x: f64, y: f64) -> Observation {
        Observation {
            position: Vector2::new(x, y),
            position_px: Vector2::zeros(),
            sigma: 1e-3,
            level: 0,
            angle_rad: 0.0,
            descriptor: Descriptor::default(),
            point: None,
        }
    }

    fn positions() -> impl Strategy<Value = Vec<(f64, f64)>> {
        prop::collection::vec((-0.53..0.53, -0.4..0.4), 0..120)
    }

    proptest! {
        #[test]
        fn finds_what_a_search_through_all_finds(
            positions in positions(),
            centre in (-0.7..0.7, -0.6..0.6),
            radius in 0.0..0.3,
        ) {
            let all: Vec<_> = positions.iter().map(|&(x, y)| observation(x, y)).collect();
            let centre = Vector2::new(centre.0, centre.1);
            let mut found = Vec::new();
            PlaneGrid::new(&optics(), &all)
                .visit_near(&centre, radius, 0..=7, |entry| found.push(entry.observation_idx));
            found.sort_unstable();
            let expected: Vec<u32> = (0..all.len() as u32)
                .filter(|&idx| (all[idx as usize].position - centre).norm() <= radius)
                .collect();
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn finds_all_beside_a_segment_and_none_twice(
            positions in positions(),
            from in (-0.7..0.7, -0.6..0.6),
            to in (-0.7..0.7, -0.6..0.6),
            margin in 0.0..0.05,
        ) {
            let all: Vec<_> = positions.iter().map(|&(x, y)| observation(x, y)).collect();
            let (from, to) = (Vector2::new(from.0, from.1), Vector2::new(to.0, to.1));
            let mut found = Vec::new();
            PlaneGrid::new(&optics(), &all)
                .visit_segment(&from, &to, margin, |entry| found.push(entry.observation_idx));
            let visit_count = found.len();
            found.sort_unstable();
            found.dedup();
            prop_assert_eq!(found.len(), visit_count);
            let along: Vector2<f64> = to - from;
            for (idx, one) in all.iter().enumerate() {
                let share = (one.position - from).dot(&along) / along.norm_squared();
                let nearest = from + along * share.clamp(0.0, 1.0);
                if (one.position - nearest).norm() < margin {
                    prop_assert!(found.contains(&(idx as u32)));
                }
            }
        }
    }
}

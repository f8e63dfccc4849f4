//! Cells over an image.

use nalgebra::Vector2;

/// The box around all features of an image on the ideal plane, cut into equal cells.
pub(super) struct ImageGrid {
    lowest: Vector2<f64>,
    extent: Vector2<f64>,
    /// Columns and rows.
    counts: [usize; 2],
}

impl ImageGrid {
    pub fn new((lowest, highest): (Vector2<f64>, Vector2<f64>), counts: [usize; 2]) -> Self {
        Self {
            lowest,
            extent: (highest - lowest).map(|length| length.max(1e-9)),
            counts,
        }
    }

    pub fn cell_count(&self) -> usize {
        self.counts[0] * self.counts[1]
    }

    /// Column and row; places outside are in the outermost cells.
    pub fn place(&self, position: &Vector2<f64>) -> [usize; 2] {
        [0, 1].map(|axis| {
            let share = (position[axis] - self.lowest[axis]) / self.extent[axis];
            let count = self.counts[axis];
            ((share * count as f64).max(0.0) as usize).min(count - 1)
        })
    }

    /// Row by row.
    pub fn cell(&self, position: &Vector2<f64>) -> usize {
        let [column, row] = self.place(position);
        row * self.counts[0] + column
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_places_are_in_some_cell() {
        let bounds = (Vector2::new(-1.0, -0.5), Vector2::new(1.0, 0.5));
        let grid = ImageGrid::new(bounds, [8, 6]);
        let cell = |x, y| grid.cell(&Vector2::new(x, y));
        assert_eq!(
            (cell(-1.0, -0.5), cell(1.0, 0.5)),
            (0, grid.cell_count() - 1)
        );
        assert_eq!(
            (cell(-9.0, -9.0), cell(9.0, 9.0)),
            (0, grid.cell_count() - 1)
        );
        assert_eq!((cell(0.1, -0.5), cell(-1.0, 0.01)), (4, 8 * 3));
        // One point alone has no extent.
        let grid = ImageGrid::new((bounds.0, bounds.0), [4, 4]);
        assert_eq!(grid.cell(&bounds.0), 0);
    }
}

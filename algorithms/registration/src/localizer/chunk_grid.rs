//! Which chunks may show something to a camera at a place.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::types::ChunkIdx;

/// Size as a power of two, and place along each axis in units of it.
type Cell = (i32, [i64; 3]);

/// Chunks in cells as large as the distance up to which they can be seen: a camera has to look
/// into the 27 cells about itself of each size that occurs. Extended chunk by chunk; what a look
/// costs depends on how many chunks stand about the camera, not on how many there are.
#[derive(Default)]
pub(super) struct ChunkGrid {
    cells: BTreeMap<Cell, BTreeSet<ChunkIdx>>,
    /// How many cells there are of each size.
    sizes: BTreeMap<i32, usize>,
}

/// Places beyond so many cells from the middle are in the outermost one.
const CELL_MAX: f64 = 1e15;

fn cell(centre: &Vector3<f64>, reach: f64) -> Cell {
    let size = reach.max(f64::MIN_POSITIVE).log2().ceil() as i32;
    let along = |axis: usize| {
        let cells = centre[axis] / f64::from(size).exp2();
        cells.floor().clamp(-CELL_MAX, CELL_MAX) as i64
    };
    (size, [along(0), along(1), along(2)])
}

impl ChunkGrid {
    /// - `reach`: a camera farther than this from `centre` sees nothing of the chunk.
    pub fn insert(&mut self, chunk: ChunkIdx, centre: &Vector3<f64>, reach: f64) {
        let cell = cell(centre, reach);
        let chunks = self.cells.entry(cell).or_insert_with(|| {
            *self.sizes.entry(cell.0).or_default() += 1;
            BTreeSet::new()
        });
        chunks.insert(chunk);
    }

    /// Takes out what was inserted with the same centre and reach.
    pub fn remove(&mut self, chunk: ChunkIdx, centre: &Vector3<f64>, reach: f64) {
        let cell = cell(centre, reach);
        let Some(chunks) = self.cells.get_mut(&cell) else {
            return;
        };
        chunks.remove(&chunk);
        if !chunks.is_empty() {
            return;
        }
        self.cells.remove(&cell);
        if let Some(count) = self.sizes.get_mut(&cell.0) {
            *count -= 1;
            if *count == 0 {
                self.sizes.remove(&cell.0);
            }
        }
    }

    /// All chunks within whose reach the place may be, and some more, in no order.
    pub fn near(&self, place: &Vector3<f64>) -> Vec<ChunkIdx> {
        let mut found = Vec::new();
        for size in self.sizes.keys() {
            let (_, [x, y, z]) = cell(place, f64::from(*size).exp2());
            for (x, y) in [-1, 0, 1]
                .iter()
                .flat_map(|dx| [-1, 0, 1].map(|dy| (x + dx, y + dy)))
            {
                let column = (*size, [x, y, z - 1])..=(*size, [x, y, z + 1]);
                found.extend(self.cells.range(column).flat_map(|(_, chunks)| chunks));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Chunks of two sizes along a line, one each unit.
    fn line(count: u64) -> ChunkGrid {
        let mut grid = ChunkGrid::default();
        for idx in 0..count {
            let reach = if idx % 2 == 0 { 3.0 } else { 11.0 };
            grid.insert(ChunkIdx(idx), &(Vector3::x() * idx as f64), reach);
        }
        grid
    }

    #[test]
    fn all_within_reach_are_found_and_no_more_in_a_larger_map() {
        let place = Vector3::new(50.3, 0.2, -0.1);
        let mut counts = Vec::new();
        for count in [100, 1000, 10_000] {
            let found = line(count).near(&place);
            for idx in 0..count {
                let apart = (place - Vector3::x() * idx as f64).norm();
                let reach = if idx % 2 == 0 { 3.0 } else { 11.0 };
                assert!(apart > reach || found.contains(&ChunkIdx(idx)), "{idx}");
            }
            counts.push(found.len());
        }
        assert_eq!(counts, [counts[0]; 3]);
        assert!(counts[0] < 32, "{counts:?}");
    }

    /// Goal: a map that is absurdly small, or a camera absurdly far from it, costs nobody anything.
    #[test]
    fn places_beyond_all_cells_are_looked_at_too() {
        let mut grid = ChunkGrid::default();
        let far = Vector3::new(-1e300, 1e25, f64::NAN);
        grid.insert(ChunkIdx(0), &far, 1e-9);
        assert_eq!(grid.near(&far), [ChunkIdx(0)]);
        assert!(grid.near(&Vector3::repeat(-2.5e14)).is_empty());
        grid.remove(ChunkIdx(0), &far, 1e-9);
        assert!(grid.cells.is_empty());
    }

    #[test]
    fn what_was_taken_out_is_gone() {
        let mut grid = line(60);
        for idx in 0..60 {
            let reach = if idx % 2 == 0 { 3.0 } else { 11.0 };
            grid.remove(ChunkIdx(idx), &(Vector3::x() * idx as f64), reach);
        }
        assert!(grid.near(&Vector3::zeros()).is_empty());
        assert!(grid.cells.is_empty() && grid.sizes.is_empty());
    }
}

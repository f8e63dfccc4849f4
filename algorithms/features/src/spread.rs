//! Few corners, well spread.

use crate::corners::Corner;
use crate::plane::Plane;

/// Side of the cells in which the lower threshold takes over.
const THRESHOLD_CELL_PX: usize = 32;

/// Drops the corners that are at or under the threshold, except in cells that have no other.
pub(crate) fn keep_strong_or_only(
    plane: &Plane,
    threshold: u8,
    strongest: &mut Vec<u8>,
    corners: &mut Vec<Corner>,
) {
    let column_count = plane.width().div_ceil(THRESHOLD_CELL_PX);
    let cell = |corner: &Corner| {
        usize::from(corner.y) / THRESHOLD_CELL_PX * column_count
            + usize::from(corner.x) / THRESHOLD_CELL_PX
    };
    strongest.clear();
    strongest.resize(column_count * plane.height().div_ceil(THRESHOLD_CELL_PX), 0);
    for corner in corners.iter() {
        let best = &mut strongest[cell(corner)];
        *best = corner.score().max(*best);
    }
    corners.retain(|corner| corner.score() > threshold || strongest[cell(corner)] <= threshold);
}

/// Chooses corners; keeps its buffer.
#[derive(Clone, Debug, Default)]
pub(crate) struct Selection {
    /// What comes first, in the uppermost bits, then the complement of the score, then the index.
    keys: Vec<u64>,
}

const FIRST_SHIFT: u32 = 40;
const SCORE_SHIFT: u32 = 32;

impl Selection {
    /// Indices of at most `count` corners, spread over the plane.
    ///
    /// The plane is cut into about as many square cells as corners are wanted: first come the
    /// strongest of each cell, then the second strongest, and so on; within one rank the stronger
    /// come first, of equals the first in reading order.
    pub(crate) fn choose(
        &mut self,
        plane: &Plane,
        corners: &[Corner],
        count: usize,
    ) -> impl Iterator<Item = usize> {
        self.keys.clear();
        if count > 0 {
            self.sort_by_cell(plane, corners, count);
            self.sort_by_rank();
            self.keys.truncate(count);
        }
        self.keys
            .iter()
            .map(|key| (key & ((1 << SCORE_SHIFT) - 1)) as usize)
    }

    fn sort_by_cell(&mut self, plane: &Plane, corners: &[Corner], count: usize) {
        let area = (plane.width() * plane.height()) as f64;
        let side = (area / count as f64).sqrt().max(1.0);
        let column_count = (plane.width() as f64 / side) as u64 + 1;
        self.keys
            .extend(corners.iter().enumerate().map(|(idx, corner)| {
                let column = (f64::from(corner.x) / side) as u64;
                let row = (f64::from(corner.y) / side) as u64;
                let cell = row * column_count + column;
                let weakness = u64::from(u8::MAX - corner.score());
                cell << FIRST_SHIFT | weakness << SCORE_SHIFT | idx as u64
            }));
        self.keys.sort_unstable();
    }

    /// Replaces the cell by the place within the cell.
    fn sort_by_rank(&mut self) {
        let (mut cell, mut rank) = (u64::MAX, 0);
        for key in &mut self.keys {
            rank = if *key >> FIRST_SHIFT == cell {
                rank + 1
            } else {
                0
            };
            cell = *key >> FIRST_SHIFT;
            *key = *key & ((1 << FIRST_SHIFT) - 1) | rank << FIRST_SHIFT;
        }
        self.keys.sort_unstable();
    }
}

//! Few corners, well spread.

use crate::corners::Corner;
use crate::plane::Plane;
use crate::structure::{self, Structure};

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
        *best = corner.score.max(*best);
    }
    corners.retain(|corner| corner.score > threshold || strongest[cell(corner)] <= threshold);
}

/// A corner with its strength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RatedCorner {
    pub(crate) corner: Corner,
    pub(crate) structure: Structure,
    /// 0 for the strongest of its cell.
    rank: u32,
    cell: u32,
}

/// Rates all corners and keeps at most `count`, spread over the plane.
///
/// The plane is cut into about as many square cells as corners are wanted: first come the strongest
/// of each cell, then the second strongest, and so on; within one rank the stronger come first.
pub(crate) fn keep_spread(
    plane: &Plane,
    corners: &[Corner],
    count: usize,
    rated: &mut Vec<RatedCorner>,
) {
    rated.clear();
    if count == 0 {
        return;
    }
    let area = (plane.width() * plane.height()) as f64;
    let side = (area / count as f64).sqrt().max(1.0);
    let column_count = (plane.width() as f64 / side) as u32 + 1;
    rated.extend(corners.iter().map(|corner| {
        let column = (f64::from(corner.x) / side) as u32;
        let row = (f64::from(corner.y) / side) as u32;
        RatedCorner {
            corner: *corner,
            structure: structure::measure(plane, usize::from(corner.x), usize::from(corner.y)),
            rank: 0,
            cell: row * column_count + column,
        }
    }));
    let position = |one: &RatedCorner| (one.corner.y, one.corner.x);
    rated.sort_unstable_by(|a, b| {
        let stronger = b.structure.response.total_cmp(&a.structure.response);
        a.cell
            .cmp(&b.cell)
            .then(stronger)
            .then(position(a).cmp(&position(b)))
    });
    for idx in 1..rated.len() {
        if rated[idx].cell == rated[idx - 1].cell {
            rated[idx].rank = rated[idx - 1].rank + 1;
        }
    }
    rated.sort_unstable_by(|a, b| {
        let stronger = b.structure.response.total_cmp(&a.structure.response);
        a.rank
            .cmp(&b.rank)
            .then(stronger)
            .then(position(a).cmp(&position(b)))
    });
    rated.truncate(count);
}

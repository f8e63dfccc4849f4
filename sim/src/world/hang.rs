//! What hangs on the walls of buildings: doors that stay closed, notices, windows.

use rand::{Rng, RngExt};

use super::room::Wall;
use super::{Finish, Panel};

/// How a wall is hung.
#[derive(Clone, Copy, Debug)]
pub struct Hanging {
    /// Between one thing and the next, on average.
    pub gap_m: f64,
    pub has_doors: bool,
    pub has_windows: bool,
}

/// In front of the wall by this.
const PROUD_M: f64 = 0.012;

pub fn hang(panels: &mut Vec<Panel>, wall: &Wall<'_>, hanging: &Hanging, rng: &mut impl Rng) {
    let mut cursor_m = 0.3 + rng.random_range(0.0..hanging.gap_m);
    while cursor_m < wall.length_m - 0.3 {
        let (finish, [width_m, height_m], low_m) = match rng.random_range(0..10) {
            0..3 if hanging.has_doors => (Finish::Door, [1.0, 2.08], 0.0),
            3..5 if hanging.has_windows => (Finish::Window, [1.5, 1.2], 0.95),
            _ => {
                let size_m = [rng.random_range(0.3..1.2), rng.random_range(0.3..0.9)];
                (Finish::Poster, size_m, rng.random_range(1.0..1.5))
            }
        };
        if let Some(clear_m) = wall.blocked_until_m(cursor_m, cursor_m + width_m) {
            cursor_m = clear_m;
            continue;
        }
        if cursor_m + width_m > wall.length_m - 0.1 {
            return;
        }
        let high_m = (low_m + height_m).min(wall.height_m - 0.05);
        let area = [[cursor_m, cursor_m + width_m], [low_m, high_m]];
        panels.push(wall.piece(area, PROUD_M, finish, rng.random()));
        cursor_m += width_m + hanging.gap_m * rng.random_range(0.2..1.8);
    }
}

//! A printed board on a bare wall.

use nalgebra::{Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::room::{Room, Shell};
use super::{Finish, Panel, World};

/// The middle of the board is this high.
pub const BOARD_HEIGHT_M: f64 = 1.3;
/// How far from the room's middle its wall is, along y.
pub const BOARD_WALL_M: f64 = 1.6;

impl World {
    /// A bare room with a board of about 1.8 × 1.4 m on the wall at +y.
    pub fn board(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0005);
        let size_m = Vector3::new(3.6, 2.0 * BOARD_WALL_M, 2.7);
        let shell = Shell {
            floor: Finish::Carpet,
            walls: &[Finish::Plaster],
            piece_m: 7.0,
        };
        let mut panels = Room::closed(Vector2::zeros(), size_m).shell(&shell, &mut rng);
        let (width_m, height_m) = (rng.random_range(1.6..2.0), rng.random_range(1.3..1.5));
        panels.push(Panel {
            corner: Vector3::new(
                -0.5 * width_m,
                BOARD_WALL_M - 0.01,
                BOARD_HEIGHT_M + 0.5 * height_m,
            ),
            right: Vector3::x(),
            down: -Vector3::z(),
            width_m,
            height_m,
            finish: Finish::Board,
            seed: rng.random(),
        });
        Self {
            lamps: vec![Vector3::new(rng.random_range(-1.0..1.0), -0.5, 2.6)],
            size_m,
            panels,
            contrast: 1.0,
        }
    }
}

//! A furnished room of middle size, calmer than the lab.

use nalgebra::{Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::hang::{Hanging, hang};
use super::room::{Room, Shell};
use super::{Finish, World, furnish, lamps};

impl World {
    /// A room of about 5.5 × 4.5 × 2.7 m with windows, posters and furniture along its walls.
    pub fn parlour(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0004);
        let size_m = Vector3::new(
            rng.random_range(4.8..6.4),
            rng.random_range(4.0..5.2),
            rng.random_range(2.5..2.9),
        );
        let room = Room::closed(Vector2::zeros(), size_m);
        let floors = [Finish::Carpet, Finish::Floor];
        let shell = Shell {
            floor: floors[rng.random_range(0..2)],
            walls: &[Finish::Plaster, Finish::Plaster, Finish::PaintedWall],
            piece_m: 7.0,
        };
        let mut world = Self {
            size_m,
            panels: room.shell(&shell, &mut rng),
            lamps: lamps(&size_m, &mut rng),
            contrast: 1.0,
        };
        let hanging = Hanging {
            gap_m: 1.0,
            has_doors: false,
            has_windows: true,
        };
        for wall in room.walls() {
            hang(&mut world.panels, &wall, &hanging, &mut rng);
        }
        furnish::along_walls(&mut world, &room, &mut rng);
        world
    }
}

//! A rectangle of corridors, as long as a city block.

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::hang::{Hanging, hang};
use super::room::{Room, Shell, Wall};
use super::{Cuboid, Finish, World, furnish};

const CORRIDOR_WIDTH_M: f64 = 2.5;
const HEIGHT_M: f64 = 2.7;
/// Pieces of floor, ceiling and wall; each is painted from its own seed.
const PIECE_M: f64 = 6.0;

/// Length and width of the rectangle along the corridors' middle: 300 m around.
pub fn corridor_outline_m(seed: u64) -> [f64; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0006);
    let length_m = rng.random_range(84.0..96.0);
    [length_m, 150.0 - length_m]
}

impl World {
    /// Four corridors around a block: doors, notices, windows, cupboards, and bare stretches.
    pub fn corridor(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0007);
        let [length_m, width_m] = corridor_outline_m(seed);
        let outer = Vector3::new(
            length_m + CORRIDOR_WIDTH_M,
            width_m + CORRIDOR_WIDTH_M,
            HEIGHT_M,
        );
        let mut world = Self {
            size_m: outer,
            panels: Vec::new(),
            lamps: Vec::new(),
            contrast: 1.0,
        };
        let inner = outer - Vector3::new(2.0, 2.0, 0.0) * CORRIDOR_WIDTH_M;
        lay_floors(&mut world, &inner, &mut rng);
        let room = Room::closed(Vector2::zeros(), outer);
        let mut walls: Vec<Wall<'_>> = room.walls().collect();
        walls.extend(block(&inner));
        for wall in walls {
            let shell = Shell {
                floor: Finish::Carpet,
                walls: &[
                    Finish::Plaster,
                    Finish::Plaster,
                    Finish::BrickWall,
                    Finish::PaintedWall,
                ],
                piece_m: PIECE_M,
            };
            wall.build(&shell, &mut world.panels, &mut rng);
            let hanging = Hanging {
                gap_m: 2.2,
                has_doors: true,
                has_windows: true,
            };
            hang(&mut world.panels, &wall, &hanging, &mut rng);
            furnish::along_corridor(&mut world, &wall, 7.0, &mut rng);
        }
        world
    }
}

/// The walls of the block in the middle, seen from outside: their room is the corridor.
fn block<'a>(size_m: &Vector3<f64>) -> [Wall<'a>; 4] {
    let (x, y) = (0.5 * size_m.x, 0.5 * size_m.y);
    let wall = |x, y, quarter_turns, length_m| {
        Wall::closed(Vector2::new(x, y), quarter_turns, [length_m, HEIGHT_M])
    };
    [
        wall(x, -y, 2, 2.0 * x),
        wall(x, y, 3, 2.0 * y),
        wall(-x, y, 0, 2.0 * x),
        wall(-x, -y, 1, 2.0 * y),
    ]
}

/// Floors, ceilings and lamps of the four sides; the long ones have the corners.
fn lay_floors(world: &mut World, inner: &Vector3<f64>, rng: &mut impl Rng) {
    let half = world.size_m * 0.5;
    let middle = |axis: usize| half[axis] - 0.5 * CORRIDOR_WIDTH_M;
    for side in 0..4 {
        let is_long = side % 2 == 0;
        let sign = if side < 2 { -1.0 } else { 1.0 };
        let length_m = if is_long { world.size_m.x } else { inner.y };
        let count = (length_m / PIECE_M).ceil();
        for piece in 0..count as usize {
            let along_m = ((piece as f64 + 0.5) / count - 0.5) * length_m;
            let [place, extents] = if is_long {
                [
                    [along_m, sign * middle(1)],
                    [length_m / count, CORRIDOR_WIDTH_M],
                ]
            } else {
                [
                    [sign * middle(0), along_m],
                    [CORRIDOR_WIDTH_M, length_m / count],
                ]
            };
            let cuboid = Cuboid {
                centre: Vector3::new(place[0], place[1], 0.5 * HEIGHT_M),
                half: Vector3::new(extents[0], extents[1], HEIGHT_M) * 0.5,
                yaw_rad: 0.0,
            };
            let floor = if rng.random_bool(0.6) {
                Finish::Carpet
            } else {
                Finish::Floor
            };
            let faces = [(-Vector3::z(), floor), (Vector3::z(), Finish::Ceiling)];
            let face = |(side, finish)| cuboid.inner_face(side, finish, rng.random());
            world.panels.extend(faces.map(face));
            world
                .lamps
                .push(Vector3::new(place[0], place[1], HEIGHT_M - 0.1));
        }
    }
}

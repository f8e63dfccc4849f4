//! A floor of an office: two corridors at a right angle with rooms beside them.

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::hang::{Hanging, hang};
use super::room::{Room, Shell, WALL_M, connect};
use super::{FURNITURE_DEPTH_M, Finish, World, furnish};

/// A world, and where one can walk in it.
pub struct Office {
    pub world: World,
    /// Beside the first corridor, from its −x end on, then those beside the second.
    pub stops: Vec<Stop>,
    /// Where the corridors' middles meet, and the far end of the second.
    pub corner: Vector2<f64>,
    pub end: Vector2<f64>,
}

/// A room with one door.
#[derive(Clone, Debug)]
pub struct Stop {
    /// In the middle of the corridor before the door.
    pub before: Vector2<f64>,
    /// Inside the door.
    pub inside: Vector2<f64>,
    /// A way around the room, clear of the furniture.
    pub around: [Vector2<f64>; 4],
    /// Whether it lies beside the second corridor.
    pub is_beyond_corner: bool,
}

const WIDTH_M: f64 = 2.0;
const HEIGHT_M: f64 = 2.6;
const FIRST_LENGTH_M: f64 = 22.0;
const SECOND_LENGTH_M: f64 = 14.0;
const DOOR_M: [f64; 2] = [0.95, 2.05];
/// Walkers stay this far from walls of rooms.
const INSET_M: f64 = FURNITURE_DEPTH_M + 0.45;

/// A row of rooms along a corridor.
struct Row {
    /// Where it begins, on the corridor's wall, and its direction.
    start: Vector2<f64>,
    along: Vector2<f64>,
    /// From the corridor into the rooms.
    outward: Vector2<f64>,
    length_m: f64,
    /// The corridor's wall, and that of the rooms.
    wall_idxs: [usize; 2],
    is_beyond_corner: bool,
}

impl Office {
    pub fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0008);
        let (half, width) = (0.5 * FIRST_LENGTH_M, WIDTH_M);
        let first_size = Vector3::new(FIRST_LENGTH_M, width, HEIGHT_M);
        let second_size = Vector3::new(width, SECOND_LENGTH_M, HEIGHT_M);
        let corner = Vector2::new(half + WALL_M + 0.5 * width, 0.0);
        let second_centre = corner + Vector2::y() * (0.5 * (SECOND_LENGTH_M - width));
        let mut corridors = [
            Room::closed(Vector2::zeros(), first_size),
            Room::closed(second_centre, second_size),
        ];
        let mut panels = Vec::new();
        let [first, second] = &mut corridors;
        let mouth = Vector2::new(half + 0.5 * WALL_M, 0.0);
        let mouth_size = [width - 0.3, 2.3];
        panels.extend(connect(
            [(first, 1), (second, 3)],
            &mouth,
            mouth_size,
            &mut rng,
        ));
        let mut stops = Vec::new();
        let mut rooms = Vec::new();
        for row in rows(&corner) {
            let corridor = &mut corridors[usize::from(row.is_beyond_corner)];
            let before = stops.len();
            row.build(corridor, &mut panels, &mut rooms, &mut stops, &mut rng);
            debug_assert!(stops.len() > before);
        }
        Self {
            world: furnished(panels, &corridors, &rooms, &mut rng),
            stops,
            corner,
            end: corner + Vector2::y() * (SECOND_LENGTH_M - 0.5 * width - 1.0),
        }
    }
}

fn rows(corner: &Vector2<f64>) -> [Row; 3] {
    let half = 0.5 * FIRST_LENGTH_M;
    let row = |x: f64, y: f64, along: Vector2<f64>, outward: Vector2<f64>| Row {
        start: Vector2::new(x, y),
        along,
        outward,
        length_m: FIRST_LENGTH_M,
        wall_idxs: if outward.y > 0.0 { [2, 0] } else { [0, 2] },
        is_beyond_corner: false,
    };
    [
        row(-half, 0.5 * WIDTH_M, Vector2::x(), Vector2::y()),
        row(-half, -0.5 * WIDTH_M, Vector2::x(), -Vector2::y()),
        Row {
            length_m: SECOND_LENGTH_M,
            wall_idxs: [1, 3],
            is_beyond_corner: true,
            ..row(
                corner.x + 0.5 * WIDTH_M,
                -0.5 * WIDTH_M,
                Vector2::y(),
                Vector2::x(),
            )
        },
    ]
}

impl Row {
    fn build(
        &self,
        corridor: &mut Room,
        panels: &mut Vec<super::Panel>,
        rooms: &mut Vec<Room>,
        stops: &mut Vec<Stop>,
        rng: &mut impl Rng,
    ) {
        let mut cursor_m = 0.0;
        loop {
            let width_m = rng.random_range(4.0..6.2);
            if cursor_m + width_m > self.length_m {
                return;
            }
            let depth_m = rng.random_range(4.0..5.4);
            let wall = self.start + self.along * (cursor_m + 0.5 * width_m);
            let centre = wall + self.outward * (WALL_M + 0.5 * depth_m);
            let size = self.along.abs() * width_m + self.outward.abs() * depth_m;
            let mut room = Room::closed(centre, size.push(HEIGHT_M));
            let door_m = cursor_m + rng.random_range(0.9..width_m - 0.9);
            let door = self.start + self.along * door_m + self.outward * (0.5 * WALL_M);
            let sides = [
                (&mut *corridor, self.wall_idxs[0]),
                (&mut room, self.wall_idxs[1]),
            ];
            panels.extend(connect(sides, &door, DOOR_M, rng));
            let reach = size * 0.5 - Vector2::repeat(INSET_M);
            let signs = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
            stops.push(Stop {
                before: door - self.outward * (0.5 * (WALL_M + WIDTH_M)),
                inside: door + self.outward * (0.5 * WALL_M + 1.0),
                around: signs.map(|(x, y)| centre + reach.component_mul(&Vector2::new(x, y))),
                is_beyond_corner: self.is_beyond_corner,
            });
            rooms.push(room);
            cursor_m += width_m + WALL_M;
        }
    }
}

fn furnished(
    panels: Vec<super::Panel>,
    corridors: &[Room; 2],
    rooms: &[Room],
    rng: &mut impl Rng,
) -> World {
    let span = FIRST_LENGTH_M + 2.0 * (WIDTH_M + 6.0);
    let mut world = World {
        size_m: Vector3::new(span, span, HEIGHT_M),
        panels,
        lamps: Vec::new(),
        contrast: 1.0,
    };
    for (room_idx, room) in corridors.iter().chain(rooms).enumerate() {
        let is_corridor = room_idx < corridors.len();
        let floors = [Finish::Carpet, Finish::Floor];
        let shell = Shell {
            floor: floors[rng.random_range(0..2)],
            walls: &[
                Finish::Plaster,
                Finish::Plaster,
                Finish::Plaster,
                Finish::PaintedWall,
            ],
            piece_m: 6.5,
        };
        world.panels.extend(room.shell(&shell, rng));
        let hanging = Hanging {
            gap_m: if is_corridor { 1.6 } else { 1.1 },
            has_doors: is_corridor,
            has_windows: !is_corridor,
        };
        for wall in room.walls() {
            hang(&mut world.panels, &wall, &hanging, rng);
            if is_corridor && wall.length_m > 5.0 {
                furnish::along_corridor(&mut world, &wall, 5.0, rng);
            }
        }
        if !is_corridor {
            furnish::along_walls(&mut world, room, rng);
        }
        hang_lamps(&mut world, room);
    }
    world
}

/// One lamp for every four metres.
fn hang_lamps(world: &mut World, room: &Room) {
    let counts = [room.size_m.x, room.size_m.y].map(|side_m| (side_m / 4.0).ceil());
    for column in 0..counts[0] as usize {
        for row in 0..counts[1] as usize {
            let shift = Vector2::new(
                ((column as f64 + 0.5) / counts[0] - 0.5) * room.size_m.x,
                ((row as f64 + 0.5) / counts[1] - 0.5) * room.size_m.y,
            );
            let lamp = (room.centre + shift).push(HEIGHT_M - 0.1);
            world.lamps.push(lamp);
        }
    }
}

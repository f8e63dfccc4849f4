//! Rooms of a building: upright boxes seen from within, whose walls may have openings.

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt};

use super::{Cuboid, Finish, Panel};

#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// On the floor.
    pub centre: Vector2<f64>,
    pub size_m: Vector3<f64>,
    /// In the walls at −y, +x, +y and −x.
    pub openings: [Vec<Opening>; 4],
}

/// A gap in a wall that reaches down to the floor, in metres along the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    pub from_m: f64,
    pub to_m: f64,
    pub height_m: f64,
}

/// One wall as seen from the room: it begins at `start`, on the floor, and its room lies to the
/// left of `along`.
#[derive(Clone, Copy, Debug)]
pub struct Wall<'a> {
    pub start: Vector3<f64>,
    pub along: Vector3<f64>,
    pub inward: Vector3<f64>,
    pub yaw_rad: f64,
    pub length_m: f64,
    pub height_m: f64,
    pub openings: &'a [Opening],
}

/// What floor, ceiling and walls are made of.
#[derive(Clone, Copy, Debug)]
pub struct Shell<'a> {
    pub floor: Finish,
    /// One of these for each piece of wall.
    pub walls: &'a [Finish],
    /// Longer walls, floors and ceilings are of several pieces.
    pub piece_m: f64,
}

/// Nothing stands nearer to an opening than this.
const OPENING_MARGIN_M: f64 = 0.4;

impl Room {
    pub fn closed(centre: Vector2<f64>, size_m: Vector3<f64>) -> Self {
        Self {
            centre,
            size_m,
            openings: Default::default(),
        }
    }

    pub fn wall(&self, wall_idx: usize) -> Wall<'_> {
        let yaw_rad = wall_idx as f64 * std::f64::consts::FRAC_PI_2;
        let half = self.size_m * 0.5;
        let (along, inward) = axes(yaw_rad);
        let half_length_m = along.abs().dot(&half);
        let corner = -along * half_length_m - inward * inward.abs().dot(&half);
        Wall {
            start: self.centre.push(0.0) + corner,
            along,
            inward,
            yaw_rad,
            length_m: 2.0 * half_length_m,
            height_m: self.size_m.z,
            openings: &self.openings[wall_idx],
        }
    }

    pub fn walls(&self) -> impl Iterator<Item = Wall<'_>> {
        (0..4).map(|wall_idx| self.wall(wall_idx))
    }

    /// Floor, ceiling and walls.
    pub fn shell(&self, shell: &Shell<'_>, rng: &mut impl Rng) -> Vec<Panel> {
        let mut panels = Vec::new();
        let [x, y, z] = [self.size_m.x, self.size_m.y, self.size_m.z];
        let counts = [x, y].map(|side_m| (side_m / shell.piece_m).ceil().max(1.0));
        for column in 0..counts[0] as usize {
            for row in 0..counts[1] as usize {
                let fraction = Vector2::new(
                    (column as f64 + 0.5) / counts[0] - 0.5,
                    (row as f64 + 0.5) / counts[1] - 0.5,
                );
                let piece = Cuboid {
                    centre: (self.centre + fraction.component_mul(&Vector2::new(x, y)))
                        .push(0.5 * z),
                    half: Vector3::new(x / counts[0], y / counts[1], z) * 0.5,
                    yaw_rad: 0.0,
                };
                panels.push(piece.inner_face(-Vector3::z(), shell.floor, rng.random()));
                panels.push(piece.inner_face(Vector3::z(), Finish::Ceiling, rng.random()));
            }
        }
        for wall in self.walls() {
            wall.build(shell, &mut panels, rng);
        }
        panels
    }
}

/// Connects two rooms by an opening about `place`, a point on the floor between their walls, and
/// returns what is seen in the thickness of the wall.
pub fn connect(
    rooms: [(&mut Room, usize); 2],
    place: &Vector2<f64>,
    size_m: [f64; 2],
    rng: &mut impl Rng,
) -> Vec<Panel> {
    let [width_m, height_m] = size_m;
    let mut middle = Vector3::zeros();
    let mut along = Vector3::x();
    for (room, wall_idx) in rooms {
        let wall = room.wall(wall_idx);
        let along_m = (place.push(0.0) - wall.start).dot(&wall.along);
        middle += 0.5 * (wall.start + wall.along * along_m);
        along = wall.along;
        let opening = Opening {
            from_m: along_m - 0.5 * width_m,
            to_m: along_m + 0.5 * width_m,
            height_m,
        };
        let openings = &mut room.openings[wall_idx];
        openings.push(opening);
        openings.sort_by(|a, b| a.from_m.total_cmp(&b.from_m));
    }
    let across = Vector3::z().cross(&along);
    // The middle lies between the walls, so twice its distance from either is their gap.
    let gap = Cuboid {
        centre: middle + Vector3::z() * (0.5 * height_m),
        half: along.abs() * (0.5 * width_m)
            + across.abs() * (0.5 * WALL_M)
            + Vector3::z() * (0.5 * height_m),
        yaw_rad: 0.0,
    };
    [
        (along, Finish::Plaster),
        (-along, Finish::Plaster),
        (Vector3::z(), Finish::Plaster),
        (-Vector3::z(), Finish::Wood),
    ]
    .into_iter()
    .map(|(side, finish)| gap.inner_face(side, finish, rng.random()))
    .collect()
}

/// The thickness of walls between rooms.
pub const WALL_M: f64 = 0.15;

fn axes(yaw_rad: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (sine, cosine) = (yaw_rad.sin().round(), yaw_rad.cos().round());
    (
        Vector3::new(cosine, sine, 0.0),
        Vector3::new(-sine, cosine, 0.0),
    )
}

impl Wall<'_> {
    /// The wall that begins here and runs in the direction `quarter_turns` from x.
    pub fn closed(
        start: Vector2<f64>,
        quarter_turns: usize,
        [length_m, height_m]: [f64; 2],
    ) -> Self {
        let yaw_rad = quarter_turns as f64 * std::f64::consts::FRAC_PI_2;
        let (along, inward) = axes(yaw_rad);
        Self {
            start: start.push(0.0),
            along,
            inward,
            yaw_rad,
            length_m,
            height_m,
            openings: &[],
        }
    }

    /// Adds the pieces between the openings, and those above them.
    pub fn build(&self, shell: &Shell<'_>, panels: &mut Vec<Panel>, rng: &mut impl Rng) {
        let mut from_m = 0.0;
        let end = Opening {
            from_m: self.length_m,
            to_m: self.length_m,
            height_m: self.height_m,
        };
        for opening in self.openings.iter().chain([&end]) {
            let count = ((opening.from_m - from_m) / shell.piece_m).ceil().max(1.0);
            let piece_m = (opening.from_m - from_m) / count;
            for piece in 0..count as usize {
                let left_m = from_m + piece_m * piece as f64;
                let finish = shell.walls[rng.random_range(0..shell.walls.len())];
                let area = [[left_m, left_m + piece_m], [0.0, self.height_m]];
                panels.push(self.piece(area, 0.0, finish, rng.random()));
            }
            if opening.height_m < self.height_m {
                let area = [
                    [opening.from_m, opening.to_m],
                    [opening.height_m, self.height_m],
                ];
                panels.push(self.piece(area, 0.0, shell.walls[0], rng.random()));
            }
            from_m = opening.to_m;
        }
    }

    /// A rectangle so far in front of the wall: its extents along the wall, and its heights.
    pub fn piece(
        &self,
        [[from_m, to_m], [low_m, high_m]]: [[f64; 2]; 2],
        in_front_m: f64,
        finish: Finish,
        seed: u64,
    ) -> Panel {
        Panel {
            corner: self.start
                + self.along * to_m
                + self.inward * in_front_m
                + Vector3::z() * high_m,
            right: -self.along,
            down: -Vector3::z(),
            width_m: to_m - from_m,
            height_m: high_m - low_m,
            finish,
            seed,
        }
    }

    /// Where the wall is free again, if something between these would stand in an opening.
    pub fn blocked_until_m(&self, from_m: f64, to_m: f64) -> Option<f64> {
        let is_blocking = |opening: &&Opening| {
            from_m < opening.to_m + OPENING_MARGIN_M && to_m > opening.from_m - OPENING_MARGIN_M
        };
        let blocking = self.openings.iter().rfind(is_blocking);
        blocking.map(|opening| opening.to_m + OPENING_MARGIN_M)
    }
}

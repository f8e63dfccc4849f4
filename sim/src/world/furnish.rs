//! Furniture: what is put along the walls and in the middle of a lab.

use nalgebra::Vector3;
use rand::{Rng, RngExt};

use super::room::{Room, Wall};
use super::{Cuboid, FURNITURE_DEPTH_M, Finish, World};

/// A place along a wall: `along` and `inward` are unit vectors, `start` is on the floor.
struct Place {
    start: Vector3<f64>,
    along: Vector3<f64>,
    inward: Vector3<f64>,
    yaw_rad: f64,
}

/// Free floor in front of each corner of the room.
const CORNER_M: f64 = 0.75;

/// Puts one piece after the other along each wall of a room, with gaps that leave the wall in
/// sight, and none before an opening.
pub fn along_walls(world: &mut World, room: &Room, rng: &mut impl Rng) {
    for wall in room.walls() {
        let mut cursor_m = CORNER_M + rng.random_range(0.0..0.4);
        loop {
            let width_m = rng.random_range(0.6..1.5);
            if cursor_m + width_m > wall.length_m - CORNER_M {
                break;
            }
            if let Some(clear_m) = wall.blocked_until_m(cursor_m, cursor_m + width_m) {
                cursor_m = clear_m;
                continue;
            }
            let place = Place {
                start: wall.start + wall.along * cursor_m,
                along: wall.along,
                inward: wall.inward,
                yaw_rad: wall.yaw_rad,
            };
            furnish(world, &place, width_m, rng);
            cursor_m += width_m + rng.random_range(0.25..0.9);
        }
    }
}

/// What stands in corridors: now and then a flat cupboard or a stack of boxes.
pub fn along_corridor(world: &mut World, wall: &Wall<'_>, gap_m: f64, rng: &mut impl Rng) {
    let mut cursor_m = CORNER_M + rng.random_range(0.0..gap_m);
    while cursor_m + 1.5 < wall.length_m - CORNER_M {
        let width_m = rng.random_range(0.5..1.3);
        if let Some(clear_m) = wall.blocked_until_m(cursor_m, cursor_m + width_m) {
            cursor_m = clear_m;
            continue;
        }
        let extents = Vector3::new(
            width_m,
            rng.random_range(0.25..0.4),
            rng.random_range(0.45..1.9),
        );
        let middle = wall.start + wall.along * (cursor_m + 0.5 * width_m);
        let bottom = middle + wall.inward * (0.5 * extents.y + 0.02);
        let cupboard = Cuboid::standing(bottom, extents, wall.yaw_rad);
        let finishes = [
            Finish::Metal,
            Finish::Wood,
            Finish::Crate,
            Finish::Cardboard,
        ];
        let finish = finishes[rng.random_range(0..finishes.len())];
        add(world, cupboard, finish, rng);
        cursor_m += width_m + rng.random_range(0.3 * gap_m..1.7 * gap_m);
    }
}

/// A low table with boxes where the ground vehicle drives around.
pub fn pile(world: &mut World, rng: &mut impl Rng) {
    let place = Place {
        start: Vector3::new(-0.5, -0.3, 0.0),
        along: Vector3::x(),
        inward: Vector3::y(),
        yaw_rad: 0.0,
    };
    table(world, &place, 1.0, rng);
}

fn furnish(world: &mut World, place: &Place, width_m: f64, rng: &mut impl Rng) {
    match rng.random_range(0..10) {
        0..3 => shelf(world, place, width_m, rng),
        3..5 => table(world, place, width_m.max(0.9), rng),
        5..7 => cabinet(world, place, width_m.min(1.0), rng),
        7 => barrel(world, place, rng),
        _ => crates(world, place, width_m, rng),
    }
}

impl Place {
    fn point(&self, along_m: f64, inward_m: f64, height_m: f64) -> Vector3<f64> {
        self.start + self.along * along_m + self.inward * inward_m + Vector3::z() * height_m
    }
}

fn add(world: &mut World, cuboid: Cuboid, finish: Finish, rng: &mut impl Rng) {
    world.panels.extend(cuboid.outer_faces(finish, rng));
}

fn shelf(world: &mut World, place: &Place, width_m: f64, rng: &mut impl Rng) {
    let depth_m = rng.random_range(0.34..0.46);
    let level_count = rng.random_range(3..5);
    let spacing_m = rng.random_range(0.42..0.52);
    let height_m = spacing_m * f64::from(level_count);
    for along_m in [0.02, width_m - 0.02] {
        let extents = Vector3::new(0.04, depth_m, height_m + 0.1);
        let bottom = place.point(along_m, 0.5 * depth_m + 0.02, 0.0);
        let upright = Cuboid::standing(bottom, extents, place.yaw_rad);
        add(world, upright, Finish::Metal, rng);
    }
    for level in 0..=level_count {
        let level_m = 0.08 + spacing_m * f64::from(level);
        let bottom = place.point(0.5 * width_m, 0.5 * depth_m + 0.02, level_m - 0.03);
        let extents = Vector3::new(width_m - 0.1, depth_m, 0.03);
        let board = Cuboid::standing(bottom, extents, place.yaw_rad);
        add(world, board, Finish::Wood, rng);
        if level < level_count || rng.random_bool(0.6) {
            let row = Row {
                from_m: 0.07,
                to_m: width_m - 0.07,
                depth_m,
                base_m: level_m,
                height_max_m: spacing_m - 0.06,
            };
            boxes(world, place, &row, rng);
        }
    }
}

fn table(world: &mut World, place: &Place, width_m: f64, rng: &mut impl Rng) {
    let depth_m = rng.random_range(0.55..0.62);
    let height_m = rng.random_range(0.68..0.78);
    let middle_m = 0.5 * depth_m + 0.02;
    for along_m in [0.05, width_m - 0.05] {
        for inward_m in [0.07, depth_m - 0.03] {
            let bottom = place.point(along_m, inward_m, 0.0);
            let extents = Vector3::new(0.05, 0.05, height_m - 0.04);
            let leg = Cuboid::standing(bottom, extents, place.yaw_rad);
            add(world, leg, Finish::Metal, rng);
        }
    }
    let bottom = place.point(0.5 * width_m, middle_m, height_m - 0.04);
    let extents = Vector3::new(width_m, depth_m, 0.04);
    let top = Cuboid::standing(bottom, extents, place.yaw_rad);
    add(world, top, Finish::Wood, rng);
    let row = Row {
        from_m: 0.05,
        to_m: width_m - 0.05,
        depth_m,
        base_m: height_m,
        height_max_m: 0.45,
    };
    boxes(world, place, &row, rng);
    if rng.random_bool(0.7) {
        let under = Row {
            from_m: 0.12,
            to_m: width_m - 0.12,
            depth_m: depth_m - 0.1,
            base_m: 0.0,
            height_max_m: height_m - 0.1,
        };
        boxes(world, place, &under, rng);
    }
}

fn cabinet(world: &mut World, place: &Place, width_m: f64, rng: &mut impl Rng) {
    let depth_m = rng.random_range(0.38..0.5);
    let height_m = rng.random_range(0.9..2.0);
    let bottom = place.point(0.5 * width_m, 0.5 * depth_m + 0.02, 0.0);
    let extents = Vector3::new(width_m, depth_m, height_m);
    let body = Cuboid::standing(bottom, extents, place.yaw_rad);
    add(world, body, Finish::Metal, rng);
    if height_m < 1.6 {
        let row = Row {
            from_m: 0.03,
            to_m: width_m - 0.03,
            depth_m,
            base_m: height_m,
            height_max_m: 0.4,
        };
        boxes(world, place, &row, rng);
    }
}

/// Ten flat sides stand for a round one.
fn barrel(world: &mut World, place: &Place, rng: &mut impl Rng) {
    let radius_m = rng.random_range(0.24..0.3);
    let height_m = rng.random_range(0.8..1.2);
    let centre = place.point(0.3, radius_m + 0.03, 0.0);
    let side_count = 10;
    let angle_rad = std::f64::consts::TAU / f64::from(side_count);
    let width_m = 2.0 * radius_m * (0.5 * angle_rad).tan();
    let extents = Vector3::new(2.0 * radius_m, width_m, height_m);
    for side in 0..side_count {
        let slice = Cuboid::standing(centre, extents, angle_rad * f64::from(side));
        let faces = slice.outer_faces(Finish::Metal, rng);
        world.panels.extend(faces.into_iter().take(1));
    }
    let lid_m = radius_m * 1.3;
    let lid = Vector3::new(lid_m, lid_m, 0.03);
    let top = Cuboid::standing(centre + Vector3::z() * height_m, lid, 0.3);
    add(world, top, Finish::Wood, rng);
}

fn crates(world: &mut World, place: &Place, width_m: f64, rng: &mut impl Rng) {
    let mut base_m = 0.0;
    let mut width_left_m = width_m.min(0.9);
    for _ in 0..rng.random_range(1..4) {
        let extents = Vector3::new(
            width_left_m * rng.random_range(0.75..0.95),
            rng.random_range(0.38..0.52),
            rng.random_range(0.3..0.6),
        );
        let bottom = place.point(0.5 * width_m, 0.34, base_m);
        let yaw_rad = place.yaw_rad + rng.random_range(-0.12..0.12);
        let stacked = Cuboid::standing(bottom, extents, yaw_rad);
        add(world, stacked, Finish::Crate, rng);
        base_m += extents.z;
        width_left_m = extents.x;
    }
}

/// Where boxes stand side by side.
struct Row {
    from_m: f64,
    to_m: f64,
    depth_m: f64,
    base_m: f64,
    height_max_m: f64,
}

fn boxes(world: &mut World, place: &Place, row: &Row, rng: &mut impl Rng) {
    let mut cursor_m = row.from_m + rng.random_range(0.0..0.15);
    loop {
        let width_m = rng.random_range(0.14..0.42);
        if cursor_m + width_m > row.to_m {
            return;
        }
        let depth_m = (row.depth_m * rng.random_range(0.55..0.8)).min(FURNITURE_DEPTH_M);
        let height_m = row.height_max_m * rng.random_range(0.4..1.0);
        let inward_m = 0.5 * row.depth_m + 0.04 + rng.random_range(-0.03..0.03);
        let bottom = place.point(cursor_m + 0.5 * width_m, inward_m, row.base_m);
        let yaw_rad = place.yaw_rad + rng.random_range(-0.15..0.15);
        let extents = Vector3::new(width_m * 0.9, depth_m, height_m);
        let finish = if rng.random_bool(0.65) {
            Finish::Cardboard
        } else {
            Finish::Crate
        };
        add(
            world,
            Cuboid::standing(bottom, extents, yaw_rad),
            finish,
            rng,
        );
        cursor_m += width_m + rng.random_range(0.02..0.2);
    }
}

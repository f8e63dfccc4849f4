//! A room and what stands in it, as rectangles with a finish.

mod board;
mod corridor;
mod furnish;
mod hang;
mod office;
mod panel;
mod parlour;
mod room;
mod twin;
mod visibility;

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub use board::{BOARD_HEIGHT_M, BOARD_WALL_M};
pub use corridor::corridor_outline_m;
pub use office::{Office, Stop};
pub use panel::{Cuboid, Finish, Panel};
use room::Room;
pub use twin::Likeness;
pub use visibility::Surroundings;

/// Seeded rooms. The site frame's origin is on the floor in the middle, x along the longer side,
/// z up.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Length, width and height of the room, or of the box around all rooms.
    pub size_m: Vector3<f64>,
    pub panels: Vec<Panel>,
    pub lamps: Vec<Vector3<f64>>,
    /// How much of the finishes' contrast is painted, from 0 to 1.
    pub contrast: f32,
}

/// Furniture stands at most this far into the room from any wall.
pub const FURNITURE_DEPTH_M: f64 = 0.7;

impl World {
    /// A laboratory of about 10 × 8 × 3 m: shelves, tables, crates and posters along the walls,
    /// and one pile in the middle.
    pub fn lab(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0001);
        let size_m = Vector3::new(
            rng.random_range(9.7..10.3),
            rng.random_range(7.8..8.3),
            rng.random_range(2.9..3.2),
        );
        let mut world = Self {
            size_m,
            panels: room(&size_m, &mut rng),
            lamps: lamps(&size_m, &mut rng),
            contrast: 1.0,
        };
        let whole = Room::closed(Vector2::zeros(), size_m);
        furnish::along_walls(&mut world, &whole, &mut rng);
        furnish::pile(&mut world, &mut rng);
        world
    }

    /// Whether a point is inside the room.
    pub fn encloses(&self, point_in_site: &Vector3<f64>) -> bool {
        let half = self.size_m * 0.5;
        point_in_site.x.abs() < half.x
            && point_in_site.y.abs() < half.y
            && (0.0..self.size_m.z).contains(&point_in_site.z)
    }
}

/// Floor, ceiling and the walls at +x, +y, −x, −y.
fn room(size_m: &Vector3<f64>, rng: &mut impl Rng) -> Vec<Panel> {
    let inside_out = Cuboid {
        centre: Vector3::new(0.0, 0.0, 0.5 * size_m.z),
        half: size_m * 0.5,
        yaw_rad: 0.0,
    };
    let mut panels = vec![
        inside_out.inner_face(-Vector3::z(), Finish::Floor, rng.random()),
        inside_out.inner_face(Vector3::z(), Finish::Ceiling, rng.random()),
    ];
    let walls = [Vector3::x(), Vector3::y(), -Vector3::x(), -Vector3::y()];
    let first_is_brick = rng.random_bool(0.5);
    for (idx, outward) in walls.into_iter().enumerate() {
        let finish = if (idx % 2 == 0) == first_is_brick {
            Finish::BrickWall
        } else {
            Finish::PaintedWall
        };
        panels.push(inside_out.inner_face(outward, finish, rng.random()));
    }
    panels
}

fn lamps(size_m: &Vector3<f64>, rng: &mut impl Rng) -> Vec<Vector3<f64>> {
    let mut lamps = Vec::new();
    for x in [-0.3, 0.0, 0.3] {
        for y in [-0.25, 0.25] {
            let shift = Vector3::new(
                rng.random_range(-0.4..0.4),
                rng.random_range(-0.4..0.4),
                0.0,
            );
            lamps.push(Vector3::new(x * size_m.x, y * size_m.y, size_m.z - 0.1) + shift);
        }
    }
    lamps
}

#[cfg(test)]
mod tests;

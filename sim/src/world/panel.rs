//! Rectangles, and boxes made of them.

use nalgebra::Vector3;
use rand::{Rng, RngExt};

/// What a rectangle looks like; the picture itself is painted from its seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    Floor,
    Ceiling,
    BrickWall,
    PaintedWall,
    Wood,
    Metal,
    Cardboard,
    Crate,
    /// A light wall with little on it; some pieces are nearly bare.
    Plaster,
    /// A closed door with its frame and sign.
    Door,
    /// Blurred light behind crossbars.
    Window,
    /// A sheet with a picture or writing.
    Poster,
    Carpet,
    /// Something printed all over, as in the middle of a shop's leaflet.
    Board,
}

/// A rectangle in the site frame that is seen from one side.
///
/// Seen from that side `right` points right and `down` points down, so that
/// `right × down` points into the surface, as the camera's axes do.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// The top left corner.
    pub corner: Vector3<f64>,
    pub right: Vector3<f64>,
    pub down: Vector3<f64>,
    pub width_m: f64,
    pub height_m: f64,
    pub finish: Finish,
    pub seed: u64,
}

impl Panel {
    /// The normal on the visible side.
    pub fn normal(&self) -> Vector3<f64> {
        -self.right.cross(&self.down)
    }

    /// The point `(u, v)` metres right of and below the corner.
    pub fn point(&self, u_m: f64, v_m: f64) -> Vector3<f64> {
        self.corner + self.right * u_m + self.down * v_m
    }

    /// The corners, clockwise from the top left.
    pub fn corners(&self) -> [Vector3<f64>; 4] {
        let (w, h) = (self.width_m, self.height_m);
        [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(|(u, v)| self.point(u, v))
    }
}

/// An upright box, turned about the vertical.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cuboid {
    pub centre: Vector3<f64>,
    /// Half the extents along the box's own axes.
    pub half: Vector3<f64>,
    pub yaw_rad: f64,
}

impl Cuboid {
    /// A box that stands with its bottom at `bottom`.
    pub fn standing(bottom: Vector3<f64>, extents: Vector3<f64>, yaw_rad: f64) -> Self {
        Self {
            centre: bottom + Vector3::z() * (0.5 * extents.z),
            half: extents * 0.5,
            yaw_rad,
        }
    }

    /// The point at these offsets along the box's own axes from its centre.
    pub fn point(&self, offset: &Vector3<f64>) -> Vector3<f64> {
        self.centre + self.turned(offset)
    }

    /// The faces that can be seen from outside: sides and top, and the bottom if it hangs.
    pub fn outer_faces(&self, finish: Finish, rng: &mut impl Rng) -> Vec<Panel> {
        let mut faces = self.sides_and_top(finish, rng);
        if self.centre.z - self.half.z > 0.05 {
            faces.push(self.bottom(finish, rng));
        }
        faces
    }

    /// All six faces, as seen from outside.
    pub fn all_faces(&self, finish: Finish, rng: &mut impl Rng) -> Vec<Panel> {
        let mut faces = self.sides_and_top(finish, rng);
        faces.push(self.bottom(finish, rng));
        faces
    }

    fn sides_and_top(&self, finish: Finish, rng: &mut impl Rng) -> Vec<Panel> {
        let sides = [Vector3::x(), Vector3::y(), -Vector3::x(), -Vector3::y()];
        let normals = sides.into_iter().chain([Vector3::z()]);
        normals
            .map(|normal| self.face(normal, normal, finish, rng.random()))
            .collect()
    }

    fn bottom(&self, finish: Finish, rng: &mut impl Rng) -> Panel {
        self.face(-Vector3::z(), -Vector3::z(), finish, rng.random())
    }

    /// The face on the side of `outward`, as seen from within.
    pub fn inner_face(&self, outward: Vector3<f64>, finish: Finish, seed: u64) -> Panel {
        self.face(outward, -outward, finish, seed)
    }

    /// The face on the side of `side`, seen from where `normal` points; both along box axes.
    fn face(&self, side: Vector3<f64>, normal: Vector3<f64>, finish: Finish, seed: u64) -> Panel {
        let down = if normal.z.abs() > 0.5 {
            -Vector3::y()
        } else {
            -Vector3::z()
        };
        let right = normal.cross(&down);
        let middle = side.component_mul(&self.half);
        let (half_width, half_height) = (right.abs().dot(&self.half), down.abs().dot(&self.half));
        let corner = middle - right * half_width - down * half_height;
        Panel {
            corner: self.point(&corner),
            right: self.turned(&right),
            down: self.turned(&down),
            width_m: 2.0 * half_width,
            height_m: 2.0 * half_height,
            finish,
            seed,
        }
    }

    fn turned(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        let (sine, cosine) = self.yaw_rad.sin_cos();
        Vector3::new(
            cosine * vector.x - sine * vector.y,
            sine * vector.x + cosine * vector.y,
            vector.z,
        )
    }
}

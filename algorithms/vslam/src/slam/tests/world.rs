//! Textured planes, ray by ray.

use camera::{CameraModel, Distortion, Image, Intrinsics};
use nalgebra::{Rotation3, Vector3};

pub const WIDTH: usize = 320;
pub const HEIGHT: usize = 240;
const FOCAL_PX: f64 = 260.0;

pub fn camera() -> CameraModel {
    let intrinsics = Intrinsics {
        fx: FOCAL_PX,
        fy: FOCAL_PX,
        cx: 159.5,
        cy: 119.5,
    };
    CameraModel::new(WIDTH, HEIGHT, intrinsics, Distortion::None)
        .expect("the constants are a camera")
}

/// The same field of view, with a quarter of the pixels.
pub fn coarse_camera() -> CameraModel {
    let intrinsics = Intrinsics {
        fx: FOCAL_PX / 2.0,
        fy: FOCAL_PX / 2.0,
        cx: 79.5,
        cy: 59.5,
    };
    CameraModel::new(WIDTH / 2, HEIGHT / 2, intrinsics, Distortion::None)
        .expect("the constants are a camera")
}

/// What the coarse camera sees where the other saw this: each of its pixels gathers four.
pub fn coarsened(image: &Image) -> Image {
    let mut coarse = Image::filled(WIDTH / 2, HEIGHT / 2, 0);
    for (idx, pixel) in coarse.pixels_mut().iter_mut().enumerate() {
        let (x, y) = (idx % (WIDTH / 2) * 2, idx / (WIDTH / 2) * 2);
        let four = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
        let sum: u16 = four.iter().map(|&(x, y)| u16::from(image.get(x, y))).sum();
        *pixel = ((sum + 2) / 4) as u8;
    }
    coarse
}

/// Where a camera stands; x right, y down, z forward at zero angles.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    pub position: Vector3<f64>,
    pub yaw_rad: f64,
    pub pitch_rad: f64,
}

impl Pose {
    pub fn world_from_camera(&self) -> Rotation3<f64> {
        Rotation3::from_euler_angles(self.pitch_rad, self.yaw_rad, 0.0)
    }
}

/// A wall at 4 m, a floor, and two boards before the wall.
pub struct World {
    seed: u32,
    /// After so many patches the texture of each surface begins anew.
    period: i32,
}

impl World {
    pub fn new(seed: u32) -> Self {
        let period = i32::MAX;
        Self { seed, period }
    }

    /// A world in which one place looks much like another.
    pub fn repeating(seed: u32, period: i32) -> Self {
        Self { seed, period }
    }

    pub fn render(&self, pose: &Pose) -> Image {
        let rotation = pose.world_from_camera();
        let mut pixels = Vec::with_capacity(WIDTH * HEIGHT);
        for row in 0..HEIGHT {
            for column in 0..WIDTH {
                let ray = rotation
                    * Vector3::new(
                        (column as f64 - 159.5) / FOCAL_PX,
                        (row as f64 - 119.5) / FOCAL_PX,
                        1.0,
                    );
                pixels.push(self.shade(&pose.position, &ray));
            }
        }
        Image::from_pixels(WIDTH, HEIGHT, pixels).expect("every pixel has a shade")
    }

    fn shade(&self, origin: &Vector3<f64>, ray: &Vector3<f64>) -> u8 {
        let boards = [(-1.1..-0.2, -0.7..0.4, 2.6), (0.7..1.5, -0.2..0.8, 3.1)];
        for (board, (x_range, y_range, z)) in boards.into_iter().enumerate() {
            let hit = origin + ray * ((z - origin.z) / ray.z);
            if x_range.contains(&hit.x) && y_range.contains(&hit.y) {
                return self.texture(board as u32 + 2, hit.x, hit.y);
            }
        }
        let wall = origin + ray * ((4.0 - origin.z) / ray.z);
        if ray.y > 1e-9 && wall.y > 1.2 {
            let floor = origin + ray * ((1.2 - origin.y) / ray.y);
            return self.texture(1, floor.x, floor.z);
        }
        self.texture(0, wall.x, wall.y)
    }

    /// Patches of one shade each in three sizes, so that there are corners near and far; blended
    /// at their borders over about a pixel.
    fn texture(&self, surface: u32, u: f64, v: f64) -> u8 {
        let mut value = 0.0;
        for (octave, (size, weight)) in [(0.4, 0.35), (0.15, 0.35), (0.06, 0.3)].iter().enumerate()
        {
            let layer = self.seed ^ (surface * 31 + octave as u32 * 7919);
            value += weight * self.patches(layer, u / size, v / size);
        }
        (40.0 + 175.0 * value) as u8
    }

    fn patches(&self, layer: u32, u: f64, v: f64) -> f64 {
        let (column, row) = (u.floor(), v.floor());
        let blend = |share: f64| ((share - 0.9) / 0.1).clamp(0.0, 1.0);
        let (right, down) = (blend(u - column), blend(v - row));
        let wrap = |place: i32| match self.period {
            i32::MAX => place,
            period => place.rem_euclid(period),
        };
        let at = |dx: i32, dy: i32| {
            let (x, y) = (wrap(column as i32 + dx), wrap(row as i32 + dy));
            hash(layer, x, y)
        };
        let top = at(0, 0) * (1.0 - right) + at(1, 0) * right;
        let bottom = at(0, 1) * (1.0 - right) + at(1, 1) * right;
        top * (1.0 - down) + bottom * down
    }
}

fn hash(layer: u32, x: i32, y: i32) -> f64 {
    let mut state = layer
        .wrapping_mul(0x9E37_79B9)
        .wrapping_add(x as u32)
        .wrapping_mul(0x85EB_CA6B)
        .wrapping_add(y as u32)
        .wrapping_mul(0xC2B2_AE35);
    state ^= state >> 15;
    state = state.wrapping_mul(0x2C1B_3C6D);
    state ^= state >> 12;
    f64::from(state >> 8) / f64::from(1_u32 << 24)
}

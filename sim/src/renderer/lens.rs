//! The ray of every pixel.

use camera::CameraModel;
use nalgebra::Vector2;

use super::{MARGIN_PX, TILE_PX};
use crate::picture::Lanes;

/// Pixels and their rays `(x, y, 1)` on the ideal plane.
pub struct Lens {
    pub width: usize,
    pub height: usize,
    pub focal_px: [f32; 2],
    /// x and y, row by row; each row is filled up to whole tiles.
    rays: [Vec<f32>; 2],
    rays_stride: usize,
    /// All that the camera sees.
    pub view: Window,
}

/// A rectangle on the ideal plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    pub from: [f32; 2],
    pub to: [f32; 2],
}

impl Window {
    pub const EMPTY: Self = Self {
        from: [f32::INFINITY; 2],
        to: [f32::NEG_INFINITY; 2],
    };

    pub fn include(&mut self, ray: [f32; 2]) {
        for (axis, position) in ray.into_iter().enumerate() {
            self.from[axis] = self.from[axis].min(position);
            self.to[axis] = self.to[axis].max(position);
        }
    }

    pub fn unite(&mut self, other: &Self) {
        self.include(other.from);
        self.include(other.to);
    }

    pub fn touches(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.from[axis] <= other.to[axis] && other.from[axis] <= self.to[axis])
    }
}

impl Lens {
    pub fn new(camera: &CameraModel) -> Self {
        let (width, height) = (camera.width(), camera.height());
        let rays_stride = width.next_multiple_of(TILE_PX);
        let mut rays = [Vec::new(), Vec::new()];
        let mut last = Vector2::zeros();
        for y in 0..height {
            for x in 0..rays_stride {
                let pixel = Vector2::new(x.min(width - 1) as f64, y as f64);
                // A pixel without a ray takes its neighbour's.
                last = camera.undistort(&pixel).unwrap_or(last);
                rays[0].push(last.x as f32);
                rays[1].push(last.y as f32);
            }
        }
        let intrinsics = camera.intrinsics();
        let mut lens = Self {
            width,
            height,
            focal_px: [intrinsics.fx as f32, intrinsics.fy as f32],
            rays,
            rays_stride,
            view: Window::EMPTY,
        };
        for tile_idx in 0..lens.tile_columns() * lens.tile_rows() {
            lens.view.unite(&lens.tile_window(tile_idx));
        }
        lens
    }

    /// The ray of a pixel.
    pub fn ray(&self, x: usize, y: usize) -> [f32; 2] {
        let place = y * self.rays_stride + x;
        [self.rays[0][place], self.rays[1][place]]
    }

    /// The rays of a tile's row that begins with this pixel: all x, then all y.
    #[inline]
    pub fn ray_lanes(&self, x: usize, y: usize) -> [&Lanes; 2] {
        let place = y * self.rays_stride + x;
        [0, 1].map(|axis| {
            self.rays[axis][place..]
                .first_chunk()
                .expect("rows are filled up to whole tiles")
        })
    }

    /// The length of a row in a buffer with margin.
    pub fn stride(&self) -> usize {
        self.width + 2 * MARGIN_PX
    }

    /// The place of a pixel in a buffer with margin.
    pub fn place(&self, x: usize, y: usize) -> usize {
        (y + MARGIN_PX) * self.stride() + x + MARGIN_PX
    }

    pub fn tile_columns(&self) -> usize {
        self.width.div_ceil(TILE_PX)
    }

    pub fn tile_rows(&self) -> usize {
        self.height.div_ceil(TILE_PX)
    }

    /// The pixels of a tile: columns, then rows.
    pub fn tile_pixels(&self, tile_idx: usize) -> [std::ops::Range<usize>; 2] {
        let columns = self.tile_columns();
        let (x, y) = (tile_idx % columns * TILE_PX, tile_idx / columns * TILE_PX);
        [
            x..(x + TILE_PX).min(self.width),
            y..(y + TILE_PX).min(self.height),
        ]
    }

    /// All that the pixels of a tile see, out to their edges.
    pub fn tile_window(&self, tile_idx: usize) -> Window {
        let [xs, ys] = self.tile_pixels(tile_idx);
        let mut window = Window::EMPTY;
        for y in ys {
            for x in xs.clone() {
                window.include(self.ray(x, y));
            }
        }
        for axis in 0..2 {
            window.from[axis] -= 0.5 / self.focal_px[axis];
            window.to[axis] += 0.5 / self.focal_px[axis];
        }
        window
    }

    /// Repeats the picture's edge in the margin.
    pub fn fill_margin(&self, shades: &mut [f32]) {
        let stride = self.stride();
        for y in 0..self.height {
            let first = self.place(0, y);
            let last = self.place(self.width - 1, y);
            let (left, right) = (shades[first], shades[last]);
            shades[first - MARGIN_PX..first].fill(left);
            shades[last + 1..=last + MARGIN_PX].fill(right);
        }
        for margin in 0..MARGIN_PX {
            shades.copy_within(
                MARGIN_PX * stride..(MARGIN_PX + 1) * stride,
                margin * stride,
            );
            let last = (self.height + MARGIN_PX - 1) * stride;
            shades.copy_within(last..last + stride, last + (margin + 1) * stride);
        }
    }
}

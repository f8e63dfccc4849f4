//! Small squares of an image at sub-pixel positions.

use nalgebra::Vector2;

use crate::plane::Plane;

const RADIUS_PX: usize = 7;
const SIDE: usize = 2 * RADIUS_PX + 1;
/// Rows are padded with zeros to whole vectors.
const ROW: usize = 16;

/// A value for each pixel of a square of 15 × 15.
#[derive(Clone)]
pub(super) struct Window([[f32; ROW]; SIDE]);

impl Window {
    pub(super) const PIXEL_COUNT: usize = SIDE * SIDE;

    /// Interpolates bilinearly; `None` if the square reaches over the border (or is nowhere).
    pub(super) fn sample(plane: &Plane, centre: &Vector2<f64>) -> Option<Self> {
        let first = centre.add_scalar(-(RADIUS_PX as f64));
        let room = |side: usize| 0.0..(side.saturating_sub(SIDE)) as f64;
        if !room(plane.width()).contains(&first.x) || !room(plane.height()).contains(&first.y) {
            return None;
        }
        let (left, top) = (first.x as usize, first.y as usize);
        let (fraction_x, fraction_y) = (first.x.fract() as f32, first.y.fract() as f32);
        let blend_row = |y: usize| {
            let mut blended = [0.0; ROW];
            let row = &plane.row(y)[left..][..SIDE + 1];
            for (x, value) in blended[..SIDE].iter_mut().enumerate() {
                let (a, b) = (f32::from(row[x]), f32::from(row[x + 1]));
                *value = a + fraction_x * (b - a);
            }
            blended
        };
        let mut window = Self([[0.0; ROW]; SIDE]);
        let mut upper = blend_row(top);
        for (y, row) in window.0.iter_mut().enumerate() {
            let lower = blend_row(top + y + 1);
            for x in 0..ROW {
                row[x] = upper[x] + fraction_y * (lower[x] - upper[x]);
            }
            upper = lower;
        }
        Some(window)
    }

    pub(super) fn minus(mut self, other: &Self) -> Self {
        for (row, other) in self.0.iter_mut().zip(&other.0) {
            for x in 0..ROW {
                row[x] -= other[x];
            }
        }
        self
    }

    pub(super) fn scaled(mut self, factor: f32) -> Self {
        self.0
            .iter_mut()
            .flatten()
            .for_each(|value| *value *= factor);
        self
    }

    /// Less its mean.
    pub(super) fn centred(mut self) -> Self {
        let mut sums = [0.0; ROW];
        for row in &self.0 {
            for x in 0..ROW {
                sums[x] += row[x];
            }
        }
        let mean = sums.iter().sum::<f32>() / Self::PIXEL_COUNT as f32;
        for row in &mut self.0 {
            row[..SIDE].iter_mut().for_each(|value| *value -= mean);
        }
        self
    }

    /// The sum of products; columns first, so that lanes do not mix.
    pub(super) fn dot(&self, other: &Self) -> f32 {
        let mut sums = [0.0; ROW];
        for (row, other) in self.0.iter().zip(&other.0) {
            for x in 0..ROW {
                sums[x] += row[x] * other[x];
            }
        }
        sums.iter().sum()
    }
}

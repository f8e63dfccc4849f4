//! Strength and sub-pixel position of a corner, from the gradients around it.

use nalgebra::Vector2;

use crate::plane::Plane;

/// Half side of the square window.
const WINDOW_RADIUS_PX: usize = 3;
/// Further than this from the pixel where the segment test saw it, a corner is another one.
const SHIFT_PX_MAX: f64 = 1.0;

/// How brightness varies in the window around a corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Structure {
    /// Smaller eigenvalue of the gradients' second moments, per pixel (Shi and Tomasi 1994).
    pub(crate) response: f32,
    /// From the pixel to the corner.
    pub(crate) shift_px: Vector2<f64>,
}

/// Weights of the window by row and column distance.
const WEIGHTS: [i32; 2 * WINDOW_RADIUS_PX + 1] = [1, 3, 6, 8, 6, 3, 1];

/// Measures the window around a pixel, which must lie inside the plane with one pixel to spare.
///
/// The corner is where the lines perpendicular to all gradients meet best (Förstner and Gülch
/// 1987): `Σ w g gᵀ shift = Σ w g gᵀ offset`.
pub(crate) fn measure(plane: &Plane, x: usize, y: usize) -> Structure {
    let (mut xx, mut xy, mut yy) = (0_i32, 0_i32, 0_i32);
    let (mut bx, mut by) = (0_i32, 0_i32);
    let radius = WINDOW_RADIUS_PX as i32;
    for v in -radius..=radius {
        let row_y = y.wrapping_add_signed(v as isize);
        let first = x - WINDOW_RADIUS_PX - 1;
        let above = &plane.row(row_y - 1)[first..][..9];
        let row = &plane.row(row_y)[first..][..9];
        let below = &plane.row(row_y + 1)[first..][..9];
        for u in 0..2 * WINDOW_RADIUS_PX + 1 {
            let weight = WEIGHTS[u] * WEIGHTS[(v + radius) as usize];
            let gx = i32::from(row[u + 2]) - i32::from(row[u]);
            let gy = i32::from(below[u + 1]) - i32::from(above[u + 1]);
            let (gxx, gxy, gyy) = (weight * gx * gx, weight * gx * gy, weight * gy * gy);
            let u = u as i32 - radius;
            xx += gxx;
            xy += gxy;
            yy += gyy;
            bx += gxx * u + gxy * v;
            by += gxy * u + gyy * v;
        }
    }
    solve([xx, xy, yy, bx, by].map(f64::from))
}

fn solve([xx, xy, yy, bx, by]: [f64; 5]) -> Structure {
    let half_trace = 0.5 * (xx + yy);
    let determinant = xx * yy - xy * xy;
    let spread = (half_trace * half_trace - determinant).max(0.0).sqrt();
    let weight_sum = f64::from(WEIGHTS.iter().sum::<i32>());
    let smaller = (half_trace - spread) / (4.0 * weight_sum * weight_sum);
    let shift = if determinant > 0.0 {
        Vector2::new(yy * bx - xy * by, xx * by - xy * bx) / determinant
    } else {
        Vector2::zeros()
    };
    let near = shift.amax() <= SHIFT_PX_MAX;
    Structure {
        response: smaller as f32,
        shift_px: if near { shift } else { Vector2::zeros() },
    }
}

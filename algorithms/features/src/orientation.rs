//! Which way a corner points.
#![expect(
    clippy::needless_range_loop,
    reason = "one index over several slices of one length is what compilers vectorise"
)]

use nalgebra::Vector2;

use crate::plane::Plane;

/// Radius of the disc whose centroid is taken.
pub(crate) const DISC_RADIUS_PX: usize = 15;

/// Half widths of the disc's rows, from its middle row outwards.
const HALF_WIDTHS_PX: [usize; DISC_RADIUS_PX + 1] = half_widths();

const fn half_widths() -> [usize; DISC_RADIUS_PX + 1] {
    let mut widths = [0_usize; DISC_RADIUS_PX + 1];
    let mut v = 0;
    while v <= DISC_RADIUS_PX {
        // The disc holds the pixels with u² + v² at most (r + ½)², rounded down to r² + r.
        while (widths[v] + 1).pow(2) + v * v <= DISC_RADIUS_PX * (DISC_RADIUS_PX + 1) {
            widths[v] += 1;
        }
        v += 1;
    }
    widths
}

/// From the pixel towards the brightness centroid of the disc around it, not normalised.
///
/// Rosin 1999, as in ORB (Rublee et al. 2011, eq. 1–3). The disc must lie inside the plane.
pub(crate) fn centroid(plane: &Plane, x: usize, y: usize) -> Vector2<f32> {
    let (mut moment_x, mut moment_y) = (0_i32, 0_i32);
    for v in 0..=DISC_RADIUS_PX {
        let half_width = HALF_WIDTHS_PX[v];
        let columns = x - half_width..=x + half_width;
        let below = &plane.row(y + v)[columns.clone()];
        let above = &plane.row(y - v)[columns];
        let (mut difference, mut first) = (0_i32, 0_i32);
        for (idx, (&below, &above)) in below.iter().zip(above).enumerate() {
            let (below, above) = (i32::from(below), i32::from(above));
            difference += below - above;
            first += (idx as i32 - half_width as i32) * (below + above);
        }
        moment_x += if v == 0 { first / 2 } else { first };
        moment_y += v as i32 * difference;
    }
    Vector2::new(moment_x as f32, moment_y as f32)
}

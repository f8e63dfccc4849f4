//! Panels as one camera sees them.

use geometry::{Camera, Transform};
use nalgebra::Vector3;

use super::lens::{Lens, Window};
use crate::picture::{Footprints, LANES, Lanes, Picture};
use crate::world::Panel;

/// A linear form `x_slope · x + y_slope · y + constant` on the ideal plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Form {
    pub x_slope: f32,
    pub y_slope: f32,
    pub constant: f32,
}

impl Form {
    fn new(coefficients: &Vector3<f64>) -> Self {
        Self {
            x_slope: coefficients.x as f32,
            y_slope: coefficients.y as f32,
            constant: coefficients.z as f32,
        }
    }

    #[inline]
    pub fn at(&self, ray: [f32; 2]) -> f32 {
        self.x_slope * ray[0] + self.y_slope * ray[1] + self.constant
    }

    /// The value in the middle of a window, and how far it changes towards the corners.
    #[inline]
    fn over(&self, window: &Window) -> (f32, f32) {
        let half = [0, 1].map(|axis| 0.5 * (window.to[axis] - window.from[axis]));
        let middle = [0, 1].map(|axis| 0.5 * (window.to[axis] + window.from[axis]));
        let reach = self.x_slope.abs() * half[0] + self.y_slope.abs() * half[1];
        (self.at(middle), reach)
    }
}

/// A panel in front of a camera.
#[derive(Clone, Debug)]
pub struct Facet {
    pub picture_idx: usize,
    /// 1/z of the panel's plane.
    pub inverse_depth: Form,
    /// Metres right of the panel's corner, over z.
    pub right: Form,
    /// Metres below the panel's corner, over z.
    pub down: Form,
    /// Not negative inside: left, top, right and bottom edge.
    pub edges: [Form; 4],
    pub window: Window,
    width_m: f32,
    height_m: f32,
    /// Steps on the ideal plane per pixel.
    per_focal: [f32; 2],
}

/// How a facet lies on a tile.
#[derive(Clone, Copy, Debug)]
pub struct Cover {
    pub fills: bool,
    pub inverse_depth_min: f32,
    pub inverse_depth_max: f32,
}

/// Surfaces nearer than this are not drawn.
const NEAR_M: f64 = 0.03;

impl Facet {
    /// The facet, unless the panel turns its back or lies out of view. The panel is in the frame
    /// of what it belongs to.
    pub fn new<Owner>(
        panel: &Panel,
        picture_idx: usize,
        camera_from_owner: &Transform<Camera, Owner>,
        lens: &Lens,
    ) -> Option<Self> {
        let corner = *camera_from_owner * panel.corner;
        let right = camera_from_owner.rotation() * panel.right;
        let down = camera_from_owner.rotation() * panel.down;
        let inward = right.cross(&down);
        let distance_m = inward.dot(&corner);
        if distance_m < 1e-4 {
            return None;
        }
        let window = seen_window(&corner, &(right * panel.width_m), &(down * panel.height_m))?;
        let inverse_depth = inward / distance_m;
        let right_over_depth = right - inverse_depth * right.dot(&corner);
        let down_over_depth = down - inverse_depth * down.dot(&corner);
        let facet = Self {
            picture_idx,
            inverse_depth: Form::new(&inverse_depth),
            right: Form::new(&right_over_depth),
            down: Form::new(&down_over_depth),
            edges: [
                right_over_depth,
                down_over_depth,
                inverse_depth * panel.width_m - right_over_depth,
                inverse_depth * panel.height_m - down_over_depth,
            ]
            .map(|edge| Form::new(&edge)),
            window,
            width_m: panel.width_m as f32,
            height_m: panel.height_m as f32,
            per_focal: lens.focal_px.map(f32::recip),
        };
        facet.window.touches(&lens.view).then_some(facet)
    }

    /// How the facet lies on what a tile sees, or `None` if it does not.
    #[inline]
    pub fn cover(&self, window: &Window) -> Option<Cover> {
        let (inverse_depth, reach) = self.inverse_depth.over(window);
        if inverse_depth + reach <= 0.0 {
            return None;
        }
        let mut fills = inverse_depth - reach > 0.0;
        for edge in &self.edges {
            let (value, reach) = edge.over(window);
            if value + reach < -EDGE_TOLERANCE {
                return None;
            }
            fills &= value - reach >= 0.0;
        }
        Some(Cover {
            fills,
            inverse_depth_min: inverse_depth - reach,
            inverse_depth_max: inverse_depth + reach,
        })
    }

    /// Whether a point on this ray with this 1/z is behind the facet.
    pub fn hides(&self, ray: [f32; 2], inverse_depth: f32) -> bool {
        self.inverse_depth.at(ray) > inverse_depth
            && self.edges.iter().all(|edge| edge.at(ray) >= 0.0)
    }

    /// Adds to `shades` what pixels with these rays see, times their weights; beyond the facet's
    /// edge, what is at the edge.
    #[inline]
    pub fn add_shades(
        &self,
        picture: &Picture,
        rays: [&Lanes; 2],
        weights: &Lanes,
        shades: &mut [f32],
    ) {
        let texels_per_m = picture.texels_per_m();
        let (right, down, inverse) = (&self.right, &self.down, &self.inverse_depth);
        let mut footprints = Footprints {
            position: [[0.0; LANES]; 2],
            right: [[0.0; LANES]; 2],
            down: [[0.0; LANES]; 2],
        };
        let [xs, ys] = rays;
        for (lane, (x, y)) in xs.iter().zip(ys).enumerate() {
            let ray = [*x, *y];
            let scale = texels_per_m / inverse.at(ray).max(1e-4);
            let u = (right.at(ray) * scale)
                .max(0.0)
                .min(self.width_m * texels_per_m);
            let v = (down.at(ray) * scale)
                .max(0.0)
                .min(self.height_m * texels_per_m);
            footprints.position[0][lane] = u;
            footprints.position[1][lane] = v;
            let per_column = self.per_focal[0] * scale;
            let per_row = self.per_focal[1] * scale;
            let (u_m, v_m) = (u / texels_per_m, v / texels_per_m);
            footprints.right[0][lane] = (right.x_slope - u_m * inverse.x_slope) * per_column;
            footprints.right[1][lane] = (down.x_slope - v_m * inverse.x_slope) * per_column;
            footprints.down[0][lane] = (right.y_slope - u_m * inverse.y_slope) * per_row;
            footprints.down[1][lane] = (down.y_slope - v_m * inverse.y_slope) * per_row;
        }
        picture.add_samples(&footprints, weights, shades);
    }
}

/// Panels that meet overlap by about this much (metres at one metre), so that no gap shows.
pub const EDGE_TOLERANCE: f32 = 1e-4;

/// The rectangle on the ideal plane that holds the part of a panel in front of the camera.
fn seen_window(corner: &Vector3<f64>, right: &Vector3<f64>, down: &Vector3<f64>) -> Option<Window> {
    let corners = [
        *corner,
        corner + right,
        corner + right + down,
        corner + down,
    ];
    let mut window = Window::EMPTY;
    let mut seen = false;
    for idx in 0..4 {
        let (a, b) = (corners[idx], corners[(idx + 1) % 4]);
        let mut include = |point: &Vector3<f64>| {
            window.include([(point.x / point.z) as f32, (point.y / point.z) as f32]);
            seen = true;
        };
        if a.z >= NEAR_M {
            include(&a);
        }
        if (a.z < NEAR_M) != (b.z < NEAR_M) {
            include(&a.lerp(&b, (NEAR_M - a.z) / (b.z - a.z)));
        }
    }
    seen.then_some(window)
}

//! Marker lights among what falls on the sensor.

use nalgebra::Vector3;

use super::{MARGIN_PX, Renderer};
use crate::marker_light::{LENS_SIGMA_PX, LightSpot, add_spot};

/// The level of a light at one metre: 700 at 1.81 m, where the sensor is well saturated.
const PEAK_AT_1_M: f64 = 2290.0;
/// Lights do not come nearer, and what is nearer in front of one does not hide it: it may be the
/// mast that carries it.
const NEAR_M: f64 = 0.03;

impl Renderer {
    /// Adds a light to the shades, if nothing hides it.
    pub(super) fn add_light(&mut self, point_in_camera: &Vector3<f64>) {
        let Some(pixel) = self.camera.project(point_in_camera) else {
            return;
        };
        let depth_m = point_in_camera.z;
        if !self.camera.contains(&pixel, 0.0) || depth_m < 2.0 * NEAR_M {
            return;
        }
        let ray = [point_in_camera.x, point_in_camera.y].map(|axis| (axis / depth_m) as f32);
        let inverse_depth = ((depth_m - NEAR_M).recip()) as f32;
        let place = [pixel.x, pixel.y].map(|axis| axis as usize);
        if self.tiles.hides(&self.facets, place, ray, inverse_depth) {
            return;
        }
        let spot = LightSpot {
            center_px: [pixel.x, pixel.y].map(|axis| axis + MARGIN_PX as f64),
            sigma_px: LENS_SIGMA_PX,
            peak: PEAK_AT_1_M / point_in_camera.norm_squared(),
            // The sensor blurs everything.
            streak_px: [0.0; 2],
        };
        add_spot(&mut self.shades, self.lens.stride(), &spot);
    }
}

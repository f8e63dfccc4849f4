//! Pictures of a world through a calibrated camera.
//!
//! A facet is a panel as one camera sees it. In the ideal plane its position, its edges and its
//! inverse depth are linear, so tiles of pixels are sorted by intervals of these forms: a tile
//! that one facet fills is shaded directly; others take four samples per pixel to find edges.
//! Every pixel is traced along its own bent ray, so the lens is exact.

mod facets;
mod lens;
mod sensor;
mod tiles;

use std::sync::Arc;

use camera::{CameraModel, Image};
use geometry::{Camera, Enu, Transform};
use nalgebra::Vector3;

use crate::paint::paint;
use crate::picture::{LANES, Picture};
use crate::world::{Panel, World};
use facets::Facet;
use lens::Lens;
use sensor::Sensor;
pub use sensor::{SensorSettings, gain_at};
use tiles::Tiles;

/// A painted world.
pub struct Scene {
    panels: Vec<Panel>,
    pictures: Vec<Picture>,
}

impl Scene {
    /// Paints every panel; this takes about a second.
    pub fn paint(world: &World) -> Self {
        let paint_panel = |panel| Picture::new(&paint(world, panel));
        Self {
            pictures: world.panels.iter().map(paint_panel).collect(),
            panels: world.panels.clone(),
        }
    }
}

/// Where the camera is at the middle of an exposure, and how it moves.
#[derive(Clone, Copy, Debug)]
pub struct Shot {
    pub site_from_camera: Transform<Enu, Camera>,
    /// Velocity of the camera's centre along its own axes, m/s.
    pub velocity_in_camera: Vector3<f64>,
    /// Angular velocity along its own axes, rad/s.
    pub rotation_rate_in_camera: Vector3<f64>,
    /// Shades are multiplied by this.
    pub gain: f64,
    pub noise_seed: u64,
}

/// A camera in a scene. Buffers are kept between frames.
pub struct Renderer {
    scene: Arc<Scene>,
    lens: Lens,
    sensor: Sensor,
    tiles: Tiles,
    facets: Vec<Facet>,
    /// Shades before the sensor, with a border of [`MARGIN_PX`].
    shades: Vec<f32>,
}

/// Room around the picture for motion blur, and for the rest of tiles cut by the edge.
const MARGIN_PX: usize = TILE_PX;
const TILE_PX: usize = LANES;

impl Renderer {
    pub fn new(scene: Arc<Scene>, camera: &CameraModel, sensor: SensorSettings) -> Self {
        let lens = Lens::new(camera);
        Self {
            sensor: Sensor::new(sensor, &lens),
            tiles: Tiles::new(&lens),
            shades: vec![0.0; lens.stride() * (lens.height + 2 * MARGIN_PX)],
            facets: Vec::new(),
            scene,
            lens,
        }
    }

    /// One frame, with blur, vignette and noise. The same shot gives the same bytes.
    pub fn render(&mut self, shot: &Shot) -> Image {
        let camera_from_site = shot.site_from_camera.inverse();
        self.facets.clear();
        for (panel_idx, panel) in self.scene.panels.iter().enumerate() {
            let facet = Facet::new(panel, panel_idx, &camera_from_site, &self.lens);
            self.facets.extend(facet);
        }
        self.tiles.sort(&self.facets);
        self.tiles.shade(
            &self.facets,
            &self.scene.pictures,
            &self.lens,
            &mut self.shades,
        );
        self.lens.fill_margin(&mut self.shades);
        self.sensor
            .expose(shot, &self.lens, &self.tiles, &self.shades)
    }
}

#[cfg(test)]
mod tests;

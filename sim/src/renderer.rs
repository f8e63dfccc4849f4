//! Pictures of a world through a calibrated camera.
//!
//! A facet is a panel as one camera sees it. In the ideal plane its position, its edges and its
//! inverse depth are linear, so tiles of pixels are sorted by intervals of these forms: a tile
//! that one facet fills is shaded directly; others take four samples per pixel to find edges.
//! Every pixel is traced along its own bent ray, so the lens is exact.

mod facets;
mod lens;
mod lights;
mod sensor;
mod tiles;

use std::sync::{Arc, LazyLock};

use camera::{CameraModel, Image};
use geometry::{Body, Camera, Enu, Transform};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::marker_light::MarkerLights;
use crate::paint::{paint, paint_hull};
use crate::picture::{LANES, Picture};
use crate::world::{Cuboid, Finish, Panel, World};
use facets::Facet;
use lens::Lens;
use sensor::Sensor;
pub use sensor::{SensorSettings, gain_at};
use tiles::Tiles;

/// A painted world, and the hulls of those who move in it.
pub struct Scene {
    panels: Vec<Panel>,
    /// In the frame of the body that they belong to.
    hulls: Vec<Vec<Panel>>,
    /// Of all panels, then of all hulls.
    pictures: Vec<LazyPicture>,
}

/// A picture that is painted when it is first seen.
type LazyPicture = LazyLock<Picture, Box<dyn FnOnce() -> Picture + Send>>;

fn lazy(paint: impl FnOnce() -> Picture + Send + 'static) -> LazyPicture {
    LazyLock::new(Box::new(paint))
}

impl Scene {
    /// Paints every panel; this takes about a second for a lab.
    pub fn paint(world: &World) -> Self {
        let scene = Self::painted_when_seen(world);
        for picture in &scene.pictures {
            LazyLock::force(picture);
        }
        scene
    }

    /// Paints each panel when a camera first sees it: for worlds of which a route shows a part.
    /// The pictures are the same, but a frame takes longer while they are painted.
    pub fn painted_when_seen(world: &World) -> Self {
        let world = Arc::new(world.clone());
        let paint_panel = |panel_idx: usize| {
            let world = Arc::clone(&world);
            lazy(move || Picture::new(&paint(&world, &world.panels[panel_idx])))
        };
        Self {
            pictures: (0..world.panels.len()).map(paint_panel).collect(),
            panels: world.panels.clone(),
            hulls: Vec::new(),
        }
    }

    /// The same with hulls, each of boxes in its body's frame.
    pub fn with_hulls<'a>(mut self, hulls: impl IntoIterator<Item = &'a [Cuboid]>) -> Self {
        for cuboids in hulls {
            let panels = hull_panels(cuboids, self.hulls.len() as u64);
            let painted = panels.iter().map(|panel| {
                let panel = panel.clone();
                let picture = lazy(move || Picture::new(&paint_hull(&panel)));
                LazyLock::force(&picture);
                picture
            });
            self.pictures.extend(painted);
            self.hulls.push(panels);
        }
        self
    }
}

fn hull_panels(cuboids: &[Cuboid], hull_idx: u64) -> Vec<Panel> {
    let mut rng = ChaCha8Rng::seed_from_u64(hull_idx ^ 0x1ab0_0003);
    let faces = |cuboid: &Cuboid| cuboid.all_faces(Finish::Metal, &mut rng);
    cuboids.iter().flat_map(faces).collect()
}

/// Another vehicle that a camera may see.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour {
    /// Which of the scene's hulls it has.
    pub hull_idx: usize,
    pub site_from_body: Transform<Enu, Body>,
    pub lights: Option<MarkerLights>,
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
    camera: CameraModel,
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
            camera: camera.clone(),
            scene,
            lens,
        }
    }

    /// One frame, with blur, vignette and noise. The same shot gives the same bytes.
    pub fn render(&mut self, shot: &Shot) -> Image {
        self.render_among(shot, &[])
    }

    /// [`Renderer::render`] with other vehicles: their hulls and their lights.
    pub fn render_among(&mut self, shot: &Shot, neighbours: &[Neighbour]) -> Image {
        let camera_from_site = shot.site_from_camera.inverse();
        self.find_facets(&camera_from_site, neighbours);
        self.tiles.sort(&self.facets);
        self.tiles.shade(
            &self.facets,
            &self.scene.pictures,
            &self.lens,
            &mut self.shades,
        );
        self.lens.fill_margin(&mut self.shades);
        for neighbour in neighbours {
            let camera_from_body = camera_from_site * neighbour.site_from_body;
            let lights = neighbour.lights.iter();
            for position in lights.flat_map(MarkerLights::positions_in_body) {
                self.add_light(&(camera_from_body * position));
            }
        }
        self.sensor
            .expose(shot, &self.lens, &self.tiles, &self.shades)
    }

    fn find_facets(&mut self, camera_from_site: &Transform<Camera, Enu>, neighbours: &[Neighbour]) {
        let Scene { panels, hulls, .. } = &*self.scene;
        self.facets.clear();
        for (picture_idx, panel) in panels.iter().enumerate() {
            let facet = Facet::new(panel, picture_idx, camera_from_site, &self.lens);
            self.facets.extend(facet);
        }
        for neighbour in neighbours {
            let before = &hulls[..neighbour.hull_idx];
            let first_idx = panels.len() + before.iter().map(Vec::len).sum::<usize>();
            let camera_from_body = *camera_from_site * neighbour.site_from_body;
            for (idx, panel) in hulls[neighbour.hull_idx].iter().enumerate() {
                let facet = Facet::new(panel, first_idx + idx, &camera_from_body, &self.lens);
                self.facets.extend(facet);
            }
        }
    }
}

#[cfg(test)]
mod tests;

//! Pictures for the panels of a world, painted from their seeds.
//!
//! Real rooms have corners at every scale; so do these: figures have sizes from centimetres to a
//! metre with a power law, as in the "dead leaves" model of natural images (Lee, Mumford and
//! Huang 2001), over noise of several octaves.

mod canvas;
mod figures;
mod finish;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::world::{Finish, Panel, World};
pub use canvas::Canvas;

/// Paints one panel, lit by the lamps of its world.
pub fn paint(world: &World, panel: &Panel) -> Canvas {
    let mut rng = ChaCha8Rng::seed_from_u64(panel.seed);
    let mut canvas = Canvas::new(panel.width_m, panel.height_m, texel_m(panel.finish));
    finish::apply(panel.finish, &mut canvas, &mut rng);
    let light = |u_m: f64, v_m: f64| brightness(world, panel, &panel.point(u_m, v_m)) as f32;
    canvas.fade(world.contrast);
    canvas.light(&light);
    canvas
}

/// Paints one panel of a vehicle's hull: dark, and the same from wherever light comes.
pub fn paint_hull(panel: &Panel) -> Canvas {
    let mut rng = ChaCha8Rng::seed_from_u64(panel.seed);
    let mut canvas = Canvas::new(panel.width_m, panel.height_m, texel_m(panel.finish));
    finish::apply(panel.finish, &mut canvas, &mut rng);
    let light = 0.25 + 0.08 * panel.normal().z as f32;
    canvas.light(&|_, _| light);
    canvas
}

/// The edge of a texel: fine enough that a camera at half a metre sees detail.
fn texel_m(finish: Finish) -> f64 {
    match finish {
        Finish::Ceiling | Finish::Carpet => 0.008,
        Finish::Floor | Finish::Plaster => 0.005,
        Finish::BrickWall | Finish::PaintedWall | Finish::Door | Finish::Window => 0.004,
        Finish::Wood | Finish::Metal | Finish::Cardboard | Finish::Crate => 0.003,
        Finish::Poster => 0.002,
        Finish::Board => 0.001,
    }
}

/// Lambert's law for lamps under the ceiling, and light from all around.
fn brightness(world: &World, panel: &Panel, point: &Vector3<f64>) -> f64 {
    let normal = panel.normal();
    let direct: f64 = world
        .lamps
        .iter()
        .map(|lamp| {
            let ray = lamp - point;
            let distance_squared = ray.norm_squared().max(0.25);
            (normal.dot(&ray) / distance_squared.sqrt()).max(0.0) / distance_squared
        })
        .sum();
    (0.7 + 0.9 * direct).min(1.5)
}

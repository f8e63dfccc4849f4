//! Rooms that look alike: the same furniture and posters in the same places, elsewhere.

use nalgebra::Vector3;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Finish, Panel, World};

/// How alike twin rooms are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// The share of posters and of furniture that looks exactly the same.
    pub furniture: f64,
    /// The share of boxes on shelves and tables that stands in the same place and looks the same.
    pub contents: f64,
}

impl World {
    /// Another room of the same plan: walls, doors, windows and furniture stand where they stand
    /// here, and the same posters hang there to within 4 cm, as far as `likeness` says. Plaster,
    /// bricks, paint, floor and ceiling are of the same kind, but what is on them is the room's
    /// own.
    pub fn twin(&self, likeness: &Likeness, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0011);
        let mut panels = Vec::with_capacity(self.panels.len());
        let mut rest = &self.panels[..];
        while let Some(first) = rest.first() {
            let (same, others) = rest.split_at(box_length(rest).unwrap_or(1));
            rest = others;
            match first.finish {
                Finish::Cardboard | Finish::Crate => {
                    if rng.random_bool(likeness.contents) {
                        panels.extend_from_slice(same);
                    } else {
                        panels.extend(another_box(same, &mut rng));
                    }
                }
                finish => panels.push(Panel {
                    seed: another_look(first, likeness, &mut rng),
                    corner: first.corner + hung_elsewhere(first, finish, &mut rng),
                    ..first.clone()
                }),
            }
        }
        Self {
            panels,
            ..self.clone()
        }
    }
}

fn another_look(panel: &Panel, likeness: &Likeness, rng: &mut impl Rng) -> u64 {
    let is_alike = match panel.finish {
        Finish::Door | Finish::Window => true,
        Finish::Poster | Finish::Board | Finish::Wood | Finish::Metal => {
            rng.random_bool(likeness.furniture)
        }
        Finish::Floor
        | Finish::Ceiling
        | Finish::Carpet
        | Finish::Plaster
        | Finish::PaintedWall
        | Finish::BrickWall => false,
        Finish::Cardboard | Finish::Crate => unreachable!("boxes are taken as a whole"),
    };
    let another = rng.random();
    if is_alike { panel.seed } else { another }
}

/// Nobody hangs two posters at the same height to the millimetre.
fn hung_elsewhere(panel: &Panel, finish: Finish, rng: &mut impl Rng) -> Vector3<f64> {
    let aside = [panel.right, panel.down].map(|axis| axis * rng.random_range(-0.04..0.04));
    match finish {
        Finish::Poster | Finish::Board => aside[0] + aside[1],
        _ => Vector3::zeros(),
    }
}

/// How many panels make up the box that the list begins with: four sides, a lid, perhaps a floor.
fn box_length(panels: &[Panel]) -> Option<usize> {
    let finish = panels.first()?.finish;
    if !matches!(finish, Finish::Cardboard | Finish::Crate) {
        return None;
    }
    let has_floor = panels
        .get(5)
        .is_some_and(|sixth| sixth.finish == finish && sixth.normal().z < -0.5);
    Some(if has_floor { 6 } else { 5 }.min(panels.len()))
}

/// Another box in its stead, smaller and a little aside, or none.
fn another_box(panels: &[Panel], rng: &mut impl Rng) -> Vec<Panel> {
    let is_gone = rng.random_bool(0.25);
    let size = rng.random_range(0.6..1.0);
    let shift = Vector3::new(
        rng.random_range(-0.07..0.07),
        rng.random_range(-0.07..0.07),
        0.0,
    );
    let corners: Vec<Vector3<f64>> = panels.iter().flat_map(Panel::corners).collect();
    let mut base = corners.iter().sum::<Vector3<f64>>() / corners.len() as f64;
    base.z = corners
        .iter()
        .map(|one| one.z)
        .fold(f64::INFINITY, f64::min);
    let another = |panel: &Panel| Panel {
        corner: base + (panel.corner - base) * size + shift * size,
        width_m: panel.width_m * size,
        height_m: panel.height_m * size,
        seed: rng.random(),
        ..panel.clone()
    };
    let boxed = panels.iter().map(another).collect();
    if is_gone { Vec::new() } else { boxed }
}

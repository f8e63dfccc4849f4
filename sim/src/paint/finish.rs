//! How each finish is made of figures.

mod building;

use rand::{Rng, RngExt};

use super::canvas::{Area, Canvas, Ink};
use super::figures::{Leaves, Tiling, poster, stain, strew, tile, wander, write};
use crate::world::Finish;

pub fn apply(finish: Finish, canvas: &mut Canvas, rng: &mut impl Rng) {
    match finish {
        Finish::Floor => floor(canvas, rng),
        Finish::Ceiling => ceiling(canvas, rng),
        Finish::BrickWall => {
            bricks(canvas, rng);
            on_wall(canvas, rng);
        }
        Finish::PaintedWall => {
            painted(canvas, rng);
            on_wall(canvas, rng);
        }
        Finish::Wood => wood(canvas, rng),
        Finish::Metal => metal(canvas, rng),
        Finish::Cardboard => cardboard(canvas, rng),
        Finish::Crate => crate_face(canvas, rng),
        Finish::Plaster => building::plaster(canvas, rng),
        Finish::Door => building::door(canvas, rng),
        Finish::Window => building::window(canvas, rng),
        Finish::Poster => building::sheet(canvas, rng),
        Finish::Carpet => building::carpet(canvas, rng),
        Finish::Board => building::board(canvas, rng),
    }
}

/// Noise of four octaves, with this amplitude each.
fn weather(canvas: &mut Canvas, amplitude: f32, rng: &mut impl Rng) {
    let area = canvas.area();
    for grain_m in [0.4, 0.12, 0.04, 0.016] {
        canvas.add_noise(&area, grain_m, amplitude, rng);
    }
}

fn count_per_m2(canvas: &Canvas, density_per_m2: f32) -> usize {
    let [width_m, height_m] = canvas.area().extents();
    (width_m * height_m * density_per_m2).ceil() as usize
}

fn bricks(canvas: &mut Canvas, rng: &mut impl Rng) {
    let tiling = Tiling {
        cell: [rng.random_range(0.23..0.27), rng.random_range(0.085..0.1)],
        joint_m: 0.014,
        joint_shade: rng.random_range(150.0..180.0),
        shade: rng.random_range(95.0..120.0),
        shade_spread: 32.0,
        offset: 0.5,
    };
    tile(canvas, &tiling, rng);
    weather(canvas, 11.0, rng);
}

fn painted(canvas: &mut Canvas, rng: &mut impl Rng) {
    let tiling = Tiling {
        cell: [rng.random_range(0.7..1.0), rng.random_range(0.6..0.9)],
        joint_m: 0.01,
        joint_shade: 70.0,
        shade: rng.random_range(140.0..165.0),
        shade_spread: 16.0,
        offset: 0.0,
    };
    tile(canvas, &tiling, rng);
    let chips = Leaves {
        size_m_min: 0.02,
        size_m_max: 0.3,
        coverage: 0.35,
        opacity: 0.4,
    };
    strew(canvas, &canvas.area(), &chips, rng);
    weather(canvas, 12.0, rng);
}

/// Stains, cracks, pipes, notes and posters.
fn on_wall(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    for _ in 0..count_per_m2(canvas, 1.2) {
        let size_m = rng.random_range(0.12..0.6);
        stain(canvas, area.random_spot(rng), size_m, rng);
    }
    for _ in 0..count_per_m2(canvas, 1.0) {
        let width_m = rng.random_range(0.008..0.02);
        let shade = rng.random_range(25.0..70.0);
        wander(canvas, area.random_spot(rng), width_m, shade, rng);
    }
    for _ in 0..3 {
        let [x, _] = area.random_spot(rng);
        let shade = rng.random_range(60.0..210.0);
        canvas.stroke([x, area.from[1]], [x, area.to[1]], 0.05, Ink::solid(shade));
    }
    let [width_m, height_m] = area.extents();
    let band_m = rng.random_range(0.85..1.05);
    let y = height_m - band_m;
    canvas.stroke([0.0, y], [width_m, y], 0.03, Ink::solid(60.0));
    for _ in 0..count_per_m2(canvas, 0.9) {
        sheet(canvas, [0.1..0.28, 0.1..0.28], rng);
    }
    for _ in 0..count_per_m2(canvas, 0.75) {
        sheet(canvas, [0.35..1.0, 0.35..0.9], rng);
    }
}

/// A poster where vehicles can see it.
fn sheet(canvas: &mut Canvas, sizes_m: [std::ops::Range<f32>; 2], rng: &mut impl Rng) {
    let extents = sizes_m.map(|range| rng.random_range(range));
    let mut spot = canvas.area().random_spot(rng);
    let height_m = canvas.area().extents()[1];
    spot[1] = height_m - rng.random_range(0.3..2.4);
    poster(canvas, &Area::around(spot, extents), rng);
}

fn floor(canvas: &mut Canvas, rng: &mut impl Rng) {
    let cell_m = rng.random_range(0.4..0.6);
    let tiling = Tiling {
        cell: [cell_m, cell_m],
        joint_m: 0.012,
        joint_shade: 55.0,
        shade: rng.random_range(105.0..130.0),
        shade_spread: 22.0,
        offset: 0.0,
    };
    tile(canvas, &tiling, rng);
    let chips = Leaves {
        size_m_min: 0.025,
        size_m_max: 0.25,
        coverage: 0.25,
        opacity: 0.5,
    };
    let area = canvas.area();
    strew(canvas, &area, &chips, rng);
    weather(canvas, 11.0, rng);
    for _ in 0..count_per_m2(canvas, 0.4) {
        let size_m = rng.random_range(0.15..0.7);
        stain(canvas, area.random_spot(rng), size_m, rng);
    }
    for _ in 0..count_per_m2(canvas, 0.35) {
        marking(canvas, &area, rng);
    }
}

/// Tape, hazard stripes, or a number on the floor.
fn marking(canvas: &mut Canvas, area: &Area, rng: &mut impl Rng) {
    let spot = area.random_spot(rng);
    let upright = rng.random_bool(0.5);
    let length_m: f32 = rng.random_range(0.5..1.6);
    let along = if upright {
        [0.0, length_m]
    } else {
        [length_m, 0.0]
    };
    let end = [spot[0] + along[0], spot[1] + along[1]];
    match rng.random_range(0..3) {
        0 => canvas.stroke(spot, end, 0.05, Ink::solid(215.0)),
        1 => {
            canvas.stroke(spot, end, 0.12, Ink::solid(210.0));
            let steps = (length_m / 0.16) as usize;
            for step in 0..steps {
                let t = (step as f32 + 0.5) / steps as f32;
                let middle = [spot[0] + along[0] * t, spot[1] + along[1] * t];
                let from = [middle[0] - 0.045, middle[1] - 0.045];
                let to = [middle[0] + 0.045, middle[1] + 0.045];
                canvas.stroke(from, to, 0.05, Ink::solid(30.0));
            }
        }
        _ => {
            let sign = Area::around(spot, [0.5, 0.36]);
            write(canvas, &sign, 0.15, 225.0, rng);
        }
    }
}

fn ceiling(canvas: &mut Canvas, rng: &mut impl Rng) {
    let tiling = Tiling {
        cell: [0.6, 0.6],
        joint_m: 0.03,
        joint_shade: 190.0,
        shade: 150.0,
        shade_spread: 14.0,
        offset: 0.0,
    };
    tile(canvas, &tiling, rng);
    let area = canvas.area();
    let dents = Leaves {
        size_m_min: 0.03,
        size_m_max: 0.2,
        coverage: 0.15,
        opacity: 0.5,
    };
    strew(canvas, &area, &dents, rng);
    for _ in 0..8 {
        let lamp = Area::around(area.random_spot(rng), [1.2, 0.3]);
        canvas.fill_area(&lamp, Ink::solid(245.0));
    }
}

fn wood(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    canvas.fill_area(&area, Ink::solid(rng.random_range(120.0..165.0)));
    weather(canvas, 12.0, rng);
    for _ in 0..count_per_m2(canvas, 40.0) {
        let from = area.random_spot(rng);
        let to = [from[0] + rng.random_range(0.03..0.4), from[1]];
        let shade = rng.random_range(50.0..190.0);
        canvas.stroke(from, to, 0.008, Ink::solid(shade));
    }
    labels(canvas, 4.0, rng);
}

fn metal(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    canvas.fill_area(&area, Ink::solid(rng.random_range(75.0..175.0)));
    weather(canvas, 10.0, rng);
    let [width_m, height_m] = area.extents();
    if width_m > 0.3 && height_m > 0.3 {
        for idx in 1..3 {
            let y = height_m * idx as f32 / 3.0;
            canvas.stroke([0.0, y], [width_m, y], 0.012, Ink::solid(35.0));
            let handle = Area::around([0.5 * width_m, y - 0.08], [0.12, 0.03]);
            canvas.fill_area(&handle, Ink::solid(225.0));
        }
    }
    scratches(canvas, 0.35, rng);
    labels(canvas, 5.0, rng);
}

fn cardboard(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    canvas.fill_area(&area, Ink::solid(rng.random_range(120.0..190.0)));
    weather(canvas, 8.0, rng);
    let [width_m, height_m] = area.extents();
    let tape_shade = rng.random_range(60.0..220.0);
    let y = height_m * rng.random_range(0.3..0.7);
    canvas.stroke([0.0, y], [width_m, y], 0.05, Ink::solid(tape_shade));
    scratches(canvas, 0.3, rng);
    labels(canvas, 12.0, rng);
}

fn crate_face(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    let shade = rng.random_range(90.0..150.0);
    let tiling = Tiling {
        cell: [10.0, rng.random_range(0.08..0.13)],
        joint_m: 0.012,
        joint_shade: 35.0,
        shade,
        shade_spread: 30.0,
        offset: 0.0,
    };
    tile(canvas, &tiling, rng);
    let frame = Ink::solid(shade + 40.0);
    let [width_m, height_m] = area.extents();
    for x in [0.025, width_m - 0.025] {
        canvas.stroke([x, 0.0], [x, height_m], 0.05, frame);
    }
    if rng.random_bool(0.5) {
        canvas.stroke([0.0, 0.0], [width_m, height_m], 0.05, frame);
    }
    weather(canvas, 11.0, rng);
    scratches(canvas, 0.3, rng);
    labels(canvas, 7.0, rng);
}

fn scratches(canvas: &mut Canvas, coverage: f32, rng: &mut impl Rng) {
    let leaves = Leaves {
        size_m_min: 0.012,
        size_m_max: 0.15,
        coverage,
        opacity: 0.65,
    };
    strew(canvas, &canvas.area(), &leaves, rng);
}

/// Stickers and signs, as many as fit.
fn labels(canvas: &mut Canvas, density_per_m2: f32, rng: &mut impl Rng) {
    let area = canvas.area();
    let [width_m, height_m] = area.extents();
    if width_m.min(height_m) < 0.1 {
        return;
    }
    for _ in 0..count_per_m2(canvas, density_per_m2) {
        let extents = [
            rng.random_range(0.08..0.3_f32).min(0.8 * width_m),
            rng.random_range(0.07..0.22_f32).min(0.8 * height_m),
        ];
        poster(canvas, &Area::around(area.random_spot(rng), extents), rng);
    }
}

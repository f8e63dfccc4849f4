//! Finishes of offices and corridors: calmer than those of the lab.

use rand::{Rng, RngExt};

use super::super::canvas::{Area, Canvas, Figure, Ink, Outline};
use super::super::figures::{Leaves, code, poster, stain, strew, wander, write};
use super::{count_per_m2, labels, scratches, weather};

/// One piece in so many is nearly bare.
const BARE_SHARE: f64 = 0.25;

pub fn plaster(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    let [width_m, height_m] = area.extents();
    canvas.fill_area(&area, Ink::solid(rng.random_range(135.0..180.0)));
    weather(canvas, 2.5, rng);
    let y = height_m - 0.07;
    let skirting = Ink::solid(rng.random_range(50.0..110.0));
    canvas.stroke([0.0, y], [width_m, y], 0.1, skirting);
    let bare = rng.random_bool(BARE_SHARE);
    let density_per_m2 = if bare { 0.08 } else { 0.35 };
    for _ in 0..count_per_m2(canvas, density_per_m2) {
        stain(
            canvas,
            area.random_spot(rng),
            rng.random_range(0.1..0.5),
            rng,
        );
        let shade = rng.random_range(60.0..120.0);
        let width_m = rng.random_range(0.006..0.012);
        wander(canvas, area.random_spot(rng), width_m, shade, rng);
    }
    sockets(canvas, rng);
    if bare || height_m < 1.0 {
        return;
    }
    for _ in 0..count_per_m2(canvas, 0.3) {
        let mut spot = area.random_spot(rng);
        spot[1] = height_m - rng.random_range(0.9..2.1);
        let extents = [0; 2].map(|_| rng.random_range(0.2..0.75));
        poster(canvas, &Area::around(spot, extents), rng);
    }
}

/// Sockets at the skirting, switches higher up, and a duct now and then.
fn sockets(canvas: &mut Canvas, rng: &mut impl Rng) {
    let [width_m, height_m] = canvas.area().extents();
    for _ in 0..(width_m / 1.5) as usize {
        let above_m = if rng.random_bool(0.6) { 0.3 } else { 1.1 };
        let spot = [rng.random_range(0.0..width_m), height_m - above_m];
        let plate = [rng.random_range(0.08..0.24), 0.08];
        canvas.fill_area(&Area::around(spot, plate), Ink::solid(215.0));
        canvas.fill_area(&Area::around(spot, [0.03, 0.03]), Ink::solid(40.0));
    }
    if rng.random_bool(0.4) {
        let x = rng.random_range(0.0..width_m);
        let shade = rng.random_range(90.0..200.0);
        canvas.stroke([x, 0.0], [x, height_m], 0.06, Ink::solid(shade));
    }
}

pub fn door(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    let frame = rng.random_range(40.0..200.0);
    canvas.fill_area(&area, Ink::solid(frame));
    let leaf = Area {
        from: [area.from[0] + 0.06, area.from[1] + 0.06],
        to: [area.to[0] - 0.06, area.to[1]],
    };
    canvas.fill_area(&leaf, Ink::solid(rng.random_range(60.0..200.0)));
    weather(canvas, 3.0, rng);
    let side = if rng.random_bool(0.5) { 0.12 } else { 0.88 };
    let [x, y] = leaf.at(side, 0.52);
    canvas.fill_area(&Area::around([x, y], [0.05, 0.22]), Ink::solid(225.0));
    canvas.fill_area(&Area::around([x, y - 0.03], [0.15, 0.03]), Ink::solid(30.0));
    let sign = Area::around(leaf.at(0.5, 0.27), [0.3, 0.16]);
    canvas.fill_area(&sign, Ink::solid(235.0));
    write(
        canvas,
        &sign.shrunk(0.015),
        rng.random_range(0.03..0.06),
        30.0,
        rng,
    );
    if rng.random_bool(0.35) {
        let pane = Area::around(leaf.at(0.5, 0.2), [0.25, 0.6]);
        canvas.fill_area(&pane, Ink::solid(rng.random_range(30.0..70.0)));
    }
    if rng.random_bool(0.5) {
        let size_m = [rng.random_range(0.2..0.4), rng.random_range(0.25..0.4)];
        poster(canvas, &Area::around(leaf.at(0.5, 0.42), size_m), rng);
    }
}

pub fn window(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    let [width_m, height_m] = area.extents();
    canvas.fill_area(&area, Ink::solid(185.0));
    for _ in 0..14 {
        let outside = Figure {
            outline: Outline::Ellipse,
            centre: area.random_spot(rng),
            extents: [0; 2].map(|_| rng.random_range(0.15..0.7)),
            angle_rad: rng.random_range(0.0..3.0),
        };
        let shade = rng.random_range(120.0..235.0);
        canvas.fill(
            &outside,
            Ink {
                shade,
                opacity: 0.35,
            },
        );
    }
    let frame = Ink::solid(rng.random_range(40.0..90.0));
    for column in 0..3 {
        let x = 0.03 + (width_m - 0.06) * 0.5 * column as f32;
        canvas.stroke([x, 0.0], [x, height_m], 0.06, frame);
    }
    for y in [0.03, 0.7 * height_m, height_m - 0.03] {
        canvas.stroke([0.0, y], [width_m, y], 0.06, frame);
    }
}

pub fn sheet(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    poster(canvas, &area, rng);
}

pub fn carpet(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    canvas.fill_area(&area, Ink::solid(rng.random_range(70.0..130.0)));
    weather(canvas, 7.0, rng);
    let flecks = Leaves {
        size_m_min: 0.03,
        size_m_max: 0.12,
        coverage: 0.06,
        opacity: 0.3,
    };
    strew(canvas, &area, &flecks, rng);
    for _ in 0..count_per_m2(canvas, 0.25) {
        stain(
            canvas,
            area.random_spot(rng),
            rng.random_range(0.1..0.5),
            rng,
        );
    }
}

/// Articles and pictures edge to edge, with small print.
pub fn board(canvas: &mut Canvas, rng: &mut impl Rng) {
    let area = canvas.area();
    canvas.fill_area(&area, Ink::solid(rng.random_range(110.0..170.0)));
    weather(canvas, 6.0, rng);
    let ground = Leaves {
        size_m_min: 0.012,
        size_m_max: 0.25,
        coverage: 0.5,
        opacity: 0.35,
    };
    strew(canvas, &area, &ground, rng);
    let [width_m, height_m] = area.extents();
    for _ in 0..count_per_m2(canvas, 14.0) {
        let extents = [
            rng.random_range(0.12..0.45_f32).min(0.7 * width_m),
            rng.random_range(0.1..0.35_f32).min(0.7 * height_m),
        ];
        let piece = Area::around(area.random_spot(rng), extents);
        match rng.random_range(0..4) {
            0 => {
                canvas.fill_area(&piece, Ink::solid(225.0));
                write(
                    canvas,
                    &piece.shrunk(0.01),
                    rng.random_range(0.008..0.03),
                    35.0,
                    rng,
                );
            }
            1 => {
                canvas.fill_area(&piece, Ink::solid(215.0));
                code(canvas, &piece.shrunk(0.01), 40.0, rng);
            }
            2 => {
                let leaves = Leaves {
                    size_m_min: 0.008,
                    size_m_max: 0.2,
                    coverage: 1.4,
                    opacity: 0.9,
                };
                strew(canvas, &piece, &leaves, rng);
            }
            _ => poster(canvas, &piece, rng),
        }
    }
    scratches(canvas, 0.05, rng);
    labels(canvas, 2.0, rng);
}

//! Things that are painted on surfaces: leaves, writing, posters, stains, tiles.

use rand::{Rng, RngExt};

use super::canvas::{Area, Canvas, Figure, Ink, Outline, Spot};

/// Many figures over each other, with sizes by a power law.
#[derive(Clone, Copy, Debug)]
pub struct Leaves {
    pub size_m_min: f32,
    pub size_m_max: f32,
    /// Their summed area over the area they are strewn on.
    pub coverage: f32,
    pub opacity: f32,
}

/// Strews leaves whose density falls with the cube of their size: every scale covers the same.
pub fn strew(canvas: &mut Canvas, area: &Area, leaves: &Leaves, rng: &mut impl Rng) {
    let [width_m, height_m] = area.extents();
    let budget_m2 = width_m * height_m * leaves.coverage;
    let size_m_max = leaves.size_m_max.min(width_m.min(height_m));
    if size_m_max <= leaves.size_m_min {
        return;
    }
    let (most, least) = (leaves.size_m_min.powi(-2), size_m_max.powi(-2));
    let mut painted_m2 = 0.0;
    while painted_m2 < budget_m2 {
        let size_m = rng.random_range(least..most).powf(-0.5);
        let figure = random_figure(area.random_spot(rng), size_m, rng);
        painted_m2 += 0.7 * figure.extents[0] * figure.extents[1];
        let ink = Ink {
            shade: contrasting_shade(rng),
            opacity: leaves.opacity,
        };
        canvas.fill(&clipped(figure, area), ink);
    }
}

/// Dark and bright are likelier than the middle.
fn contrasting_shade(rng: &mut impl Rng) -> f32 {
    if rng.random_bool(0.5) {
        rng.random_range(25.0..95.0)
    } else {
        rng.random_range(150.0..235.0)
    }
}

fn random_figure(centre: Spot, size_m: f32, rng: &mut impl Rng) -> Figure {
    let outline = match rng.random_range(0..10) {
        0..5 => Outline::Rectangle,
        5..8 => Outline::Triangle,
        _ => Outline::Ellipse,
    };
    Figure {
        outline,
        centre,
        extents: [size_m, size_m * rng.random_range(0.35..1.0)],
        angle_rad: rng.random_range(0.0..std::f32::consts::TAU),
    }
}

/// Moves a figure inwards until it does not leave the area by more than a little.
fn clipped(mut figure: Figure, area: &Area) -> Figure {
    let reach = 0.5 * figure.extents[0];
    for axis in 0..2 {
        let (from, to) = (area.from[axis] + reach, area.to[axis] - reach);
        figure.centre[axis] = if from < to {
            figure.centre[axis].clamp(from, to)
        } else {
            0.5 * (from + to)
        };
    }
    figure
}

/// Lines of glyphs, each a few strokes.
pub fn write(canvas: &mut Canvas, area: &Area, glyph_m: f32, shade: f32, rng: &mut impl Rng) {
    let [width_m, height_m] = area.extents();
    let line_m = 1.7 * glyph_m;
    for line in 0..(height_m / line_m) as usize {
        let length_m = width_m * rng.random_range(0.55..1.0);
        let mut cursor_m = 0.0;
        while cursor_m + glyph_m < length_m {
            if rng.random_bool(0.85) {
                let corner = [
                    area.from[0] + cursor_m,
                    area.from[1] + line as f32 * line_m + 0.2 * glyph_m,
                ];
                glyph(canvas, corner, glyph_m, shade, rng);
            }
            cursor_m += 0.85 * glyph_m;
        }
    }
}

fn glyph(canvas: &mut Canvas, corner: Spot, size_m: f32, shade: f32, rng: &mut impl Rng) {
    let node = |rng: &mut dyn FnMut() -> u32| {
        let pick = rng();
        let (column, row) = (pick % 2, pick / 2 % 3);
        [
            corner[0] + 0.6 * size_m * column as f32,
            corner[1] + 0.5 * size_m * row as f32,
        ]
    };
    let mut pick = || rng.random_range(0..6_u32);
    for _ in 0..4 {
        let (from, to) = (node(&mut pick), node(&mut pick));
        if from != to {
            canvas.stroke(from, to, 0.17 * size_m, Ink::solid(shade));
        }
    }
}

/// A sheet with a picture, a drawing, writing or a code on it.
pub fn poster(canvas: &mut Canvas, area: &Area, rng: &mut impl Rng) {
    let bright = rng.random_bool(0.65);
    let paper: f32 = if bright {
        rng.random_range(180.0..230.0)
    } else {
        rng.random_range(30.0..80.0)
    };
    let ink: f32 = if bright {
        rng.random_range(15.0..70.0)
    } else {
        rng.random_range(190.0..240.0)
    };
    canvas.fill_area(area, Ink::solid(ink));
    let inner = area.shrunk(0.012);
    canvas.fill_area(&inner, Ink::solid(paper));
    let [width_m, height_m] = inner.extents();
    let title_m = (0.1 * height_m).clamp(0.02, 0.09);
    let title = Area {
        from: inner.at(0.06, 0.04),
        to: [
            inner.at(0.94, 0.0)[0],
            inner.at(0.0, 0.04)[1] + 1.7 * title_m,
        ],
    };
    write(canvas, &title, title_m, ink, rng);
    let body = Area {
        from: [inner.at(0.06, 0.0)[0], title.to[1] + 0.01],
        to: inner.at(0.94, 0.95),
    };
    let size_m = width_m.min(height_m);
    match rng.random_range(0..4) {
        0 => code(canvas, &body, ink, rng),
        1 => {
            let upper = Area {
                from: body.from,
                to: body.at(1.0, 0.55),
            };
            picture(canvas, &upper, size_m, rng);
            let lower = Area {
                from: body.at(0.0, 0.6),
                to: body.to,
            };
            write(canvas, &lower, rng.random_range(0.018..0.04), ink, rng);
        }
        _ => picture(canvas, &body, size_m, rng),
    }
}

fn picture(canvas: &mut Canvas, area: &Area, size_m: f32, rng: &mut impl Rng) {
    let leaves = Leaves {
        size_m_min: 0.018,
        size_m_max: 0.5 * size_m,
        coverage: 1.6,
        opacity: 1.0,
    };
    strew(canvas, area, &leaves, rng);
}

/// A field of square cells, dark or not.
pub fn code(canvas: &mut Canvas, area: &Area, shade: f32, rng: &mut impl Rng) {
    let [width_m, height_m] = area.extents();
    let cell_m = rng.random_range(0.02..0.05);
    let count = |extent_m: f32| (extent_m / cell_m) as usize;
    for row in 0..count(height_m) {
        for column in 0..count(width_m) {
            if rng.random_bool(0.45) {
                let from = [
                    area.from[0] + column as f32 * cell_m,
                    area.from[1] + row as f32 * cell_m,
                ];
                let to = from.map(|edge| edge + cell_m);
                canvas.fill_area(&Area { from, to }, Ink::solid(shade));
            }
        }
    }
}

/// Cells with a joint between them, each of its own shade; `offset` shifts every other row.
#[derive(Clone, Copy, Debug)]
pub struct Tiling {
    pub cell: Spot,
    pub joint_m: f32,
    pub joint_shade: f32,
    pub shade: f32,
    pub shade_spread: f32,
    pub offset: f32,
}

pub fn tile(canvas: &mut Canvas, tiling: &Tiling, rng: &mut impl Rng) {
    let whole = canvas.area();
    canvas.fill_area(&whole, Ink::solid(tiling.joint_shade));
    let [width_m, height_m] = whole.extents();
    let rows = (height_m / tiling.cell[1]) as usize + 1;
    let columns = (width_m / tiling.cell[0]) as usize + 2;
    for row in 0..rows {
        let shift = if row % 2 == 0 { 0.0 } else { tiling.offset };
        for column in 0..columns {
            let from = [
                (column as f32 - shift) * tiling.cell[0],
                row as f32 * tiling.cell[1],
            ];
            let to = [from[0] + tiling.cell[0], from[1] + tiling.cell[1]];
            let spread = rng.random_range(-tiling.shade_spread..tiling.shade_spread);
            let cell = Area { from, to }.shrunk(0.5 * tiling.joint_m);
            canvas.fill_area(&cell, Ink::solid(tiling.shade + spread));
        }
    }
}

/// Soft patches, as of damp or spilled paint.
pub fn stain(canvas: &mut Canvas, centre: Spot, size_m: f32, rng: &mut impl Rng) {
    let shade = contrasting_shade(rng);
    for _ in 0..7 {
        let shift = [0, 1].map(|_| rng.random_range(-0.5..0.5) * size_m);
        let figure = Figure {
            outline: Outline::Ellipse,
            centre: [centre[0] + shift[0], centre[1] + shift[1]],
            extents: [0, 1].map(|_| size_m * rng.random_range(0.2..0.7)),
            angle_rad: rng.random_range(0.0..3.0),
        };
        let opacity = rng.random_range(0.12..0.45);
        canvas.fill(&figure, Ink { shade, opacity });
    }
}

/// A line that wanders, as a crack or a cable does.
pub fn wander(canvas: &mut Canvas, start: Spot, width_m: f32, shade: f32, rng: &mut impl Rng) {
    let mut spot = start;
    let mut angle_rad: f32 = rng.random_range(0.0..std::f32::consts::TAU);
    for _ in 0..rng.random_range(5..16) {
        angle_rad += rng.random_range(-0.9..0.9);
        let length_m = rng.random_range(0.03..0.16);
        let next = [
            spot[0] + length_m * angle_rad.cos(),
            spot[1] + length_m * angle_rad.sin(),
        ];
        canvas.stroke(spot, next, width_m, Ink::solid(shade));
        spot = next;
    }
}

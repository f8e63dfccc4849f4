//! A grey picture with a scale in metres.

use rand::{Rng, RngExt};

/// A picture in the making: shades from 0 to 255, `u` to the right and `v` down in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Canvas {
    width: usize,
    height: usize,
    texel_m: f32,
    shades: Vec<f32>,
}

/// A point or an extent on a canvas, metres.
pub type Spot = [f32; 2];

/// An upright part of a canvas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    pub from: Spot,
    pub to: Spot,
}

impl Area {
    pub fn around(centre: Spot, extents: Spot) -> Self {
        let half = extents.map(|extent| 0.5 * extent);
        Self {
            from: [centre[0] - half[0], centre[1] - half[1]],
            to: [centre[0] + half[0], centre[1] + half[1]],
        }
    }

    pub fn extents(&self) -> Spot {
        [self.to[0] - self.from[0], self.to[1] - self.from[1]]
    }

    pub fn centre(&self) -> Spot {
        [
            0.5 * (self.from[0] + self.to[0]),
            0.5 * (self.from[1] + self.to[1]),
        ]
    }

    pub fn shrunk(&self, margin_m: f32) -> Self {
        Self {
            from: self.from.map(|edge| edge + margin_m),
            to: self.to.map(|edge| edge - margin_m),
        }
    }

    /// The point at these fractions of the extents.
    pub fn at(&self, right: f32, down: f32) -> Spot {
        let [width, height] = self.extents();
        [self.from[0] + right * width, self.from[1] + down * height]
    }

    pub fn random_spot(&self, rng: &mut impl Rng) -> Spot {
        self.at(rng.random(), rng.random())
    }
}

/// An outline; distances outside are positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outline {
    Rectangle,
    Ellipse,
    /// The left and upper half of the rectangle, cut along its diagonal.
    Triangle,
}

/// An outline of this size, turned about its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    pub outline: Outline,
    pub centre: Spot,
    pub extents: Spot,
    pub angle_rad: f32,
}

/// What a figure is filled with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ink {
    pub shade: f32,
    /// From 0 (nothing) to 1 (hides what was there).
    pub opacity: f32,
}

impl Ink {
    pub fn solid(shade: f32) -> Self {
        Self {
            shade,
            opacity: 1.0,
        }
    }
}

impl Canvas {
    /// A mid-grey canvas. Its last texels may reach beyond the edge by less than one texel.
    pub fn new(width_m: f64, height_m: f64, texel_m: f64) -> Self {
        let count = |extent_m: f64| ((extent_m / texel_m).ceil() as usize).max(1);
        let (width, height) = (count(width_m), count(height_m));
        Self {
            width,
            height,
            texel_m: texel_m as f32,
            shades: vec![128.0; width * height],
        }
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    pub fn texel_m(&self) -> f32 {
        self.texel_m
    }

    pub fn shades(&self) -> &[f32] {
        &self.shades
    }

    pub fn area(&self) -> Area {
        Area {
            from: [0.0, 0.0],
            to: [
                self.width as f32 * self.texel_m,
                self.height as f32 * self.texel_m,
            ],
        }
    }

    /// Adds smooth noise with this grain, between `-amplitude` and `amplitude`.
    pub fn add_noise(&mut self, area: &Area, grain_m: f32, amplitude: f32, rng: &mut impl Rng) {
        let [width_m, height_m] = area.extents();
        let columns = (width_m / grain_m) as usize + 2;
        let rows = (height_m / grain_m) as usize + 2;
        let lattice: Vec<f32> = (0..columns * rows)
            .map(|_| rng.random_range(-amplitude..amplitude))
            .collect();
        let (xs, ys) = (self.span(area, 0), self.span(area, 1));
        let place = |texel: usize, axis: usize| {
            let position = ((texel as f32 + 0.5) * self.texel_m - area.from[axis]) / grain_m;
            let cell = position.max(0.0) as usize;
            let t = position.max(0.0) - cell as f32;
            (cell, t * t * (3.0 - 2.0 * t))
        };
        let columns_of: Vec<(usize, f32)> = xs.clone().map(|x| place(x, 0)).collect();
        for y in ys {
            let (row, down) = place(y, 1);
            let upper = &lattice[row.min(rows - 2) * columns..][..2 * columns];
            let shades = &mut self.shades[y * self.width..][xs.clone()];
            for (shade, &(column, right)) in shades.iter_mut().zip(&columns_of) {
                let column = column.min(columns - 2);
                let left = upper[column] + (upper[column + columns] - upper[column]) * down;
                let other =
                    upper[column + 1] + (upper[column + columns + 1] - upper[column + 1]) * down;
                *shade += left + (other - left) * right;
            }
        }
    }

    /// Fills a figure, with edges as soft as a texel.
    pub fn fill(&mut self, figure: &Figure, ink: Ink) {
        let (sine, cosine) = figure.angle_rad.sin_cos();
        let half = figure.extents.map(|extent| 0.5 * extent);
        let (sine_abs, cosine_abs) = (sine.abs(), cosine.abs());
        let reach = [
            2.0 * (cosine_abs * half[0] + sine_abs * half[1]) + 2.0 * self.texel_m,
            2.0 * (sine_abs * half[0] + cosine_abs * half[1]) + 2.0 * self.texel_m,
        ];
        let bounds = Area::around(figure.centre, reach);
        let (xs, ys) = (self.span(&bounds, 0), self.span(&bounds, 1));
        let per_texel = 1.0 / self.texel_m;
        for y in ys {
            let dv = (y as f32 + 0.5) * self.texel_m - figure.centre[1];
            for x in xs.clone() {
                let du = (x as f32 + 0.5) * self.texel_m - figure.centre[0];
                let local = [cosine * du + sine * dv, cosine * dv - sine * du];
                let outside_m = figure.outline.distance_m(local, half);
                let coverage = (0.5 - outside_m * per_texel).clamp(0.0, 1.0) * ink.opacity;
                let shade = &mut self.shades[y * self.width + x];
                *shade += (ink.shade - *shade) * coverage;
            }
        }
    }

    /// An upright rectangle.
    pub fn fill_area(&mut self, area: &Area, ink: Ink) {
        let figure = Figure {
            outline: Outline::Rectangle,
            centre: area.centre(),
            extents: area.extents(),
            angle_rad: 0.0,
        };
        self.fill(&figure, ink);
    }

    /// A straight stroke.
    pub fn stroke(&mut self, from: Spot, to: Spot, width_m: f32, ink: Ink) {
        let along = [to[0] - from[0], to[1] - from[1]];
        let figure = Figure {
            outline: Outline::Rectangle,
            centre: [0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])],
            extents: [along[0].hypot(along[1]), width_m],
            angle_rad: along[1].atan2(along[0]),
        };
        self.fill(&figure, ink);
    }

    /// Leaves this share of the contrast, about the mean.
    pub fn fade(&mut self, contrast: f32) {
        if contrast >= 1.0 {
            return;
        }
        let mean = self.shades.iter().sum::<f32>() / self.shades.len() as f32;
        for shade in &mut self.shades {
            *shade = mean + contrast * (*shade - mean);
        }
    }

    /// Multiplies by `light(u_m, v_m)`, which is sampled every 0.25 m.
    pub fn light(&mut self, light: &impl Fn(f64, f64) -> f32) {
        let step = ((0.25 / self.texel_m) as usize).max(1);
        let columns = self.width / step + 2;
        let at = |column: usize, row: usize| {
            let spacing_m = f64::from(self.texel_m) * step as f64;
            light(column as f64 * spacing_m, row as f64 * spacing_m)
        };
        for first_row in (0..self.height).step_by(step) {
            let row = first_row / step;
            let upper: Vec<f32> = (0..columns).map(|column| at(column, row)).collect();
            let lower: Vec<f32> = (0..columns).map(|column| at(column, row + 1)).collect();
            for y in first_row..(first_row + step).min(self.height) {
                let down = ((y - first_row) as f32 + 0.5) / step as f32;
                for x in 0..self.width {
                    let column = x / step;
                    let right = ((x - column * step) as f32 + 0.5) / step as f32;
                    let left = upper[column] + (lower[column] - upper[column]) * down;
                    let other = upper[column + 1] + (lower[column + 1] - upper[column + 1]) * down;
                    self.shades[y * self.width + x] *= left + (other - left) * right;
                }
            }
        }
    }

    /// Sets every texel to the shade at its centre.
    #[cfg(test)]
    pub fn paint_each(&mut self, shade: &impl Fn(f64, f64) -> f32) {
        let metres = |texel: usize| (texel as f64 + 0.5) * f64::from(self.texel_m);
        for (idx, value) in self.shades.iter_mut().enumerate() {
            *value = shade(metres(idx % self.width), metres(idx / self.width));
        }
    }

    /// The texels of a row (axis 0) or column (axis 1) whose centres lie within an area.
    fn span(&self, area: &Area, axis: usize) -> std::ops::Range<usize> {
        let count = [self.width, self.height][axis];
        let texel = |edge_m: f32| (edge_m / self.texel_m - 0.5).ceil().max(0.0) as usize;
        let end = texel(area.to[axis]).min(count);
        texel(area.from[axis]).min(end)..end
    }
}

impl Outline {
    /// The distance outside, exact along straight edges and close to exact along curved ones.
    fn distance_m(self, local: Spot, half: Spot) -> f32 {
        let [x, y] = local;
        let box_m = (x.abs() - half[0]).max(y.abs() - half[1]);
        match self {
            Self::Rectangle => box_m,
            Self::Ellipse => {
                let (a, b) = (x / half[0], y / half[1]);
                let radius = a.hypot(b);
                let slope = (a / half[0]).hypot(b / half[1]);
                if slope > 0.0 {
                    radius * (radius - 1.0) / slope
                } else {
                    -half[0].min(half[1])
                }
            }
            Self::Triangle => {
                let diagonal_m = (x * half[1] + y * half[0]) / half[0].hypot(half[1]);
                box_m.max(diagonal_m)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn painted_m2(figure: &Figure) -> f32 {
        let mut canvas = Canvas::new(1.0, 1.0, 0.005);
        canvas.fill_area(&canvas.area(), Ink::solid(0.0));
        canvas.fill(figure, Ink::solid(1.0));
        canvas.shades.iter().sum::<f32>() * 0.005 * 0.005
    }

    #[test]
    fn figures_cover_their_area() {
        for angle_rad in [0.0, 0.3, 2.0] {
            let figure = |outline| Figure {
                outline,
                centre: [0.5, 0.45],
                extents: [0.4, 0.2],
                angle_rad,
            };
            let error = (painted_m2(&figure(Outline::Rectangle)) - 0.08).abs();
            assert!(error < 1e-3, "{error}");
            let ellipse_m2 = 0.02 * std::f32::consts::PI;
            assert!((painted_m2(&figure(Outline::Ellipse)) - ellipse_m2).abs() < 1e-3);
            assert!((painted_m2(&figure(Outline::Triangle)) - 0.04).abs() < 1e-3);
        }
    }

    #[test]
    fn figures_beyond_the_edge_are_cut() {
        let mut canvas = Canvas::new(0.1, 0.1, 0.01);
        let area = Area {
            from: [-5.0, -5.0],
            to: [0.05, 7.0],
        };
        canvas.fill_area(&area, Ink::solid(0.0));
        assert_eq!(
            canvas.shades.iter().filter(|shade| **shade == 0.0).count(),
            50
        );
        canvas.stroke([9.0, 9.0], [9.5, 9.9], 0.1, Ink::solid(3.0));
        assert!(!canvas.shades.contains(&3.0));
    }

    #[test]
    fn noise_stays_within_its_amplitude() {
        let mut canvas = Canvas::new(0.5, 0.3, 0.01);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        canvas.add_noise(&canvas.area(), 0.07, 10.0, &mut rng);
        let (least, most) = canvas
            .shades
            .iter()
            .fold((255.0_f32, 0.0_f32), |(a, b), s| (a.min(*s), b.max(*s)));
        assert!(least >= 118.0 && most <= 138.0 && most - least > 8.0);
    }
}

//! Pictures at several resolutions, sampled without aliasing.

use crate::paint::Canvas;

/// A grey picture with its halved copies (Williams 1983).
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    levels: Vec<Level>,
    /// All levels; each row and each level ends with a copy of its last texels, so that the
    /// neighbour to the right of and below any texel exists.
    texels: Vec<u8>,
    texels_per_m: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Level {
    start: usize,
    stride: usize,
    x_max: f32,
    y_max: f32,
}

/// How a pixel's footprint lies on a picture, texels per pixel step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    pub right: [f32; 2],
    pub down: [f32; 2],
}

/// A footprint is sampled at most this often along its longer side.
const PROBE_COUNT_MAX: f32 = 4.0;

impl Picture {
    pub fn new(canvas: &Canvas) -> Self {
        let mut picture = Self {
            levels: Vec::new(),
            texels: Vec::new(),
            texels_per_m: 1.0 / canvas.texel_m(),
        };
        let (mut width, mut height) = (canvas.width(), canvas.height());
        let mut shades = canvas.shades().to_vec();
        loop {
            picture.push_level(&shades, width, height);
            if width.max(height) == 1 {
                return picture;
            }
            (shades, width, height) = halved(&shades, width, height);
        }
    }

    pub fn texels_per_m(&self) -> f32 {
        self.texels_per_m
    }

    fn push_level(&mut self, shades: &[f32], width: usize, height: usize) {
        self.levels.push(Level {
            start: self.texels.len(),
            stride: width + 1,
            x_max: width as f32 - 1.0,
            y_max: height as f32 - 1.0,
        });
        for y in 0..=height {
            let row = &shades[y.min(height - 1) * width..][..width];
            let quantised = row
                .iter()
                .map(|shade| shade.round().clamp(0.0, 255.0) as u8);
            self.texels.extend(quantised);
            self.texels.push(self.texels[self.texels.len() - 1]);
        }
    }

    /// The mean shade under a footprint around `(u, v)` metres from the top left corner.
    #[inline]
    pub fn sample(&self, u_m: f32, v_m: f32, footprint: &Footprint) -> f32 {
        let Footprint { right, down } = *footprint;
        let right_squared = right[0] * right[0] + right[1] * right[1];
        let down_squared = down[0] * down[0] + down[1] * down[1];
        let (major_squared, axis) = if right_squared > down_squared {
            (right_squared, right)
        } else {
            (down_squared, down)
        };
        let major = major_squared.sqrt().max(1e-6);
        let minor = (right[0] * down[1] - right[1] * down[0]).abs() / major;
        let width = minor.max(major / PROBE_COUNT_MAX);
        let detail = fast_log2(width).max(0.0);
        let (x, y) = (u_m * self.texels_per_m, v_m * self.texels_per_m);
        // A magnified picture needs no probes: its texels are larger than the footprint.
        let spread = (major - width.max(1.0)).max(0.0) / major;
        if spread < 0.2 {
            return self.between_levels(x, y, detail);
        }
        let probe_count = if spread < 0.55 { 2 } else { 4 };
        let step = spread / (probe_count - 1) as f32;
        let mut sum = 0.0;
        for probe in 0..probe_count {
            let along = step * probe as f32 - 0.5 * spread;
            sum += self.between_levels(x + axis[0] * along, y + axis[1] * along, detail);
        }
        sum / probe_count as f32
    }

    #[inline]
    fn between_levels(&self, x: f32, y: f32, detail: f32) -> f32 {
        let level = detail as usize;
        let coarser = detail - level as f32;
        if level + 1 >= self.levels.len() {
            return self.bilinear(self.levels.len() - 1, x, y);
        }
        let fine = self.bilinear(level, x, y);
        if coarser < 0.01 {
            return fine;
        }
        fine + (self.bilinear(level + 1, x, y) - fine) * coarser
    }

    /// `x` and `y` count texels of the finest level from the picture's corner.
    #[inline]
    fn bilinear(&self, level_idx: usize, x: f32, y: f32) -> f32 {
        let level = &self.levels[level_idx];
        let scale = f32::from_bits((127 - level_idx as u32) << 23);
        let x = (x * scale - 0.5).max(0.0).min(level.x_max);
        let y = (y * scale - 0.5).max(0.0).min(level.y_max);
        let (column, row) = (x as u32 as usize, y as u32 as usize);
        let (right, down) = (x - column as f32, y - row as f32);
        let start = level.start + row * level.stride + column;
        // One bounds check for the two rows.
        let texels = &self.texels[start..start + level.stride + 2];
        let [a, b, c, d] = [
            texels[0],
            texels[1],
            texels[level.stride],
            texels[level.stride + 1],
        ]
        .map(f32::from);
        let upper = a + (b - a) * right;
        let lower = c + (d - c) * right;
        upper + (lower - upper) * down
    }
}

fn halved(shades: &[f32], width: usize, height: usize) -> (Vec<f32>, usize, usize) {
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let mut half = Vec::with_capacity(half_width * half_height);
    for y in 0..half_height {
        let upper = &shades[2 * y * width..][..width];
        let lower = &shades[(2 * y + 1).min(height - 1) * width..][..width];
        for x in 0..half_width {
            let (left, right) = (2 * x, (2 * x + 1).min(width - 1));
            half.push(0.25 * (upper[left] + upper[right] + lower[left] + lower[right]));
        }
    }
    (half, half_width, half_height)
}

/// log₂ with an error below 0.01, for positive normal numbers.
#[inline]
fn fast_log2(value: f32) -> f32 {
    let bits = value.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let mantissa = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    exponent as f32 + (mantissa - 1.0) * (1.0 + 0.346_6 * (2.0 - mantissa))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(side: f32) -> Footprint {
        Footprint {
            right: [side, 0.0],
            down: [0.0, side],
        }
    }

    /// A ramp along u, 1 m wide at 1 cm a texel.
    fn ramp() -> Picture {
        let mut canvas = Canvas::new(1.0, 0.6, 0.01);
        let light = |u_m: f64, _: f64| 0.5 + u_m as f32;
        canvas.light(&light);
        Picture::new(&canvas)
    }

    #[test]
    fn every_resolution_shows_the_same_place() {
        let picture = ramp();
        for side in [0.3, 1.0, 2.0, 3.3, 8.0] {
            let shade = picture.sample(0.5, 0.3, &square(side));
            // The ramp rises by 1.28 a texel, so half a shade is within 0.4 texels.
            assert!((shade - 128.0).abs() < 0.6, "{side}: {shade}");
        }
        let slanted = Footprint {
            right: [6.0, 1.0],
            down: [0.0, 1.0],
        };
        assert!((picture.sample(0.5, 0.3, &slanted) - 128.0).abs() < 0.6);
    }

    #[test]
    fn samples_beyond_the_edge_repeat_it() {
        let picture = ramp();
        for side in [0.5, 3.0, 400.0] {
            for (u_m, v_m) in [(-3.0, -2.0), (9.0, 9.0), (f32::NAN, 0.0)] {
                let shade = picture.sample(u_m, v_m, &square(side));
                assert!((60.0..=195.0).contains(&shade), "{shade}");
            }
        }
    }

    #[test]
    fn logarithm_is_close() {
        for value in [0.01_f32, 0.7, 1.0, 1.5, 3.0, 700.0] {
            assert!((fast_log2(value) - value.log2()).abs() < 0.01, "{value}");
        }
    }
}

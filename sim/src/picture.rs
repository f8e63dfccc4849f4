//! Pictures at several resolutions, sampled without aliasing.

use crate::paint::Canvas;

/// A grey picture with its halved copies (Williams 1983).
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    levels: Vec<Level>,
    /// All levels: each texel in the low byte, the one below it in the high byte, so that two
    /// neighbours are the four texels of an interpolation. Each row ends with a copy of its last
    /// texel.
    texels: Vec<u16>,
    texels_per_m: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Level {
    start: usize,
    stride: usize,
    /// [`STEPS`] of this level per texel of the finest.
    scale: f32,
    x_max: f32,
    y_max: f32,
}

/// Neighbouring pixels that are sampled together, so that what they share is computed once and
/// the rest in vector registers.
pub const LANES: usize = 8;
pub type Lanes = [f32; LANES];

/// Where pixels lie on a picture, in texels of the finest level from its top left corner, and
/// the steps to their neighbours, per pixel to the right and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprints {
    pub position: [Lanes; 2],
    pub right: [Lanes; 2],
    pub down: [Lanes; 2],
}

/// How footprints are sampled.
struct Probes {
    /// Levels above the finest, times 256.
    detail: [u32; LANES],
    count: [u32; LANES],
    first: [Lanes; 2],
    step: [Lanes; 2],
}

/// A footprint is sampled at most this often along its longer side.
const PROBE_COUNT_MAX: f32 = 4.0;
/// Positions between texels, and between levels, count in 256ths.
const STEPS: f32 = 256.0;
/// Adding this to a positive number below 2²³ leaves its rounded value in the low bits.
const ROUNDING: f32 = 8_388_608.0;

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
            scale: STEPS / (1_u32 << self.levels.len()) as f32,
            x_max: STEPS * (width as f32 - 1.0),
            y_max: STEPS * (height as f32 - 1.0),
        });
        let quantised = |shade: f32| (shade + 0.5).clamp(0.0, 255.0) as u16;
        for y in 0..height {
            let upper = &shades[y * width..][..width];
            let lower = &shades[(y + 1).min(height - 1) * width..][..width];
            let pairs = upper.iter().zip(lower);
            self.texels
                .extend(pairs.map(|(a, c)| quantised(*a) | quantised(*c) << 8));
            self.texels.push(self.texels[self.texels.len() - 1]);
        }
    }

    /// Adds to `shades` the mean shades under the footprints times their weights; pixels without
    /// weight cost little.
    #[inline]
    pub fn add_samples(&self, footprints: &Footprints, weights: &Lanes, shades: &mut [f32]) {
        let probes = Probes::new(footprints);
        for (lane, shade) in shades.iter_mut().enumerate().take(LANES) {
            if weights[lane] > 0.0 {
                *shade += weights[lane] * self.sample(&probes, lane);
            }
        }
    }

    #[inline]
    fn sample(&self, probes: &Probes, lane: usize) -> f32 {
        let detail = probes.detail[lane];
        let (mut x, mut y) = (probes.first[0][lane], probes.first[1][lane]);
        let mut sum = self.between_levels(x, y, detail);
        let count = probes.count[lane];
        for _ in 1..count {
            x += probes.step[0][lane];
            y += probes.step[1][lane];
            sum += self.between_levels(x, y, detail);
        }
        sum as f32 * (1.0 / (STEPS * STEPS)) / count as f32
    }

    /// The shade times 256², `detail` levels times 256 above the finest.
    #[inline]
    fn between_levels(&self, x: f32, y: f32, detail: u32) -> u32 {
        let (level_idx, coarser) = (detail as usize >> 8, detail & 255);
        let last = self.levels.len() - 1;
        if level_idx >= last {
            return self.bilinear(last, x, y);
        }
        let fine = self.bilinear(level_idx, x, y);
        if coarser < 3 {
            return fine;
        }
        let coarse = self.bilinear(level_idx + 1, x, y);
        (fine * (256 - coarser) + coarse * coarser) >> 8
    }

    /// The shade times 256²; `x` and `y` count texels of the finest level from the corner.
    #[inline(always)]
    fn bilinear(&self, level_idx: usize, x: f32, y: f32) -> u32 {
        let level = &self.levels[level_idx];
        let fixed = |position: f32, max: f32| {
            let steps = larger(position * level.scale - 0.5 * STEPS, 0.0);
            (smaller(steps, max) + ROUNDING).to_bits() & 0x007f_ffff
        };
        let (x, y) = (fixed(x, level.x_max), fixed(y, level.y_max));
        let start = level.start + (y >> 8) as usize * level.stride + (x >> 8) as usize;
        let pair = &self.texels[start..start + 2];
        // Both rows are interpolated at once, in the halves of a word.
        let spread = |texel: u16| (u32::from(texel) | u32::from(texel) << 8) & 0x00ff_00ff;
        let (right, below) = (x & 255, y & 255);
        let rows = spread(pair[0]) * (256 - right) + spread(pair[1]) * right;
        (rows & 0xffff) * (256 - below) + (rows >> 16) * below
    }
}

impl Probes {
    /// Probes along the longer side of each footprint, on the level where a texel is as wide as
    /// its shorter side.
    #[inline]
    fn new(footprints: &Footprints) -> Self {
        let Footprints {
            position,
            right,
            down,
        } = footprints;
        let mut probes = Self {
            detail: [0; LANES],
            count: [0; LANES],
            first: [[0.0; LANES]; 2],
            step: [[0.0; LANES]; 2],
        };
        for lane in 0..LANES {
            let right = [right[0][lane], right[1][lane]];
            let down = [down[0][lane], down[1][lane]];
            let right_squared = right[0] * right[0] + right[1] * right[1];
            let down_squared = down[0] * down[0] + down[1] * down[1];
            let rightwards = right_squared > down_squared;
            let major_squared = larger(larger(right_squared, down_squared), 1e-12);
            let axis = [0, 1].map(|axis| if rightwards { right[axis] } else { down[axis] });
            let area = right[0] * down[1] - right[1] * down[0];
            let minor_squared = area * area / major_squared;
            let least_squared = major_squared * (1.0 / (PROBE_COUNT_MAX * PROBE_COUNT_MAX));
            // A magnified picture is not refined beyond its finest level.
            let width_squared = larger(larger(minor_squared, least_squared), 1.0);
            let detail = 0.5 * fast_log2(width_squared);
            probes.detail[lane] = (detail * STEPS + ROUNDING).to_bits() & 0x007f_ffff;
            // The ends of the row of probes lie half a width from the footprint's ends.
            let spread = 1.0 - (width_squared / major_squared).sqrt();
            let (count, intervals) = if spread < 0.18 {
                (1, 0.0)
            } else if spread < 0.55 {
                (2, 1.0)
            } else {
                (4, 1.0 / 3.0)
            };
            let used = if spread < 0.18 { 0.0 } else { spread };
            probes.count[lane] = count;
            for side in 0..2 {
                probes.first[side][lane] = position[side][lane] - 0.5 * used * axis[side];
                probes.step[side][lane] = used * intervals * axis[side];
            }
        }
        probes
    }
}

/// The larger number, or `other` if `value` is not a number: one instruction.
#[inline(always)]
fn larger(value: f32, other: f32) -> f32 {
    if value > other { value } else { other }
}

#[inline(always)]
fn smaller(value: f32, other: f32) -> f32 {
    if value < other { value } else { other }
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

    fn shade(picture: &Picture, spot_m: [f32; 2], right: [f32; 2], down: [f32; 2]) -> f32 {
        let footprints = Footprints {
            position: spot_m.map(|axis_m| [axis_m * picture.texels_per_m(); LANES]),
            right: right.map(|step| [step; LANES]),
            down: down.map(|step| [step; LANES]),
        };
        let mut shades = [0.0; LANES];
        let mut weights = [1.0; LANES];
        weights[LANES - 1] = 0.0;
        picture.add_samples(&footprints, &weights, &mut shades);
        assert_eq!((shades[0], shades[LANES - 1]), (shades[LANES - 2], 0.0));
        shades[0]
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
            let shade = shade(&picture, [0.5, 0.3], [side, 0.0], [0.0, side]);
            // The ramp rises by 1.28 a texel, so half a shade is within 0.4 texels.
            assert!((shade - 128.0).abs() < 0.6, "{side}: {shade}");
        }
        let slanted = shade(&picture, [0.5, 0.3], [6.0, 1.0], [0.0, 1.0]);
        assert!((slanted - 128.0).abs() < 0.6);
    }

    #[test]
    fn samples_beyond_the_edge_repeat_it() {
        let picture = ramp();
        for side in [0.5, 3.0, 400.0] {
            for (u_m, v_m) in [(-3.0, -2.0), (9.0, 9.0), (f32::NAN, 0.0)] {
                let shade = shade(&picture, [u_m, v_m], [side, 0.0], [0.0, side]);
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

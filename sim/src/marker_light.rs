//! Marker lights as a camera sees them, and pictures of them in all kinds of light.
//!
//! Levels are grey levels at exposure one, without upper bound; the sensor clips them.

mod grain;
mod pair;
mod scene;

use std::ops::Range;

use camera::Image;
use nalgebra::Vector3;
use rand::Rng;
use rand::RngExt;
use rand_distr::StandardNormal;

pub use grain::Grain;
pub use pair::picture_of_pair;
pub use scene::{MarkerFrame, MarkerScene, TruePair};

/// What lens and pixel make of a point: the standard deviation of a Gaussian.
pub(crate) const LENS_SIGMA_PX: f64 = 0.9;

/// A vehicle's two lights, one above the other in its body's frame, with the origin between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerLights {
    /// From one to the other.
    pub length_m: f64,
}

impl MarkerLights {
    /// The upper light, then the lower one.
    pub fn positions_in_body(&self) -> [Vector3<f64>; 2] {
        [0.5, -0.5].map(|side| Vector3::z() * (side * self.length_m))
    }
}

/// A light that is smaller than a pixel, spread by the lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSpot {
    pub center_px: [f64; 2],
    /// Of the Gaussian that lens and pixel make of it.
    pub sigma_px: f64,
    /// Level at the centre above what lies behind.
    pub peak: f64,
    /// How far it moves while the shutter is open, centred on `center_px`.
    pub streak_px: [f64; 2],
}

/// What falls on the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Irradiance {
    width: usize,
    height: usize,
    levels: Vec<f32>,
}

/// How the sensor turns levels into pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Factor on all levels.
    pub exposure: f64,
    /// Standard deviation of a pixel, grey levels.
    pub noise: f64,
}

/// Beyond this many sigmas a light adds less than a grey level even when it is far too bright.
const SPOT_REACH_SIGMAS: f64 = 4.5;

impl Irradiance {
    pub fn filled(width: usize, height: usize, level: f64) -> Self {
        Self {
            width,
            height,
            levels: vec![level as f32; width * height],
        }
    }

    /// An image before the sensor, as a renderer makes it.
    pub fn from_image(image: &Image) -> Self {
        Self {
            width: image.width(),
            height: image.height(),
            levels: image.pixels().iter().copied().map(f32::from).collect(),
        }
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// The level of a pixel, or `None` outside.
    pub fn level(&self, x: usize, y: usize) -> Option<f64> {
        (x < self.width && y < self.height).then(|| f64::from(self.levels[y * self.width + x]))
    }

    /// Changes each level, given its pixel.
    pub fn map(&mut self, change: impl Fn(usize, usize, f64) -> f64) {
        for (idx, level) in self.levels.iter_mut().enumerate() {
            *level = change(idx % self.width, idx / self.width, f64::from(*level)) as f32;
        }
    }

    /// Paints a rectangle; what sticks out is cut off.
    pub fn fill_rectangle(&mut self, [left, top]: [usize; 2], size: [usize; 2], level: f64) {
        for y in top..(top + size[1]).min(self.height) {
            let row = &mut self.levels[y * self.width..(y + 1) * self.width];
            let right = (left + size[0]).min(row.len());
            row[left.min(right)..right].fill(level as f32);
        }
    }

    /// A part of the picture; it must lie inside.
    pub fn cropped(&self, [left, top]: [usize; 2], [width, height]: [usize; 2]) -> Self {
        let rows = self.levels.chunks_exact(self.width).skip(top).take(height);
        Self {
            width,
            height,
            levels: rows
                .flat_map(|row| &row[left..left + width])
                .copied()
                .collect(),
        }
    }

    /// Paints a disc; what sticks out is cut off.
    pub fn fill_disc(&mut self, center_px: [f64; 2], radius_px: f64, level: f64) {
        let rows = inside(
            center_px[1] - radius_px,
            center_px[1] + radius_px,
            self.height,
        );
        for y in rows {
            let half = (radius_px.powi(2) - (y as f64 - center_px[1]).powi(2))
                .max(0.0)
                .sqrt();
            let columns = inside(center_px[0] - half, center_px[0] + half, self.width);
            let row = &mut self.levels[y * self.width..(y + 1) * self.width];
            row[columns].fill(level as f32);
        }
    }

    /// Blurs everything with a Gaussian, as the lens does; beyond the edge the edge goes on.
    pub fn blur(&mut self, sigma_px: f64) {
        let reach = (3.0 * sigma_px).ceil() as usize;
        let falloff: Vec<f32> = (0..=2 * reach)
            .map(|idx| (idx as f64 - reach as f64) / sigma_px)
            .map(|offset| (-0.5 * offset * offset).exp() as f32)
            .collect();
        let scale = 1.0 / falloff.iter().sum::<f32>();
        let weights: Vec<f32> = falloff.iter().map(|weight| weight * scale).collect();
        let (width, height) = (self.width, self.height);
        let clamped =
            |at: usize, step: usize, end: usize| (at + step).saturating_sub(reach).min(end);
        let mut across = vec![0.0; self.levels.len()];
        for y in 0..height {
            let row = &self.levels[y * width..(y + 1) * width];
            let blurred = &mut across[y * width..(y + 1) * width];
            for (step, weight) in weights.iter().enumerate() {
                for (x, sum) in blurred.iter_mut().enumerate() {
                    *sum += weight * row[clamped(x, step, width - 1)];
                }
            }
        }
        self.levels.fill(0.0);
        for (step, weight) in weights.iter().enumerate() {
            for y in 0..height {
                let from = clamped(y, step, height - 1) * width;
                let row = &across[from..from + width];
                let sums = &mut self.levels[y * width..(y + 1) * width];
                for (sum, level) in sums.iter_mut().zip(row) {
                    *sum += weight * level;
                }
            }
        }
    }

    /// Adds a light; what sticks out is cut off.
    pub fn add_spot(&mut self, spot: &LightSpot) {
        add_spot(&mut self.levels, self.width, spot);
    }

    /// The picture that the sensor gives.
    pub fn expose(&self, sensor: &Sensor, rng: &mut impl Rng) -> Image {
        let expose_pixel = |level: &f32| {
            let noise: f64 = rng.sample(StandardNormal);
            let value = f64::from(*level) * sensor.exposure + noise * sensor.noise;
            value.round().clamp(0.0, 255.0) as u8
        };
        let pixels = self.levels.iter().map(expose_pixel).collect();
        Image::from_pixels(self.width, self.height, pixels)
            .expect("there is one level for each pixel")
    }
}

/// Adds a light to levels that lie row by row; what sticks out is cut off.
pub(crate) fn add_spot(levels: &mut [f32], width: usize, spot: &LightSpot) {
    let streak_length = spot.streak_px[0].hypot(spot.streak_px[1]);
    // Steps of a third of a sigma are as smooth as the integral.
    let step_count = (3.0 * streak_length / spot.sigma_px).ceil().max(1.0) as usize;
    for step in 0..step_count {
        let along = (step as f64 + 0.5) / step_count as f64 - 0.5;
        let still = LightSpot {
            center_px: std::array::from_fn(|axis| {
                spot.center_px[axis] + along * spot.streak_px[axis]
            }),
            peak: spot.peak / step_count as f64,
            ..*spot
        };
        add_still_spot(levels, width, &still);
    }
}

fn add_still_spot(levels: &mut [f32], width: usize, spot: &LightSpot) {
    let reach = SPOT_REACH_SIGMAS * spot.sigma_px;
    let range = |center: f64, end: usize| inside(center - reach, center + reach, end);
    let falloff = |offset: f64| (-0.5 * (offset / spot.sigma_px).powi(2)).exp();
    for y in range(
        spot.center_px[1],
        levels.len().checked_div(width).unwrap_or(0),
    ) {
        let row_peak = spot.peak * falloff(y as f64 - spot.center_px[1]);
        for x in range(spot.center_px[0], width) {
            let level = row_peak * falloff(x as f64 - spot.center_px[0]);
            levels[y * width + x] += level as f32;
        }
    }
}

/// The pixels from one place to another, of those before `end`.
fn inside(first: f64, last: f64, end: usize) -> Range<usize> {
    let start = first.ceil().max(0.0) as usize;
    let stop = (last + 1.0).floor().max(0.0) as usize;
    start.min(end)..stop.min(end)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn a_spot_keeps_its_centre_and_its_flux_when_it_moves() {
        for streak_px in [[0.0, 0.0], [4.0, 3.0]] {
            let mut picture = Irradiance::filled(40, 40, 0.0);
            picture.add_spot(&LightSpot {
                center_px: [20.3, 18.8],
                sigma_px: 0.9,
                peak: 300.0,
                streak_px,
            });
            let (mut flux, mut moment_x) = (0.0, 0.0);
            for y in 0..40 {
                for x in 0..40 {
                    let level = picture.level(x, y).unwrap();
                    flux += level;
                    moment_x += level * x as f64;
                }
            }
            // The integral of a Gaussian is 2 pi sigma² times its peak.
            let expected = 2.0 * std::f64::consts::PI * 0.81 * 300.0;
            assert!((flux / expected - 1.0).abs() < 1e-3, "{flux} of {expected}");
            assert!((moment_x / flux - 20.3).abs() < 1e-3);
        }
    }

    #[test]
    fn spots_outside_the_picture_are_cut_off() {
        let mut picture = Irradiance::filled(8, 8, 5.0);
        for center_px in [[-30.0, 4.0], [7.9, 7.9], [4.0, 900.0], [f64::NAN, 0.0]] {
            picture.add_spot(&LightSpot {
                center_px,
                sigma_px: 1.0,
                peak: 100.0,
                streak_px: [0.0, 0.0],
            });
        }
        let sensor = Sensor {
            exposure: 1.0,
            noise: 0.0,
        };
        let image = picture.expose(&sensor, &mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(image.get(0, 4), 5);
        // 0.9 px from the centre in both directions: 44 of 100, above 5.
        assert_eq!(image.get(7, 7), 49);
    }
}

//! What happens to light behind the lens: motion blur, vignette, exposure and noise.

use camera::Image;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::lens::Lens;
use super::tiles::Tiles;
use super::{MARGIN_PX, Shot, TILE_PX};

/// A camera's sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSettings {
    /// Longer exposures blur more.
    pub exposure_s: f64,
    /// Noise of a black pixel, grey levels.
    pub read_noise: f64,
    /// Variance per grey level of light.
    pub shot_noise: f64,
    /// How much darker the corner furthest from the lens's centre is, from 0 to 1.
    pub vignette: f64,
}

impl Default for SensorSettings {
    /// σ is 1.2 grey levels in the dark and 2.0 at mid-grey.
    fn default() -> Self {
        Self {
            exposure_s: 0.008,
            read_noise: 1.2,
            shot_noise: 0.02,
            vignette: 0.22,
        }
    }
}

/// The exposure of an automatic camera that never quite settles, around 1.
pub fn gain_at(time_s: f64, phase_rad: f64) -> f64 {
    1.0 + 0.10 * (time_s / 2.9 + phase_rad).sin() + 0.05 * (time_s / 0.83 + 2.0 * phase_rad).sin()
}

pub struct Sensor {
    settings: SensorSettings,
    /// Transmission of the lens, row by row.
    vignette: Vec<f32>,
    /// Normal noise of unit variance, from which each row of each frame takes another part.
    noise: Vec<f32>,
}

const NOISE_COUNT: usize = 1 << 16;
/// Blur shorter than this is not worth a filter, pixels.
const BLUR_PX_MIN: f32 = 0.2;
/// Blur reaches at most to the margin on either side.
const BLUR_PX_MAX: f32 = 2.0 * (MARGIN_PX as f32 - 2.0);

impl Sensor {
    pub fn new(settings: SensorSettings, lens: &Lens) -> Self {
        let rows = 0..lens.height;
        let radii_squared: Vec<f32> = rows
            .flat_map(|y| (0..lens.width).map(move |x| lens.ray(x, y)))
            .map(|ray| ray[0] * ray[0] + ray[1] * ray[1])
            .collect();
        let most = radii_squared.iter().copied().fold(1e-6, f32::max);
        let transmission =
            |radius_squared: f32| 1.0 - settings.vignette as f32 * radius_squared / most;
        let mut rng = ChaCha8Rng::seed_from_u64(0x5e_4501);
        let row = lens.width.next_multiple_of(TILE_PX);
        Self {
            settings,
            vignette: radii_squared.into_iter().map(transmission).collect(),
            noise: (0..NOISE_COUNT + row)
                .map(|_| rng.sample(StandardNormal))
                .collect(),
        }
    }

    pub fn expose(&self, shot: &Shot, lens: &Lens, tiles: &Tiles, shades: &[f32]) -> Image {
        let mut image = Image::filled(lens.width, lens.height, 0);
        let mut rng = ChaCha8Rng::seed_from_u64(shot.noise_seed);
        let row_noise: Vec<usize> = (0..lens.height)
            .map(|_| rng.random_range(0..NOISE_COUNT))
            .collect();
        for tile_idx in 0..lens.tile_columns() * lens.tile_rows() {
            let taps = self.taps(shot, lens, tile_idx, tiles.inverse_depth(tile_idx));
            let [xs, ys] = lens.tile_pixels(tile_idx);
            for y in ys {
                let mut light = [0.0; TILE_PX];
                gather(&taps, shades, lens.place(xs.start, y), &mut light);
                let row = y * lens.width + xs.start..y * lens.width + xs.end;
                self.read_out(
                    &light,
                    shot.gain as f32,
                    &self.vignette[row.clone()],
                    &self.noise[row_noise[y] + xs.start..],
                    &mut image.pixels_mut()[row],
                );
            }
        }
        image
    }

    /// Where light comes from during the exposure, as offsets in the buffer and weights.
    fn taps(&self, shot: &Shot, lens: &Lens, tile_idx: usize, inverse_depth: f32) -> Vec<Tap> {
        let [xs, ys] = lens.tile_pixels(tile_idx);
        let (x, y) = (xs.start.midpoint(xs.end), ys.start.midpoint(ys.end));
        let ray = lens.ray(x, y);
        let per_s = image_velocity(shot, ray, inverse_depth);
        let motion =
            [0, 1].map(|axis| per_s[axis] * lens.focal_px[axis] * self.settings.exposure_s as f32);
        let length_px = motion[0].hypot(motion[1]);
        if length_px < BLUR_PX_MIN {
            return vec![Tap::CENTRE];
        }
        let shortening = (BLUR_PX_MAX / length_px).min(1.0);
        let count = 2 * (length_px.min(BLUR_PX_MAX) / 2.0).ceil() as usize + 1;
        let mut taps = Vec::with_capacity(4 * count);
        for tap in 0..count {
            // The middles of equal parts of the path.
            let along = ((tap as f32 + 0.5) / count as f32 - 0.5) * shortening;
            let offset = motion.map(|component| component * along);
            push_bilinear(&mut taps, offset, 1.0 / count as f32, lens.stride());
        }
        taps
    }

    #[inline]
    fn read_out(
        &self,
        light: &[f32; TILE_PX],
        gain: f32,
        vignette: &[f32],
        noise: &[f32],
        pixels: &mut [u8],
    ) {
        let read_variance = (self.settings.read_noise * self.settings.read_noise) as f32;
        let shot_noise = self.settings.shot_noise as f32;
        for (idx, pixel) in pixels.iter_mut().enumerate() {
            let shade = light[idx] * gain * vignette[idx];
            let sigma = (read_variance + shot_noise * shade).sqrt();
            *pixel = (shade + sigma * noise[idx] + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

#[derive(Clone, Copy)]
struct Tap {
    offset: isize,
    weight: f32,
}

impl Tap {
    const CENTRE: Self = Self {
        offset: 0,
        weight: 1.0,
    };
}

fn push_bilinear(taps: &mut Vec<Tap>, offset: [f32; 2], weight: f32, stride: usize) {
    let whole = offset.map(f32::floor);
    let part = [offset[0] - whole[0], offset[1] - whole[1]];
    for (row, row_weight) in [(0, 1.0 - part[1]), (1, part[1])] {
        for (column, column_weight) in [(0, 1.0 - part[0]), (1, part[0])] {
            taps.push(Tap {
                offset: (whole[1] as isize + row) * stride as isize + whole[0] as isize + column,
                weight: weight * row_weight * column_weight,
            });
        }
    }
}

#[inline]
fn gather(taps: &[Tap], shades: &[f32], place: usize, light: &mut [f32; TILE_PX]) {
    for tap in taps {
        let start = (place as isize + tap.offset) as usize;
        let end = (start + TILE_PX).min(shades.len());
        for (sum, shade) in light.iter_mut().zip(&shades[start..end]) {
            *sum += tap.weight * shade;
        }
    }
}

/// How fast a static point moves on the ideal plane, 1/s.
fn image_velocity(shot: &Shot, ray: [f32; 2], inverse_depth: f32) -> [f32; 2] {
    let point = Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0);
    let moved = -(shot.velocity_in_camera * f64::from(inverse_depth)
        + shot.rotation_rate_in_camera.cross(&point));
    [
        (moved.x - point.x * moved.z) as f32,
        (moved.y - point.y * moved.z) as f32,
    ]
}

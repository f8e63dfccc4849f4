//! The noise of a sensor, drawn once and used many times.

use camera::Image;
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;

use super::{Irradiance, Sensor};

/// Noise for many pictures. Each row takes its own from a random place, which is many times faster
/// than drawing it for each pixel.
#[derive(Clone, Debug)]
pub struct Grain {
    normals: Vec<f32>,
}

/// Rows begin at so many places.
const START_COUNT: usize = 1 << 16;

impl Grain {
    /// - `width_max`: of the pictures.
    pub fn new(width_max: usize, rng: &mut impl Rng) -> Self {
        let mut normal = || rng.sample::<f32, _>(StandardNormal);
        Self {
            normals: (0..START_COUNT + width_max).map(|_| normal()).collect(),
        }
    }

    /// The picture that the sensor gives of what falls on it.
    pub fn expose(&self, light: &Irradiance, sensor: &Sensor, rng: &mut impl Rng) -> Image {
        let (width, height) = (light.width(), light.height());
        let (exposure, noise) = (sensor.exposure as f32, sensor.noise as f32);
        let mut pixels = Vec::with_capacity(width * height);
        for row in light.levels.chunks_exact(width) {
            let start = rng.random_range(0..START_COUNT);
            let normals = &self.normals[start..start + width];
            // The cast cuts off, at zero and at 255 too.
            let shades = row.iter().zip(normals);
            pixels.extend(
                shades.map(|(level, normal)| (level * exposure + normal * noise + 0.5) as u8),
            );
        }
        Image::from_pixels(width, height, pixels).expect("there is one level for each pixel")
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Of 20,000 pixels the mean is good to 0.03 and the deviation to 0.5 %; whole levels add
    /// a twelfth to the variance.
    #[test]
    fn grain_has_the_sensors_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let grain = Grain::new(200, &mut rng);
        let light = Irradiance::filled(200, 100, 50.0);
        let sensor = Sensor {
            exposure: 2.0,
            noise: 4.0,
        };
        let image = grain.expose(&light, &sensor, &mut rng);
        let count = image.pixels().len() as f64;
        let offsets = || image.pixels().iter().map(|pixel| f64::from(*pixel) - 100.0);
        let mean = offsets().sum::<f64>() / count;
        let variance = offsets().map(|offset| offset * offset).sum::<f64>() / count;
        assert!(mean.abs() < 0.15, "{mean}");
        assert!(
            (variance / (16.0 + 1.0 / 12.0) - 1.0).abs() < 0.04,
            "{variance}"
        );
    }
}

//! The plainest picture of a vehicle's lights.

use camera::{CameraModel, Image};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{Irradiance, LENS_SIGMA_PX, LightSpot, MarkerLights, Sensor};

/// Of a light at one metre, above the wall: at 2 m it is 150, and within 1.7 m it saturates.
const PEAK_AT_1_M: f64 = 600.0;
const WALL_LEVEL: f64 = 60.0;
const SENSOR: Sensor = Sensor {
    exposure: 1.0,
    noise: 2.0,
};

/// What a level camera shows of two lights, one above the other, before a wall without a mark.
///
/// - `camera`: projects the lights, and gives the size of the picture.
/// - `middle_in_camera`: the place between the lights, m. Lights behind the camera are not shown.
/// - `seed`: of the noise; the same arguments give the same bytes.
pub fn picture_of_pair(
    camera: &CameraModel,
    lights: &MarkerLights,
    middle_in_camera: &Vector3<f64>,
    seed: u64,
) -> Image {
    let mut picture = Irradiance::filled(camera.width(), camera.height(), WALL_LEVEL);
    let half = Vector3::y() * (0.5 * lights.length_m);
    for light in [middle_in_camera - half, middle_in_camera + half] {
        let Some(pixel) = camera.project(&light) else {
            continue;
        };
        picture.add_spot(&LightSpot {
            center_px: [pixel.x, pixel.y],
            sigma_px: LENS_SIGMA_PX,
            peak: PEAK_AT_1_M / light.norm_squared(),
            streak_px: [0.0, 0.0],
        });
    }
    picture.expose(&SENSOR, &mut ChaCha8Rng::seed_from_u64(seed))
}

#[cfg(test)]
mod tests {
    use camera::{Distortion, Intrinsics};

    use super::*;

    /// Goal: lights are where a pinhole shows them. Method: 0.1 m apart, 2 m ahead and 0.5 m to
    /// the left of 180 px of focal length they are 9 px apart and 45 px left of the middle; their
    /// 144 levels stick out of the wall's 60 by many deviations of the noise.
    #[test]
    fn a_pair_is_where_a_pinhole_shows_it() {
        let intrinsics = Intrinsics {
            fx: 180.0,
            fy: 180.0,
            cx: 160.0,
            cy: 120.5,
        };
        let camera = CameraModel::new(320, 240, intrinsics, Distortion::None).unwrap();
        let lights = MarkerLights { length_m: 0.1 };
        let pair = |x: f64, z: f64| picture_of_pair(&camera, &lights, &Vector3::new(x, 0.0, z), 7);
        let image = pair(-0.5, 2.0);
        let bright = (0..240).flat_map(|y| (0..320).map(move |x| (x, y)));
        let peaks: Vec<_> = bright.filter(|(x, y)| image.get(*x, *y) > 180).collect();
        assert_eq!(peaks, [(115, 116), (115, 125)]);
        let behind = pair(-0.5, -2.0);
        assert!(behind.pixels().iter().all(|pixel| *pixel < 80));
    }
}

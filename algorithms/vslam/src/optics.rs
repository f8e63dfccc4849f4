//! The camera with all that depends only on it: bounds, noise, sizes in pixels.

use camera::{CameraModel, Distortion};
use nalgebra::{Vector2, Vector3};

/// Pyramid levels of an image that is not enlarged. Others have more, as coarse at the end: blur
/// leaves corners only there.
const LEVEL_COUNT: usize = 8;
/// Size ratio of neighbouring levels.
pub(crate) const LEVEL_FACTOR: f64 = 1.2;
/// Images with fewer pixels are enlarged to so many, about 432×324, before corners are sought:
/// descriptors reach 15 pixels beyond their corners, and at 160×120 what lies nearer to the border
/// is 40 % of the image, more on each coarser level. It also finds what is finer than the corner
/// test's ring, and places it more finely. Larger images have enough of both.
const AREA_PX: f64 = 140_000.0;
/// Image pixels per enlarged pixel, at least. Beyond twofold an image has nothing more to show.
const FINEST_SCALE_MIN: f64 = 0.5;
/// The width for which windows in pixels are stated; they grow with the image.
const REFERENCE_WIDTH_PX: f64 = 640.0;
/// Rays further from the axis than this many focal lengths are not used (74°).
const PLANE_RADIUS_MAX: f64 = 3.5;

/// A camera, the part of the ideal plane that it sees, and the noise of its keypoints.
#[derive(Clone, Debug)]
pub(crate) struct Optics {
    pub(crate) camera: CameraModel,
    /// Image pixels per pixel of the finest pyramid level: below 1, small images are enlarged.
    pub(crate) finest_scale: f64,
    pub(crate) level_count: usize,
    /// In pixels of the finest level, as are all windows and noises.
    focal_px: f64,
    /// One pixel of the reference width, on the ideal plane of this camera.
    pub(crate) window: f64,
    pub(crate) plane_min: Vector2<f64>,
    pub(crate) plane_max: Vector2<f64>,
    keypoint_sigma_px: f64,
}

impl Optics {
    pub(crate) fn new(camera: CameraModel, keypoint_sigma_px: f64) -> Self {
        let finest_scale = finest_scale(&camera);
        let focal_px = camera.focal_length_px() / finest_scale;
        let (plane_min, plane_max) = plane_bounds(&camera);
        let width_px = camera.width().max(camera.height()) as f64 / finest_scale;
        let size_factor = width_px / REFERENCE_WIDTH_PX;
        Self {
            finest_scale,
            level_count: LEVEL_COUNT + added_level_count(finest_scale),
            focal_px,
            window: size_factor.max(1.0) / focal_px,
            plane_min,
            plane_max,
            keypoint_sigma_px,
            camera,
        }
    }

    /// One standard deviation of a keypoint on the finest level, at the centre of the ideal plane.
    pub(crate) fn keypoint_sigma(&self) -> f64 {
        self.keypoint_sigma_px / self.focal_px
    }

    /// The ideal position and its standard deviation; `None` where the lens has no ray.
    pub(crate) fn undistort(&self, pixel: &Vector2<f64>, level: u8) -> Option<(Vector2<f64>, f64)> {
        let position = self.camera.undistort(pixel)?;
        if position.norm_squared() > PLANE_RADIUS_MAX * PLANE_RADIUS_MAX {
            return None;
        }
        let plane_sigma = self.keypoint_sigma_px * level_scale(level) / self.focal_px;
        let distortion = self.camera.distortion();
        if let Distortion::None = distortion {
            return Some((position, plane_sigma));
        }
        let (_, d_distorted_d_ideal) = distortion.distort_with_derivative(&position);
        let shrink = d_distorted_d_ideal.determinant().abs().sqrt();
        Some((position, plane_sigma / shrink.max(0.05)))
    }

    /// Where the camera shows a point on the ideal plane; `None` if it does not.
    pub(crate) fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point_in_camera.z.is_nan() || point_in_camera.z <= 1e-6 {
            return None;
        }
        let position = point_in_camera.xy() / point_in_camera.z;
        if !self.in_bounds(&position) {
            return None;
        }
        if let Distortion::None = self.camera.distortion() {
            return Some(position);
        }
        let pixel = self.camera.project(point_in_camera)?;
        self.camera.contains(&pixel, 0.0).then_some(position)
    }

    fn in_bounds(&self, position: &Vector2<f64>) -> bool {
        position.x >= self.plane_min.x
            && position.x <= self.plane_max.x
            && position.y >= self.plane_min.y
            && position.y <= self.plane_max.y
    }
}

fn finest_scale(camera: &CameraModel) -> f64 {
    let area_px = (camera.width() * camera.height()) as f64;
    (area_px / AREA_PX).sqrt().clamp(FINEST_SCALE_MIN, 1.0)
}

fn added_level_count(finest_scale: f64) -> usize {
    (-finest_scale.ln() / LEVEL_FACTOR.ln()).round() as usize
}

/// Pixels of the finest level per pixel of this one.
pub(crate) fn level_scale(level: u8) -> f64 {
    LEVEL_FACTOR.powi(i32::from(level))
}

/// The smallest upright rectangle of the ideal plane that holds the image's border.
fn plane_bounds(camera: &CameraModel) -> (Vector2<f64>, Vector2<f64>) {
    let (right, bottom) = (camera.width() as f64 - 1.0, camera.height() as f64 - 1.0);
    let mut lowest = Vector2::repeat(-1e-3);
    let mut highest = Vector2::repeat(1e-3);
    let steps = 32;
    for step in 0..=steps {
        let share = f64::from(step) / f64::from(steps);
        let border = [
            Vector2::new(right * share, 0.0),
            Vector2::new(right * share, bottom),
            Vector2::new(0.0, bottom * share),
            Vector2::new(right, bottom * share),
        ];
        for position in border.iter().filter_map(|pixel| camera.undistort(pixel)) {
            let norm = position.norm();
            let inside = position * (PLANE_RADIUS_MAX / norm.max(PLANE_RADIUS_MAX));
            lowest = lowest.inf(&inside);
            highest = highest.sup(&inside);
        }
    }
    (lowest, highest)
}

#[cfg(test)]
mod tests {
    use camera::{Distortion, Intrinsics};

    use super::*;

    /// From 160×120 to 1920×1080: small images are enlarged so that the pyramid begins with about
    /// as many pixels, and whatever is added at its fine end, it ends where others do.
    #[test]
    fn small_images_begin_finer_and_end_as_coarse() {
        let optics = |width: usize, height: usize| {
            let focal_px = 0.8 * width as f64;
            let intrinsics = Intrinsics {
                fx: focal_px,
                fy: focal_px,
                cx: 0.5 * width as f64,
                cy: 0.5 * height as f64,
            };
            let camera = CameraModel::new(width, height, intrinsics, Distortion::None).unwrap();
            (Optics::new(camera, 0.9), focal_px)
        };
        for (width, height, finest_scale) in [
            (160, 120, 0.5),
            (240, 180, 0.555),
            (324, 244, 0.751),
            (640, 480, 1.0),
            (1920, 1080, 1.0),
        ] {
            let (optics, focal_px) = optics(width, height);
            let error = optics.finest_scale - finest_scale;
            assert!(error.abs() < 1e-3, "{width}x{height}: {error}");
            let coarsest = optics.finest_scale * level_scale(optics.level_count as u8 - 1);
            let levels_off = (coarsest / level_scale(7)).ln() / LEVEL_FACTOR.ln();
            assert!(levels_off.abs() <= 0.5, "{width}x{height}: {levels_off}");
            // What one pixel of the finest level subtends is what its noise scales with.
            let (_, sigma) = optics.undistort(&Vector2::zeros(), 0).unwrap();
            let sigma_px = sigma * focal_px / optics.finest_scale;
            assert!(
                (sigma_px - 0.9).abs() < 1e-9,
                "{width}x{height}: {sigma_px}"
            );
        }
    }

    /// Whatever the lens, a keypoint's place on the ideal plane is as uncertain as the step there
    /// that moves its image by the keypoint's noise, and it is projected back to where it was.
    #[test]
    fn every_lens_has_its_noise_on_the_ideal_plane() {
        let intrinsics = Intrinsics {
            fx: 300.0,
            fy: 300.0,
            cx: 320.0,
            cy: 240.0,
        };
        let sphere = |xi, alpha| Distortion::DoubleSphere { xi, alpha };
        for distortion in [
            Distortion::None,
            Distortion::FieldOfView { omega_rad: 0.9 },
            sphere(-0.3, 0.6),
            sphere(0.8, 0.2),
            Distortion::Rational {
                radial: [0.3, -0.1, 0.02, 0.2, 0.05, 0.01],
                p1: 1e-3,
                p2: -1e-3,
            },
        ] {
            let camera = CameraModel::new(640, 480, intrinsics, distortion).unwrap();
            let optics = Optics::new(camera.clone(), 0.7);
            for pixel in [Vector2::new(320.0, 240.0), Vector2::new(500.0, 90.0)] {
                let (position, sigma) = optics.undistort(&pixel, 0).unwrap();
                let step_px = |axis: Vector2<f64>| {
                    let step = 1e-5;
                    let moved = camera.project(&(position + axis * step).push(1.0)).unwrap();
                    (moved - pixel) / step
                };
                let (right, down) = (step_px(Vector2::x()), step_px(Vector2::y()));
                let pixels_per_unit = right.perp(&down).abs().sqrt();
                let error = sigma * pixels_per_unit / 0.7 - 1.0;
                assert!(error.abs() < 1e-3, "{distortion:?} {pixel}: {error}");
                let again = optics.project(&(position * 4.0).push(4.0)).unwrap();
                assert!((again - position).norm() < 1e-9, "{distortion:?}");
            }
        }
    }
}

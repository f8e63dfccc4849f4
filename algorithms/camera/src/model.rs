//! A calibrated camera.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use crate::Distortion;

/// Focal lengths and principal point, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
}

/// A camera that can be used: its numbers were checked when it was made.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraModel {
    width: usize,
    height: usize,
    intrinsics: Intrinsics,
    distortion: Distortion,
    radius_limit_squared: f64,
}

/// Why numbers do not describe a camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ImplausibleCamera {
    #[error("image size {width}×{height} is outside 16×16 … 16384×16384")]
    ImageSize { width: usize, height: usize },
    #[error("{name} = {value} is not a finite number")]
    NotFinite { name: &'static str, value: f64 },
    #[error("{name} = {value} px for an image {width} px wide: expected 0.1 to 20 widths")]
    FocalLength {
        name: &'static str,
        value: f64,
        width: usize,
    },
    #[error("principal point ({cx}, {cy}) lies outside the image of {width}×{height}")]
    PrincipalPoint {
        cx: f64,
        cy: f64,
        width: usize,
        height: usize,
    },
    #[error("the distortion folds back inside the image: pixel ({x:.0}, {y:.0}) has no ray")]
    FoldedDistortion { x: f64, y: f64 },
}

impl CameraModel {
    /// A camera with these numbers, or what is wrong with them.
    pub fn new(
        width: usize,
        height: usize,
        intrinsics: Intrinsics,
        distortion: Distortion,
    ) -> Result<Self, ImplausibleCamera> {
        if !(16..=16384).contains(&width) || !(16..=16384).contains(&height) {
            return Err(ImplausibleCamera::ImageSize { width, height });
        }
        check_intrinsics(&intrinsics, width, height)?;
        check_finite(&distortion)?;
        let radius_limit = distortion.radius_limit();
        let radius_limit_squared = radius_limit * radius_limit;
        let camera = Self {
            width,
            height,
            intrinsics,
            distortion,
            radius_limit_squared,
        };
        // Corners may lie beyond the fold, as with many wide lenses; the middle of a border not.
        let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
        let (middle, centre) = (0.5 * right, 0.5 * bottom);
        for (x, y) in [
            (0.0, centre),
            (right, centre),
            (middle, 0.0),
            (middle, bottom),
        ] {
            if camera.unproject(&Vector2::new(x, y)).is_none() {
                return Err(ImplausibleCamera::FoldedDistortion { x, y });
            }
        }
        Ok(camera)
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// The mean of both focal lengths, pixels.
    pub fn focal_length_px(&self) -> f64 {
        0.5 * (self.intrinsics.fx + self.intrinsics.fy)
    }

    /// Whether a pixel lies inside the image, `margin_px` away from its border.
    pub fn contains(&self, pixel: &Vector2<f64>, margin_px: f64) -> bool {
        pixel.x >= margin_px
            && pixel.y >= margin_px
            && pixel.x <= self.width as f64 - 1.0 - margin_px
            && pixel.y <= self.height as f64 - 1.0 - margin_px
    }

    /// The pixel of a point in the camera frame; `None` behind the camera or where the model does
    /// not hold. The pixel may lie outside the image.
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        let ideal = self.ideal(point_in_camera)?;
        Some(self.pixel_from_plane(&self.distortion.distort(&ideal)))
    }

    /// [`CameraModel::project`] with `d_pixel_d_point`.
    pub fn project_with_derivative(
        &self,
        point_in_camera: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let ideal = self.ideal(point_in_camera)?;
        let (distorted, d_distorted_d_ideal) = self.distortion.distort_with_derivative(&ideal);
        let inverse_depth = 1.0 / point_in_camera.z;
        let d_ideal_d_point = Matrix2x3::new(
            inverse_depth,
            0.0,
            -ideal.x * inverse_depth,
            0.0,
            inverse_depth,
            -ideal.y * inverse_depth,
        );
        let focal = Matrix2::new(self.intrinsics.fx, 0.0, 0.0, self.intrinsics.fy);
        let pixel = self.pixel_from_plane(&distorted);
        Some((pixel, focal * d_distorted_d_ideal * d_ideal_d_point))
    }

    /// The unit ray of a pixel in the camera frame; `None` where the model does not hold.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let plane = self.plane_from_pixel(pixel);
        if let Distortion::Equidistant { .. } = self.distortion {
            let radius = plane.norm();
            let angle = self.distortion.straight_angle(radius)?;
            let outward = if radius < 1e-12 {
                Vector2::zeros()
            } else {
                plane / radius
            };
            let sine = angle.sin();
            return Some(Vector3::new(
                outward.x * sine,
                outward.y * sine,
                angle.cos(),
            ));
        }
        Some(self.undistort(pixel)?.push(1.0).normalize())
    }

    /// The ideal position `(x/z, y/z)` of a pixel; `None` where the model does not hold or the
    /// ray does not point forward.
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let ideal = self.distortion.undistort(&self.plane_from_pixel(pixel))?;
        (ideal.norm_squared() <= self.radius_limit_squared).then_some(ideal)
    }

    fn ideal(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point_in_camera.z.is_nan() || point_in_camera.z <= 1e-9 {
            return None;
        }
        let ideal = point_in_camera.xy() / point_in_camera.z;
        (ideal.norm_squared() <= self.radius_limit_squared).then_some(ideal)
    }

    fn pixel_from_plane(&self, plane: &Vector2<f64>) -> Vector2<f64> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Vector2::new(fx * plane.x + cx, fy * plane.y + cy)
    }

    fn plane_from_pixel(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Vector2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy)
    }
}

fn check_intrinsics(
    intrinsics: &Intrinsics,
    width: usize,
    height: usize,
) -> Result<(), ImplausibleCamera> {
    let Intrinsics { fx, fy, cx, cy } = *intrinsics;
    for (name, value) in [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)] {
        if !value.is_finite() {
            return Err(ImplausibleCamera::NotFinite { name, value });
        }
    }
    for (name, value) in [("fx", fx), ("fy", fy)] {
        let ratio = value / width as f64;
        if !(0.1..=20.0).contains(&ratio) {
            return Err(ImplausibleCamera::FocalLength { name, value, width });
        }
    }
    if !(0.0..width as f64).contains(&cx) || !(0.0..height as f64).contains(&cy) {
        return Err(ImplausibleCamera::PrincipalPoint {
            cx,
            cy,
            width,
            height,
        });
    }
    Ok(())
}

fn check_finite(distortion: &Distortion) -> Result<(), ImplausibleCamera> {
    let coefficients = match *distortion {
        Distortion::None => return Ok(()),
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => {
            vec![("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3)]
        }
        Distortion::Equidistant { k1, k2, k3, k4 } => {
            vec![("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4)]
        }
    };
    match coefficients
        .into_iter()
        .find(|(_, value)| !value.is_finite())
    {
        Some((name, value)) => Err(ImplausibleCamera::NotFinite { name, value }),
        None => Ok(()),
    }
}

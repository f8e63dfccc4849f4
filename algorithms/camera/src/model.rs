//! A calibrated camera.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use crate::Distortion;

/// Focal lengths and principal point, pixels. Focal lengths are pixels per unit of the ideal plane
/// at its centre, whatever the lens: see [`Distortion`].
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
    /// Rays further off the axis are on the other side of a fold, radians.
    angle_limit: f64,
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
    #[error("fx = {fx} and fy = {fy} differ by more than a factor of 2")]
    FocalRatio { fx: f64, fy: f64 },
    #[error("the image is only {fov_deg:.2}° wide: expected at least {FOV_MIN_DEG}°")]
    NarrowView { fov_deg: f64 },
    #[error(
        "principal point ({cx}, {cy}) is far off the centre of an image of {width}×{height}: \
         expected at least a tenth of each side from the border"
    )]
    PrincipalPoint {
        cx: f64,
        cy: f64,
        width: usize,
        height: usize,
    },
    #[error("{name} = {value}: expected {expected}")]
    Coefficient {
        name: &'static str,
        value: f64,
        expected: &'static str,
    },
    #[error("the distortion folds back inside the image: pixel ({x:.0}, {y:.0}) has no ray")]
    FoldedDistortion { x: f64, y: f64 },
}

/// Narrower views are taken for calibrations of something else.
const FOV_MIN_DEG: f64 = 5.0;
/// How near to the border the principal point may be, of a side.
const PRINCIPAL_MARGIN: f64 = 0.1;

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
        check_distortion(&distortion)?;
        let radius_limit = distortion.radius_limit();
        let radius_limit_squared = radius_limit * radius_limit;
        let angle_limit = if radius_limit.is_finite() {
            radius_limit.atan()
        } else {
            std::f64::consts::PI
        };
        let camera = Self {
            width,
            height,
            intrinsics,
            distortion,
            radius_limit_squared,
            angle_limit,
        };
        // Corners may lie beyond the fold, as with many wide lenses; the middle of a border not.
        let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
        let (middle, centre) = (0.5 * right, 0.5 * bottom);
        let ray = |x, y| {
            let ray = camera.unproject(&Vector2::new(x, y));
            ray.ok_or(ImplausibleCamera::FoldedDistortion { x, y })
        };
        let (leftmost, rightmost) = (ray(0.0, centre)?, ray(right, centre)?);
        ray(middle, 0.0)?;
        ray(middle, bottom)?;
        let fov_deg = leftmost.angle(&rightmost).to_degrees();
        if fov_deg < FOV_MIN_DEG {
            return Err(ImplausibleCamera::NarrowView { fov_deg });
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
        if self.distortion.sees_behind() {
            let radius = plane.norm();
            let angle = self.distortion.straight_angle(radius)?;
            if angle > self.angle_limit {
                return None;
            }
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
    if !(0.5..=2.0).contains(&(fx / fy)) {
        return Err(ImplausibleCamera::FocalRatio { fx, fy });
    }
    let is_inside = |value: f64, side: usize| {
        let share = value / side as f64;
        (PRINCIPAL_MARGIN..=1.0 - PRINCIPAL_MARGIN).contains(&share)
    };
    if !is_inside(cx, width) || !is_inside(cy, height) {
        return Err(ImplausibleCamera::PrincipalPoint {
            cx,
            cy,
            width,
            height,
        });
    }
    Ok(())
}

fn check_distortion(distortion: &Distortion) -> Result<(), ImplausibleCamera> {
    let coefficients = match *distortion {
        Distortion::None => return Ok(()),
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => {
            vec![("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3)]
        }
        Distortion::Rational { radial, p1, p2 } => {
            let names = ["k1", "k2", "k3", "k4", "k5", "k6"];
            let radial = names.into_iter().zip(radial);
            radial.chain([("p1", p1), ("p2", p2)]).collect()
        }
        Distortion::Equidistant { k1, k2, k3, k4 } => {
            vec![("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4)]
        }
        Distortion::FieldOfView { omega_rad } => vec![("omega", omega_rad)],
        Distortion::DoubleSphere { xi, alpha } => vec![("xi", xi), ("alpha", alpha)],
    };
    let mut named = coefficients.into_iter();
    if let Some((name, value)) = named.find(|(_, value)| !value.is_finite()) {
        return Err(ImplausibleCamera::NotFinite { name, value });
    }
    let (name, value, expected) = match *distortion {
        Distortion::FieldOfView { omega_rad } if !(1e-3..=3.1).contains(&omega_rad) => {
            ("omega", omega_rad, "0.001 to 3.1 rad")
        }
        Distortion::DoubleSphere { xi, .. } if !(-0.99..=10.0).contains(&xi) => {
            ("xi", xi, "-0.99 to 10")
        }
        Distortion::DoubleSphere { alpha, .. } if !(0.0..=1.0).contains(&alpha) => {
            ("alpha", alpha, "0 to 1")
        }
        _ => return Ok(()),
    };
    Err(ImplausibleCamera::Coefficient {
        name,
        value,
        expected,
    })
}

//! A point from the directions in which cameras of known pose see it.

use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix3, RowVector3, Vector2, Vector3};

/// What one camera of known pose sees of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Maps points of the map into the camera.
    pub camera_from_map: Transform<Camera, Map>,
    /// Where the point is seen, on the ideal plane `(x/z, y/z)`.
    pub position: Vector2<f64>,
    /// Standard deviation of each coordinate of `position`, in the same unit.
    pub sigma: f64,
}

/// What a point must satisfy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangulationSettings {
    /// Widest angle between two of its rays at least (rad). Smaller admits points whose depth is
    /// a guess, larger leaves a slowly moving camera without new points.
    pub parallax_rad_min: f64,
    /// A squared, whitened residual above this in any view refuses the point.
    pub chi_squared_max: f64,
}

impl Default for TriangulationSettings {
    fn default() -> Self {
        Self {
            parallax_rad_min: 0.5_f64.to_radians(),
            chi_squared_max: 5.991,
        }
    }
}

/// A point, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// The most likely position.
    pub point_in_map: Vector3<f64>,
    /// Its covariance, the cameras' poses taken as exact.
    pub covariance_in_map: Matrix3<f64>,
    /// The widest angle between two of its rays (rad).
    pub parallax_rad: f64,
}

/// Why there is no point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TriangulationRefusal {
    /// Fewer than two views.
    TooFewViews,
    /// The rays are parallel, or a number is not finite.
    Degenerate,
    /// The rays meet behind a camera.
    BehindCamera,
    /// The rays are too close to parallel to say how far the point is.
    LowParallax {
        /// The widest angle between two rays (rad).
        parallax_rad: f64,
    },
    /// No point is near all the rays.
    Inaccurate {
        /// The worst squared, whitened residual.
        chi_squared: f64,
    },
}

/// The most likely point behind its sightings.
///
/// A linear start, then Gauss–Newton on the reprojection error. Allocates nothing.
/// Cost: a few microseconds for two views; the parallax is quadratic in the number of views.
pub fn triangulate(
    sightings: &[Sighting],
    settings: &TriangulationSettings,
) -> Result<Triangulated, TriangulationRefusal> {
    if sightings.len() < 2 {
        return Err(TriangulationRefusal::TooFewViews);
    }
    let mut point = linear_start(sightings).ok_or(TriangulationRefusal::Degenerate)?;
    let parallax_rad = parallax_rad(sightings, &point);
    if parallax_rad < settings.parallax_rad_min {
        return Err(TriangulationRefusal::LowParallax { parallax_rad });
    }
    for _ in 0..ITERATION_COUNT_MAX {
        let normal = accumulate(sightings, &point).ok_or(TriangulationRefusal::BehindCamera)?;
        let factor = normal
            .hessian
            .cholesky()
            .ok_or(TriangulationRefusal::Degenerate)?;
        let step = factor.solve(&-normal.gradient);
        point += step;
        // The expected gain in cost, of which one is a standard deviation.
        if -step.dot(&normal.gradient) < 1e-6 {
            break;
        }
    }
    let normal = accumulate(sightings, &point).ok_or(TriangulationRefusal::BehindCamera)?;
    if normal.worst > settings.chi_squared_max {
        return Err(TriangulationRefusal::Inaccurate {
            chi_squared: normal.worst,
        });
    }
    let parallax_rad = self::parallax_rad(sightings, &point);
    if parallax_rad < settings.parallax_rad_min {
        return Err(TriangulationRefusal::LowParallax { parallax_rad });
    }
    let factor = normal
        .hessian
        .cholesky()
        .ok_or(TriangulationRefusal::Degenerate)?;
    Ok(Triangulated {
        point_in_map: point,
        covariance_in_map: factor.inverse(),
        parallax_rad,
    })
}

/// The widest angle between two lines from the point to the cameras (rad).
pub fn parallax_rad(sightings: &[Sighting], point_in_map: &Vector3<f64>) -> f64 {
    let ray = |sighting: &Sighting| point_in_map - camera_in_map(sighting);
    let mut widest: f64 = 0.0;
    for (idx, first) in sightings.iter().enumerate() {
        let first_ray = ray(first);
        for second in &sightings[..idx] {
            let second_ray = ray(second);
            let sine = first_ray.cross(&second_ray).norm();
            widest = widest.max(sine.atan2(first_ray.dot(&second_ray)));
        }
    }
    widest
}

/// Two views converge in two or three steps unless the parallax is tiny.
const ITERATION_COUNT_MAX: usize = 6;

fn camera_in_map(sighting: &Sighting) -> Vector3<f64> {
    *sighting.camera_from_map.inverse().translation()
}

/// `(x − u z) = 0` and `(y − v z) = 0` in every camera, in the least-squares sense; a second
/// pass divides by the depths of the first, which makes the residuals those of the ideal plane.
fn linear_start(sightings: &[Sighting]) -> Option<Vector3<f64>> {
    let first = solve_linear(sightings, |_| 1.0)?;
    let second = solve_linear(sightings, |sighting| {
        let depth = (sighting.camera_from_map * first).z.abs();
        1.0 / (depth * depth).max(1e-12)
    })?;
    second.iter().all(|c| c.is_finite()).then_some(second)
}

fn solve_linear(sightings: &[Sighting], weight: impl Fn(&Sighting) -> f64) -> Option<Vector3<f64>> {
    let mut hessian = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for sighting in sightings {
        let rotation = sighting.camera_from_map.rotation_matrix();
        let translation = sighting.camera_from_map.translation();
        let weight = weight(sighting) / (sighting.sigma * sighting.sigma);
        for axis in 0..2 {
            let coordinate = sighting.position[axis];
            let row = rotation.row(axis) - rotation.row(2) * coordinate;
            let offset = translation[axis] - translation.z * coordinate;
            hessian += row.transpose() * row * weight;
            right -= row.transpose() * (offset * weight);
        }
    }
    Some(hessian.cholesky()?.solve(&right))
}

pub(crate) struct NormalEquations {
    pub(crate) hessian: Matrix3<f64>,
    pub(crate) gradient: Vector3<f64>,
    /// The worst squared, whitened residual of a view.
    pub(crate) worst: f64,
}

/// `None` if the point is not in front of every camera.
pub(crate) fn accumulate(
    sightings: &[Sighting],
    point_in_map: &Vector3<f64>,
) -> Option<NormalEquations> {
    let mut normal = NormalEquations {
        hessian: Matrix3::zeros(),
        gradient: Vector3::zeros(),
        worst: 0.0,
    };
    for sighting in sightings {
        let point_in_camera = sighting.camera_from_map * *point_in_map;
        if point_in_camera.z.is_nan() || point_in_camera.z <= 0.0 {
            return None;
        }
        let rotation = sighting.camera_from_map.rotation_matrix();
        let inverse_depth = 1.0 / point_in_camera.z;
        let predicted = point_in_camera.xy() * inverse_depth;
        let inverse_sigma = 1.0 / sighting.sigma;
        let residual = (predicted - sighting.position) * inverse_sigma;
        normal.worst = normal.worst.max(residual.norm_squared());
        let rows = d_position_d_point(&rotation, &predicted, inverse_depth);
        for (row, residual) in rows.iter().zip(residual.iter()) {
            let row = row * inverse_sigma;
            normal.gradient += row.transpose() * *residual;
            normal.hessian += row.transpose() * row;
        }
    }
    Some(normal)
}

/// The rows of the derivative of `position`, which is `(x/z, y/z)`, by the point in the map.
pub(crate) fn d_position_d_point(
    camera_from_map_rotation: &Matrix3<f64>,
    position: &Vector2<f64>,
    inverse_depth: f64,
) -> [RowVector3<f64>; 2] {
    let depth_row = camera_from_map_rotation.row(2);
    [0, 1].map(|axis| {
        (camera_from_map_rotation.row(axis) - depth_row * position[axis]) * inverse_depth
    })
}

#[cfg(test)]
mod tests;

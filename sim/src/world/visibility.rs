//! What lies between two points, and how near the next surface is.

use nalgebra::Vector3;
use parry3d::math::Vector;
use parry3d::query::{PointQuery, Ray, RayCast};
use parry3d::shape::Triangle;

use super::World;

/// The surfaces of a world, as triangles for rays and distances.
///
/// Every query looks at every triangle, a few microseconds for a lab: enough for checks of
/// routes and views, and not meant for pictures.
pub struct Surroundings {
    triangles: Vec<Triangle>,
}

/// Surfaces nearer to a ray's end than this do not block it.
const TOUCHING_M: f64 = 0.01;
/// Longer than any room.
const DISTANCE_MAX_M: f32 = 100.0;

impl Surroundings {
    pub fn new(world: &World) -> Self {
        let triangles = world
            .panels
            .iter()
            .flat_map(|panel| {
                let [a, b, c, d] = panel.corners().map(|corner| single_precision(&corner));
                [Triangle::new(a, b, c), Triangle::new(a, c, d)]
            })
            .collect();
        Self { triangles }
    }

    /// The distance from `origin` along a unit `direction` to the first surface.
    pub fn ray_length_m(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let ray = Ray::new(single_precision(origin), single_precision(direction));
        self.triangles
            .iter()
            .filter_map(|triangle| triangle.cast_local_ray(&ray, DISTANCE_MAX_M, false))
            .min_by(f32::total_cmp)
            .map(f64::from)
    }

    /// Whether nothing stands between two points.
    pub fn sees(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let path = to - from;
        let length = path.norm();
        length < TOUCHING_M
            || self
                .ray_length_m(from, &(path / length))
                .is_none_or(|free_m| free_m > length - TOUCHING_M)
    }

    /// The distance to the nearest surface in any direction.
    pub fn clearance_m(&self, point: &Vector3<f64>) -> f64 {
        let point = single_precision(point);
        self.triangles
            .iter()
            .map(|triangle| triangle.distance_to_local_point(point, false))
            .fold(f64::from(DISTANCE_MAX_M), |least, distance_m| {
                least.min(f64::from(distance_m))
            })
    }
}

fn single_precision(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

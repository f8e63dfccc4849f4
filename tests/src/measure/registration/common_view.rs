//! How much two maps have in common, and from how different sides they show it.

use camera::CameraModel;
use geometry::{Camera, Enu, Transform};
use nalgebra::Vector3;
use sim::Surroundings;

use super::vehicle_map::MapTruth;

/// What two vehicles see in common, in truth.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CommonView {
    /// The share of one map's points that the other vehicle has seen, the larger of the two.
    pub overlap: f64,
    /// Between the mean directions in which the two see a common point, the median.
    pub angle_deg: f64,
}

/// Points of each map that are looked for.
const POINT_COUNT: usize = 200;
/// Keyframes of the other vehicle that may have seen them.
const CAMERA_COUNT: usize = 4;

impl CommonView {
    pub fn between(first: &MapTruth, second: &MapTruth, surroundings: &Surroundings) -> Self {
        let (there, mut angles) = seen_by(first, second, surroundings);
        let (back, more) = seen_by(second, first, surroundings);
        angles.extend(more);
        angles.sort_by(f64::total_cmp);
        Self {
            // The smaller map is the one of which the larger part is common.
            overlap: there.max(back),
            angle_deg: angles.get(angles.len() / 2).copied().unwrap_or(180.0),
        }
    }
}

/// Which share of a map's points another vehicle has seen, and the angles between their views.
fn seen_by(own: &MapTruth, other: &MapTruth, surroundings: &Surroundings) -> (f64, Vec<f64>) {
    let step = own.points_in_site.len().div_ceil(POINT_COUNT).max(1);
    let points: Vec<_> = own.points_in_site.iter().step_by(step).collect();
    let mut angles = Vec::new();
    for point in &points {
        let Some(theirs) = mean_direction(point, other, Some(surroundings)) else {
            continue;
        };
        if let Some(ours) = mean_direction(point, own, None) {
            angles.push(ours.angle(&theirs).to_degrees());
        }
    }
    (angles.len() as f64 / points.len().max(1) as f64, angles)
}

/// Of the rays from the cameras in whose image a point is; `None` if there is none, or if
/// something stands before it.
fn mean_direction(
    point: &Vector3<f64>,
    map: &MapTruth,
    surroundings: Option<&Surroundings>,
) -> Option<Vector3<f64>> {
    let cameras = map.site_from_cameras.iter();
    let step = map.site_from_cameras.len().div_ceil(CAMERA_COUNT).max(1);
    let mut sum = Vector3::zeros();
    for camera in cameras.step_by(step) {
        let is_free = surroundings.is_none_or(|it| it.sees(camera.translation(), point));
        if is_in_image(point, camera, &map.camera) && is_free {
            sum += (point - camera.translation()).normalize();
        }
    }
    sum.try_normalize(1e-9)
}

fn is_in_image(
    point: &Vector3<f64>,
    site_from_camera: &Transform<Enu, Camera>,
    camera: &CameraModel,
) -> bool {
    let pixel = camera.project(&(site_from_camera.inverse() * *point));
    pixel.is_some_and(|pixel| camera.contains(&pixel, 0.0))
}

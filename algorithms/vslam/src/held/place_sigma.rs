//! How uncertain a place is, the points that tell it included.

use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Matrix6, Vector3, Vector6};

use super::d_position_d_pose;
use crate::triangulation::d_position_d_point;
use crate::{MapPoint, Observation, VslamMap};

/// One standard deviation of where the camera is, in the unit of the map, from the points of known
/// range that it shows; `None` if they do not tell.
///
/// Points are not exact. What is wrong with each alone averages out over many; but points that
/// keyframes close together saw are all too near or all too far, and then a camera that sees them
/// from elsewhere is moved by all of them in one sense: that counts as well, and not at all for a
/// camera where the keyframes were. Keyframes' poses are taken as exact.
pub(crate) fn place_sigma(
    map: &VslamMap,
    camera_from_map: &Transform<Camera, Map>,
    observations: &[Observation],
) -> Option<f64> {
    let rotation = camera_from_map.rotation_matrix();
    let centre = *camera_from_map.inverse().translation();
    let mut information = Matrix6::zeros();
    let mut pull = Vector6::zeros();
    for observation in observations {
        let point = observation.point.and_then(|point| map.point(point));
        let Some(point) = point.filter(|point| point.has_range()) else {
            continue;
        };
        let in_camera = rotation * point.position_in_map + camera_from_map.translation();
        if in_camera.z <= 0.0 {
            continue;
        }
        let inverse_depth = 1.0 / in_camera.z;
        let position = in_camera.xy() * inverse_depth;
        let by_pose = Matrix2x6::from_rows(&d_position_d_pose(&position, inverse_depth));
        let by_point =
            Matrix2x3::from_rows(&d_position_d_point(&rotation, &position, inverse_depth));
        let noise = Matrix2::identity() * (observation.sigma * observation.sigma);
        let covariance = by_point * point.covariance_in_map * by_point.transpose() + noise;
        let Some(weight) = covariance.try_inverse() else {
            continue;
        };
        let weighted = by_pose.transpose() * weight;
        information += weighted * by_pose;
        pull += weighted * (by_point * range_error(map, point, &centre));
    }
    let covariance = information.cholesky()?;
    let pulled = covariance.solve(&pull).fixed_rows::<3>(3).norm();
    let of_place: Matrix3<f64> = covariance.inverse().fixed_view::<3, 3>(3, 3).into_owned();
    let sigma = of_place.symmetric_eigenvalues().max().sqrt().hypot(pulled);
    sigma.is_finite().then_some(sigma)
}

/// One standard deviation of a point along its ray from the nearest keyframe that sees it.
fn range_error(map: &VslamMap, point: &MapPoint, centre: &Vector3<f64>) -> Vector3<f64> {
    let seeing = point
        .views
        .iter()
        .filter_map(|one| map.keyframe(one.keyframe));
    let rays = seeing.map(|keyframe| {
        let eye = keyframe.centre_in_map();
        ((eye - centre).norm_squared(), point.position_in_map - eye)
    });
    let nearest = rays.min_by(|a, b| a.0.total_cmp(&b.0));
    let ray = nearest.and_then(|(_, ray)| ray.try_normalize(f64::MIN_POSITIVE));
    let Some(ray) = ray else {
        return Vector3::zeros();
    };
    ray * (point.covariance_in_map * ray).dot(&ray).max(0.0).sqrt()
}

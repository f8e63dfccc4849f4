//! How much of an image the map holds.

mod place_sigma;

use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix3, Matrix6, RowVector6, Vector2};

pub(crate) use place_sigma::place_sigma;

use crate::optics::Optics;
use crate::{Keyframe, MapPoint, Observation, VslamMap};

/// Cells along either side of the image.
const CELLS_ALONG: usize = 8;
/// Where points of known range hold so many of the keypoints, and so much of the image, no others
/// are needed.
const HELD_KEYPOINTS_MIN: f64 = 0.2;
const HELD_CELLS_MIN: f64 = 0.7;

/// Fewer points of known range than this may agree on a place by chance.
const PLACING_POINTS_MIN: usize = 12;
/// A place is known if it is this certain, as a share of the distance of what is seen.
pub(crate) const PLACE_SIGMA_MAX: f64 = 0.01;

/// Whether points of known range tell where a keyframe is. If not, nothing that it sees has a
/// known range because of it.
pub(crate) fn is_placed(map: &VslamMap, keyframe: &Keyframe) -> bool {
    are_placing(map, &keyframe.camera_from_map, &keyframe.observations)
}

/// Whether the points of known range among these observations tell where the camera is: a few all
/// over the image do, many in one corner of it do not.
pub(crate) fn are_placing(
    map: &VslamMap,
    camera_from_map: &Transform<Camera, Map>,
    observations: &[Observation],
) -> bool {
    let rotation = camera_from_map.rotation_matrix();
    let mut information = Matrix6::zeros();
    let mut depths = Vec::new();
    for observation in observations {
        let Some(point) = observation.point.and_then(|point| map.point(point)) else {
            continue;
        };
        let in_camera = rotation * point.position_in_map + camera_from_map.translation();
        if !point.has_range() || in_camera.z <= 0.0 {
            continue;
        }
        depths.push(in_camera.z);
        let inverse_depth = 1.0 / in_camera.z;
        let position = in_camera.xy() * inverse_depth;
        let rows = d_position_d_pose(&position, inverse_depth);
        for row in rows {
            information += row.transpose() * row / (observation.sigma * observation.sigma);
        }
    }
    if depths.len() < PLACING_POINTS_MIN {
        return false;
    }
    let middle = depths.len() / 2;
    let depth = *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
    let Some(covariance) = information.cholesky().map(|factor| factor.inverse()) else {
        return false;
    };
    let of_place: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    of_place.symmetric_eigenvalues().max().sqrt() <= PLACE_SIGMA_MAX * depth
}

/// The rows of the derivative of where a point is shown, by a turn of the camera and by a step of
/// it.
fn d_position_d_pose(position: &Vector2<f64>, inverse_depth: f64) -> [RowVector6<f64>; 2] {
    let (x, y) = (position.x, position.y);
    [
        RowVector6::new(
            -x * y,
            1.0 + x * x,
            -y,
            inverse_depth,
            0.0,
            -x * inverse_depth,
        ),
        RowVector6::new(
            -1.0 - y * y,
            x * y,
            x,
            0.0,
            inverse_depth,
            -y * inverse_depth,
        ),
    ]
}

/// By how many standard deviations the points of known range miss these observations, in the
/// median; `None` if there are none. Far more than usual says that they were found by chance.
pub(crate) fn misfit(
    map: &VslamMap,
    camera_from_map: &Transform<Camera, Map>,
    observations: &[Observation],
) -> Option<f64> {
    let rotation = camera_from_map.rotation_matrix();
    let squared = observations.iter().filter_map(|observation| {
        let point = observation.point.and_then(|point| map.point(point))?;
        let in_camera = rotation * point.position_in_map + camera_from_map.translation();
        let error = in_camera.xy() / in_camera.z - observation.position;
        let squared = error.norm_squared() / (observation.sigma * observation.sigma);
        (point.has_range() && squared.is_finite()).then_some(squared)
    });
    let mut squared: Vec<f64> = squared.collect();
    let middle = squared.len() / 2;
    let median =
        (!squared.is_empty()).then(|| *squared.select_nth_unstable_by(middle, f64::total_cmp).1);
    median.map(f64::sqrt)
}

type Cells = [bool; CELLS_ALONG * CELLS_ALONG];

/// Which parts of an image show points of known range.
#[derive(Clone, Debug)]
pub(crate) struct Held {
    cells: Cells,
    /// Cells with any keypoint.
    textured: Cells,
    keypoint_count: usize,
    point_count: usize,
}

impl Held {
    pub(crate) fn by(optics: &Optics, map: &VslamMap, observations: &[Observation]) -> Self {
        let mut held = Self {
            cells: [false; CELLS_ALONG * CELLS_ALONG],
            textured: [false; CELLS_ALONG * CELLS_ALONG],
            keypoint_count: observations.len(),
            point_count: 0,
        };
        for observation in observations {
            let cell = cell(optics, observation);
            held.textured[cell] = true;
            let point = observation.point.and_then(|point| map.point(point));
            if point.is_some_and(MapPoint::has_range) {
                held.cells[cell] = true;
                held.point_count += 1;
            }
        }
        held
    }

    pub(crate) fn holds(&self, optics: &Optics, observation: &Observation) -> bool {
        self.cells[cell(optics, observation)]
    }

    /// Whether enough of the keypoints and of the image is held.
    pub(crate) fn suffices(&self) -> bool {
        self.point_count as f64 >= HELD_KEYPOINTS_MIN * self.keypoint_count as f64
            && self.share() >= HELD_CELLS_MIN
    }

    /// Cells held, of those with any keypoint.
    pub(crate) fn share(&self) -> f64 {
        let count = |cells: &Cells| cells.iter().filter(|cell| **cell).count() as f64;
        count(&self.cells) / count(&self.textured).max(1.0)
    }
}

fn cell(optics: &Optics, observation: &Observation) -> usize {
    let size = [optics.camera.width(), optics.camera.height()];
    let along = [0, 1].map(|axis| {
        let share = observation.position_px[axis] / size[axis] as f64;
        // A cast from float saturates: negative becomes 0.
        ((share * CELLS_ALONG as f64) as usize).min(CELLS_ALONG - 1)
    });
    along[1] * CELLS_ALONG + along[0]
}

#[cfg(test)]
mod tests;

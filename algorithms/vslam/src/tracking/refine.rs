//! The pose that fits a frame's matches best.

use geometry::absolute_pose::{PointObservation, RefineSettings, refine_absolute_pose};
use geometry::{Camera, Map, Transform};
use nalgebra::Matrix6;

use crate::VslamMap;
use crate::frame::{Frame, Viewpoint};

/// A pose and how well it is known.
#[derive(Clone, Debug)]
pub(crate) struct PoseFit {
    pub(crate) camera_from_map: Transform<Camera, Map>,
    pub(crate) covariance: Matrix6<f64>,
    pub(crate) inlier_count: usize,
}

/// Refines a pose by the frame's matches, and forgets the matches that do not agree with it.
pub(crate) fn refine(
    map: &VslamMap,
    start: &Transform<Camera, Map>,
    frame: &mut Frame,
    inlier_count_min: usize,
) -> Option<PoseFit> {
    let viewpoint = Viewpoint::new(*start);
    let mut indices = Vec::with_capacity(frame.observations.len());
    let mut matches = Vec::with_capacity(frame.observations.len());
    for (idx, observation) in frame.observations.iter().enumerate() {
        let Some(point) = observation.point.and_then(|point| map.point(point)) else {
            continue;
        };
        let point_in_camera = viewpoint.transform(&point.position_in_map);
        let blur_variance = point.blur_variance(&viewpoint, &point_in_camera);
        indices.push(idx);
        matches.push(PointObservation {
            point_in_world: point.position_in_map,
            position: observation.position,
            sigma: (observation.sigma * observation.sigma + blur_variance).sqrt(),
        });
    }
    let settings = RefineSettings {
        inlier_count_min,
        ..RefineSettings::default()
    };
    let fit = refine_absolute_pose(start, &matches, &settings).ok()?;
    for (idx, inlier) in indices.into_iter().zip(&fit.inliers) {
        if !inlier {
            frame.observations[idx].point = None;
        }
    }
    Some(PoseFit {
        camera_from_map: fit.camera_from_world,
        covariance: fit.world_from_camera_covariance,
        inlier_count: fit.inlier_count,
    })
}

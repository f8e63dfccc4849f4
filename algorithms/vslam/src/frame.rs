//! One image, ready for matching.

use features::Features;
use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Matrix3, Vector3};

use crate::optics::Optics;
use crate::plane_grid::PlaneGrid;
use crate::{Observation, PointId};

/// What the extractor found in one image.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Counts the frames that were tracked, from 0; set when it is.
    pub(crate) frame_idx: u64,
    pub(crate) captured_at: Timestamp,
    pub(crate) observations: Vec<Observation>,
    pub(crate) grid: PlaneGrid,
}

impl Frame {
    pub(crate) fn new(optics: &Optics, features: &Features, captured_at: Timestamp) -> Self {
        let observations: Vec<Observation> = features
            .keypoints
            .iter()
            .zip(&features.descriptors)
            .filter_map(|(keypoint, descriptor)| {
                let (position, sigma) = optics.undistort(&keypoint.position_px, keypoint.level)?;
                Some(Observation {
                    position,
                    position_px: keypoint.position_px,
                    sigma,
                    level: keypoint.level,
                    angle_rad: keypoint.angle_rad,
                    descriptor: *descriptor,
                    point: None,
                })
            })
            .collect();
        let grid = PlaneGrid::new(optics, &observations);
        Self {
            frame_idx: 0,
            captured_at,
            observations,
            grid,
        }
    }

    /// The point that each observation shows, if that is known.
    pub(crate) fn points(&self) -> Vec<Option<PointId>> {
        self.observations.iter().map(|one| one.point).collect()
    }

    /// Names the points that the observations show, as [`Self::points`] gave them.
    pub(crate) fn show(&mut self, points: &[Option<PointId>]) {
        for (observation, point) in self.observations.iter_mut().zip(points) {
            observation.point = *point;
        }
    }

    pub(crate) fn forget_points(&mut self) {
        for observation in &mut self.observations {
            observation.point = None;
        }
    }
}

/// The pose of a camera and where it is: computed once for a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Viewpoint {
    pub(crate) camera_from_map: Transform<Camera, Map>,
    pub(crate) centre_in_map: Vector3<f64>,
    rotation: Matrix3<f64>,
}

impl Viewpoint {
    pub(crate) fn new(camera_from_map: Transform<Camera, Map>) -> Self {
        Self {
            centre_in_map: *camera_from_map.inverse().translation(),
            rotation: camera_from_map.rotation_matrix(),
            camera_from_map,
        }
    }

    pub(crate) fn rotation(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    /// The point in this camera; cheaper than by the quaternion.
    pub(crate) fn transform(&self, point_in_map: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_in_map + self.camera_from_map.translation()
    }
}

//! What the anchor is told of the vehicle's own map.

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Matrix3, Unit, Vector3};
use vslam::{KeyframeId, PointId, VslamMap};

/// A frame whose pose in the map is known.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameInput {
    pub captured_at: Timestamp,
    pub map_from_camera: Transform<Map, Camera>,
    /// The direction away from the ground, where an attitude sensor knows it.
    pub up_in_camera: Option<Unit<Vector3<f64>>>,
}

/// Where a keyframe stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframePose {
    pub id: KeyframeId,
    pub captured_at: Timestamp,
    pub map_from_camera: Transform<Map, Camera>,
    /// By how much lengths around it have grown since it was made.
    pub unit: f64,
}

/// A keyframe with all the map points that it sees.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeInput {
    pub pose: KeyframePose,
    pub points: Vec<PointInput>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct PointInput {
    pub id: PointId,
    pub position_in_map: Vector3<f64>,
    pub covariance_in_map: Matrix3<f64>,
    pub descriptor: [u8; 32],
    pub view_count: usize,
    pub parallax_rad: f64,
}

impl KeyframeInput {
    /// The keyframe as the map has it; `None` if it was culled.
    pub fn from_map(map: &VslamMap, id: KeyframeId) -> Option<Self> {
        let keyframe = map.keyframe(id)?;
        let seen = keyframe.observations().iter().filter_map(|one| one.point);
        let ranged = seen.filter_map(|id| map.point(id).filter(|point| point.has_range()));
        let points = ranged.map(|point| PointInput {
            id: point.id(),
            position_in_map: *point.position_in_map(),
            covariance_in_map: *point.covariance_in_map(),
            descriptor: point.descriptor().to_bytes(),
            view_count: point.view_count(),
            parallax_rad: point.parallax_rad(),
        });
        Some(Self {
            points: points.collect(),
            pose: KeyframePose::from(keyframe),
        })
    }

    /// The median depth of the points, in the unit of the map.
    pub fn median_depth(&self) -> Option<f64> {
        let camera_from_map = self.pose.map_from_camera.inverse();
        let depths = self.points.iter();
        let mut depths: Vec<f64> = depths
            .map(|point| (camera_from_map * point.position_in_map).z)
            .collect();
        depths.sort_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied()
    }
}

impl From<&vslam::Keyframe> for KeyframePose {
    fn from(keyframe: &vslam::Keyframe) -> Self {
        Self {
            id: keyframe.id(),
            captured_at: keyframe.captured_at(),
            map_from_camera: keyframe.map_from_camera(),
            unit: keyframe.unit(),
        }
    }
}

/// Where all keyframes of the map stand now, for `Event::KeyframesMoved`.
pub fn keyframe_poses(map: &VslamMap) -> Vec<KeyframePose> {
    map.keyframes().map(KeyframePose::from).collect()
}

//! Frames that the map is made of.

use features::Descriptor;
use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Vector2, Vector3};

use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, PointId};

/// A keypoint of a frame, ready for geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// On the ideal plane: `(x/z, y/z)` of the ray, without distortion.
    pub position: Vector2<f64>,
    /// In the image as it was taken.
    pub position_px: Vector2<f64>,
    /// One standard deviation of each coordinate of `position`, in its unit.
    pub sigma: f64,
    /// Level of the pyramid on which it was found; 0 is the finest, to which small images are
    /// enlarged.
    pub level: u8,
    pub angle_rad: f32,
    pub descriptor: Descriptor,
    /// The map point that it shows, if that is known.
    pub point: Option<PointId>,
}

/// A frame whose pose and observations are part of the map.
#[derive(Clone, Debug)]
pub struct Keyframe {
    pub(crate) id: KeyframeId,
    pub(crate) frame_idx: Option<u64>,
    pub(crate) captured_at: Timestamp,
    pub(crate) camera_from_map: Transform<Camera, Map>,
    pub(crate) observations: Vec<Observation>,
    pub(crate) grid: PlaneGrid,
    /// By how much adjustments have stretched the map around it since it was made.
    pub(crate) unit: f64,
    /// The keyframe that was most covisible when this one was made; only the first has none.
    pub(crate) parent: Option<KeyframeId>,
    /// The most covisible keyframes, as of the last change near it; some may have been culled.
    pub(crate) neighbours: Vec<KeyframeId>,
}

impl Keyframe {
    pub fn id(&self) -> KeyframeId {
        self.id
    }

    /// The number of the frame, as in [`crate::FrameReport::frame_idx`]; `None` for one of an
    /// earlier session.
    pub fn frame_idx(&self) -> Option<u64> {
        self.frame_idx
    }

    pub fn captured_at(&self) -> Timestamp {
        self.captured_at
    }

    pub fn map_from_camera(&self) -> Transform<Map, Camera> {
        self.camera_from_map.inverse()
    }

    pub fn camera_from_map(&self) -> &Transform<Camera, Map> {
        &self.camera_from_map
    }

    /// By how much lengths around it have grown since it was made, as by a loop closure: what was
    /// noted in the map's unit then is so much longer now.
    pub fn unit(&self) -> f64 {
        self.unit
    }

    /// The optical centre.
    pub fn centre_in_map(&self) -> Vector3<f64> {
        -(self.camera_from_map.rotation().inverse() * self.camera_from_map.translation())
    }

    /// Every keypoint of the frame, with or without a map point.
    pub fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// The map points that it sees, each once.
    pub(crate) fn points(&self) -> impl Iterator<Item = PointId> {
        self.observations.iter().filter_map(|one| one.point)
    }
}

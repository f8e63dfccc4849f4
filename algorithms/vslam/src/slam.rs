//! The machine: frames in, poses and a map out.

use camera::{CameraModel, Image};
use geometry::Timestamp;

use crate::{
    FrameReport, KeyframeId, MapId, PointId, StartReason, TrackingState, TrajectoryEntry, VslamMap,
    VslamSettings,
};

/// Monocular simultaneous localisation and mapping.
///
/// Deterministic: the same images give the same results, bit for bit.
#[derive(Debug)]
pub struct Vslam {
    camera: CameraModel,
    settings: VslamSettings,
    map: VslamMap,
    trajectory: Vec<TrajectoryEntry>,
}

impl Vslam {
    pub fn new(camera: CameraModel, settings: VslamSettings) -> Self {
        Self {
            camera,
            settings,
            map: VslamMap::new(MapId(0), KeyframeId(0), PointId(0)),
            trajectory: Vec::new(),
        }
    }

    /// Takes the next frame.
    pub fn process(&mut self, image: &Image, captured_at: Timestamp) -> FrameReport {
        let _ = image;
        let frame_idx = self.trajectory.len() as u64;
        self.trajectory.push(TrajectoryEntry {
            frame_idx,
            captured_at,
            map_id: self.map.id(),
            map_from_camera: None,
        });
        FrameReport {
            frame_idx,
            captured_at,
            map_id: self.map.id(),
            map_revision: self.map.revision(),
            state: TrackingState::Starting {
                reason: StartReason::FirstFrame,
            },
            map_from_camera: None,
            pose_covariance: None,
            inlier_count: 0,
            keypoint_count: 0,
            new_keyframe: None,
            settled: Vec::new(),
        }
    }

    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    pub fn settings(&self) -> &VslamSettings {
        &self.settings
    }

    /// The map that frames are tracked in.
    pub fn map(&self) -> &VslamMap {
        &self.map
    }

    /// The map with the most keyframes so far: the one worth keeping at the end.
    pub fn largest_map(&self) -> &VslamMap {
        &self.map
    }

    /// Every frame so far with its pose after all corrections.
    pub fn trajectory(&self) -> Vec<TrajectoryEntry> {
        self.trajectory.clone()
    }
}

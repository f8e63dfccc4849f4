//! What the caller learns from each frame.

use std::fmt;

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::Matrix6;

use crate::{KeyframeId, MapId};

/// Where the camera was at one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameReport {
    /// Counts the frames given to [`crate::Vslam::track`], from 0.
    pub frame_idx: u64,
    pub captured_at: Timestamp,
    /// The map in which the pose is given, or that a start would make.
    pub map_id: MapId,
    /// [`crate::VslamMap::revision`] of that map.
    pub map_revision: u64,
    pub state: TrackingState,
    /// The pose, only while tracking.
    pub map_from_camera: Option<Transform<Map, Camera>>,
    /// Covariance of the pose over `[ω; ν]`, in the unit of the map, the map taken as exact.
    pub pose_covariance: Option<Matrix6<f64>>,
    /// Keypoints that agree with the map.
    pub inlier_count: usize,
    pub keypoint_count: usize,
}

/// What a frame did to the map after its pose was out.
#[derive(Clone, Debug, PartialEq)]
pub struct MappingReport {
    pub map_id: MapId,
    /// [`crate::VslamMap::revision`] of that map.
    pub map_revision: u64,
    /// The keyframe that the frame became.
    pub new_keyframe: Option<KeyframeId>,
    /// Its pose after the local adjustment.
    pub map_from_keyframe: Option<Transform<Map, Camera>>,
    /// Keyframes that left the window of local bundle adjustment, or have been in it for long,
    /// oldest first. None is named twice; one that is culled, or whose map is lost, may never be.
    /// From then on it moves only when `map_revision` grows or by later refinements that stay
    /// within its uncertainty.
    pub settled: Vec<KeyframeId>,
}

/// Whether a pose is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingState {
    /// There is no map yet.
    Starting {
        reason: StartReason,
    },
    Tracking,
    /// There is a map, and the camera's place in it is not known.
    Lost {
        reason: LostReason,
    },
}

/// Why there is no map yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartReason {
    /// Nothing has been seen before this frame.
    FirstFrame,
    /// The image shows too few corners.
    FewKeypoints,
    /// Too little of the reference frame is still in view; a new one was taken.
    FewMatches,
    /// The image is not fit to be looked at.
    Image(ImageFault),
    /// The camera has not moved sideways far enough.
    LowParallax,
    /// The camera has turned on the spot.
    OnlyTurned,
    /// Two explanations of the motion are equally good.
    Ambiguous,
    /// The first points did not survive refinement.
    Unstable,
    /// The frame was refused.
    Refused(FrameRefusal),
}

/// Why the pose is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LostReason {
    /// The image shows too few corners.
    FewKeypoints,
    /// Too few keypoints agree with the map.
    FewInliers,
    /// Too little is in view of which the map knows the distance, as in a turn: how the camera
    /// turns is still followed, for about a second.
    OnlyDirections,
    /// The last correction moved the map around the camera by far: until the next ones confirm it,
    /// a pose that agrees with everything in view may be wrong.
    MapUnsettled,
    /// The place is not recognised.
    UnknownPlace,
    /// The image is not fit to be looked at.
    Image(ImageFault),
    /// What the image shows lies elsewhere than the camera can have turned to.
    AgainstGyroscope,
    /// The frame was refused.
    Refused(FrameRefusal),
}

/// What is wrong with an image in which nothing was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFault {
    /// Night, or a covered lens.
    Dark,
    Overexposed,
    /// Far less sharp than the images before, along rows or columns.
    Blurred,
    /// Far rougher than the images before, as with a bad radio link.
    Noisy,
    /// Much brighter or darker than the images before.
    ExposureChanged,
}

/// Why a frame was not looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameRefusal {
    /// The image does not have the size of the calibration.
    ImageSize {
        got: (usize, usize),
        expected: (usize, usize),
    },
    /// The frame is not newer than the one before.
    OutOfOrder,
}

/// The pose of one input frame after all corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryEntry {
    pub frame_idx: u64,
    pub captured_at: Timestamp,
    /// Poses of different maps share no frame of reference.
    pub map_id: MapId,
    pub map_from_camera: Option<Transform<Map, Camera>>,
}

impl fmt::Display for TrackingState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Starting { reason } => write!(f, "starting: {reason}"),
            Self::Tracking => f.write_str("tracking"),
            Self::Lost { reason } => write!(f, "lost: {reason}"),
        }
    }
}

impl fmt::Display for StartReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FirstFrame => "first frame",
            Self::FewKeypoints => "too few corners in the image",
            Self::FewMatches => "too little of the first view is still in sight",
            Self::LowParallax => "the camera has not moved sideways far enough",
            Self::OnlyTurned => "the camera has only turned",
            Self::Image(fault) => return fault.fmt(f),
            Self::Ambiguous => "two motions explain the images equally well",
            Self::Unstable => "the first points were not confirmed",
            Self::Refused(refusal) => return refusal.fmt(f),
        })
    }
}

impl fmt::Display for LostReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FewKeypoints => "too few corners in the image",
            Self::FewInliers => "too little of the image agrees with the map",
            Self::OnlyDirections => "too little in sight has a known distance",
            Self::MapUnsettled => "the map was just corrected by far",
            Self::UnknownPlace => "this place is not in the map",
            Self::Image(fault) => return fault.fmt(f),
            Self::AgainstGyroscope => "the gyroscope says that the camera looks elsewhere",
            Self::Refused(refusal) => return refusal.fmt(f),
        })
    }
}

impl fmt::Display for ImageFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dark => "the image is dark",
            Self::Overexposed => "the image is overexposed",
            Self::Blurred => "the image is blurred",
            Self::Noisy => "the image is noisy",
            Self::ExposureChanged => "the brightness changed at once",
        })
    }
}

impl fmt::Display for FrameRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ImageSize { got, expected } => write!(
                f,
                "the image is {}×{}, expected {}×{}",
                got.0, got.1, expected.0, expected.1
            ),
            Self::OutOfOrder => f.write_str("the frame is not newer than the one before"),
        }
    }
}

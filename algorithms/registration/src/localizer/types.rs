//! What goes into the localiser and what it says about it.

use std::fmt;

use features::Descriptor;
use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Matrix3, Vector2, Vector3};

/// An anchor and one of its epochs, numbered by the caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AnchorIdx(pub u32);

/// A chunk, numbered within its anchor and epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChunkIdx(pub u64);

/// A keyframe of the own map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct KeyframeIdx(pub u64);

/// A point of an anchor's chunk. The chunk's origin is the camera that saw it first.
#[derive(Clone, Copy, Debug)]
pub struct Landmark {
    pub point_in_chunk: Vector3<f64>,
    pub covariance_in_chunk: Matrix3<f64>,
    pub descriptor: Descriptor,
}

/// What became of a chunk's landmarks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkIntake {
    pub accepted_count: usize,
    /// Not finite, behind or absurdly far from the chunk's camera, or beyond the limits.
    pub refused_count: usize,
}

/// A new keyframe of the own map.
#[derive(Clone, Debug)]
pub struct KeyframeObservation {
    pub id: KeyframeIdx,
    pub captured_at: Timestamp,
    pub map_from_camera: Transform<Map, Camera>,
    pub features: Vec<ObservedFeature>,
}

/// A feature of a keyframe, with the own map point that it belongs to, if there is one.
#[derive(Clone, Copy, Debug)]
pub struct ObservedFeature {
    /// On the ideal image plane: x/z, y/z.
    pub position: Vector2<f64>,
    /// Of `position`, per axis.
    pub sigma: f64,
    pub descriptor: Descriptor,
    pub point: Option<ObservedPoint>,
}

#[derive(Clone, Copy, Debug)]
pub struct ObservedPoint {
    pub point_in_map: Vector3<f64>,
    pub covariance_in_map: Matrix3<f64>,
}

/// What a keyframe did to the estimate.
#[derive(Clone, Debug)]
pub struct AlignmentReport {
    pub verdict: Verdict,
    /// One entry for each anchor that was tried.
    pub anchors: Vec<AnchorReport>,
    /// The estimate has changed by more than its uncertainty explained; also counted in
    /// `Estimate::jump_count`.
    pub jumped: bool,
}

#[derive(Clone, Copy, Debug)]
pub struct AnchorReport {
    pub anchor: AnchorIdx,
    pub verdict: Verdict,
    pub candidate_count: usize,
    pub match_count: usize,
    pub inlier_count: usize,
}

/// Whether a keyframe was located, and believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// It agrees with the estimate and improves it.
    Accepted,
    /// It was located, but waits for other keyframes to agree with it.
    Unconfirmed,
    Refused(Refusal),
}

/// Why a keyframe was not located. All but [`Refusal::BadInput`] are normal in flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// No anchor has placed landmarks yet.
    NoLandmarks,
    /// No landmark is predicted to be in view.
    NothingInView,
    TooFewMatches,
    /// The matches support no common pose.
    NoConsensus,
    /// A second, different pose is supported nearly as well.
    Ambiguous,
    TooFewInliers,
    /// The inliers cover too little of the image.
    InliersClustered,
    /// Too few of the inliers are points of the own map, so that the scale stays open.
    NoScale,
    /// Numbers that are not finite, or a keyframe without features.
    BadInput,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Accepted => f.write_str("accepted"),
            Self::Unconfirmed => f.write_str("waits for other keyframes to agree"),
            Self::Refused(refusal) => refusal.fmt(f),
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoLandmarks => "no landmarks yet",
            Self::NothingInView => "no landmark in view",
            Self::TooFewMatches => "too few matches",
            Self::NoConsensus => "no consensus",
            Self::Ambiguous => "ambiguous",
            Self::TooFewInliers => "too few inliers",
            Self::InliersClustered => "inliers clustered in the image",
            Self::NoScale => "scale not observable",
            Self::BadInput => "bad input",
        })
    }
}

#[derive(Clone, Debug)]
pub struct LocalizerSettings {
    /// The seed of all random draws.
    pub seed: u64,
}

impl Default for LocalizerSettings {
    fn default() -> Self {
        Self { seed: 1 }
    }
}

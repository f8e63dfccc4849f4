//! What goes into the localiser and what it says about it.

use std::fmt;

use features::Descriptor;
use geometry::{Camera, Map, Matrix7, Tangent7, Timestamp, Transform};
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::likeness::{EXTENT_MIN, Likeness};

/// An anchor and one of its epochs, numbered by the caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AnchorIdx(pub u32);

/// Whose map it is: the maps of one owner share the errors of its georeference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OwnerIdx(pub u32);

/// How a map came to its place on the Earth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reference {
    /// From position fixes of its own: it has a vote.
    #[default]
    Fixed,
    /// From registration to other maps: it extends what they cover, and has no vote.
    Registered,
    /// From registration to what rests on the own map: not used.
    Circular,
}

/// An anchor that says otherwise, and how far from the estimate, at the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contradiction {
    pub anchor: AnchorIdx,
    pub distance_m: f64,
    pub turn_rad: f64,
    /// Its scale as a factor of the estimate's.
    pub scale: f64,
}

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
    /// `Localizer::jump_count`.
    pub jumped: bool,
    /// Keyframes that agree with each other have replaced an alignment that was wrong; also
    /// counted in `Localizer::overruled_count`.
    pub overruled: bool,
    /// An alignment that had begun was given up, because what came since shows another place; also
    /// counted in `Localizer::overruled_count`.
    pub revoked: bool,
}

impl AlignmentReport {
    pub(super) fn refused(refusal: Refusal) -> Self {
        Self {
            verdict: Verdict::Refused(refusal),
            anchors: Vec::new(),
            jumped: false,
            overruled: false,
            revoked: false,
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct AnchorReport {
    pub anchor: AnchorIdx,
    pub verdict: Verdict,
    /// Keyframes that agree with each other have replaced the alignment to this anchor.
    pub overruled: bool,
    /// The alignment to this anchor was given up: its keyframes show another place.
    pub revoked: bool,
    /// Chunks and landmarks that were looked at, again for each round of refinement.
    pub chunk_count: usize,
    pub candidate_count: usize,
    pub match_count: usize,
    pub inlier_count: usize,
    /// What keyframes that agree on an alignment show of its place, as of the last time that it
    /// was to begin, or was tested on.
    pub likeness: Option<Likeness>,
}

/// Whether a keyframe was located, and believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// It agrees with the estimate and improves it.
    Accepted,
    /// It was located, but waits for others to agree with it.
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
    /// Much that should be in view from there is not: the place only looks alike.
    Contradicted,
    /// Keyframes agree, but both maps show too little in common to tell the place from one that
    /// looks alike.
    FewWitnesses,
    /// Too few of the inliers are points of the own map, so that the scale stays open.
    NoScale,
    /// Numbers that are not finite, or a keyframe without features.
    BadInput,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Accepted => f.write_str("accepted"),
            Self::Unconfirmed => f.write_str("waits for others to agree"),
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
            Self::Contradicted => "much that should be in view is not",
            Self::FewWitnesses => "both maps show too little to tell the place",
            Self::NoScale => "scale not observable",
            Self::BadInput => "bad input",
        })
    }
}

/// How fast the alignment of two maps drifts, relative to the scene: standard deviations after
/// a way as long as the scene is deep, growing with the root of the way.
///
/// Larger follows drift sooner and is less certain between alignments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftRates {
    pub rotation_rad: f64,
    /// Share of the scene's depth.
    pub translation: f64,
    pub log_scale: f64,
}

/// Standard deviations that are added to what the residuals promise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorFloor {
    pub rotation_rad: f64,
    /// Share of the scene's depth.
    pub translation: f64,
    pub log_scale: f64,
}

impl ErrorFloor {
    /// Over `[ω; ν; ln s]`, for a scene so deep.
    pub(super) fn covariance(&self, depth: f64) -> Matrix7 {
        let sigmas = [self.rotation_rad, self.translation * depth, self.log_scale];
        Matrix7::from_diagonal(&Tangent7::from_fn(|row, _| sigmas[row / 3].powi(2)))
    }
}

/// How keyframes are located and believed.
///
/// Lengths are shares of the scene's depth or lie on the ideal image plane, because neither map
/// has a metric scale.
#[derive(Clone, Debug)]
pub struct LocalizerSettings {
    /// The seed of all random draws.
    pub seed: u64,
    /// Descriptor distances per keyframe while nothing is known. Higher searches more of a large
    /// map at once and takes longer: about 25 ms for ten million.
    pub search_distance_count_max: usize,
    /// Bits that may differ in the search, and when the pose is predicted.
    pub search_distance_max: u32,
    pub predicted_distance_max: u32,
    /// The best must be better than this share of the second best.
    pub search_ratio_max: f64,
    pub predicted_ratio_max: f64,
    /// Samples drawn at most in the search, and when the pose is predicted.
    pub search_iteration_count_max: usize,
    pub predicted_iteration_count_max: usize,
    /// Inliers that a pose needs in the search: lower finds more and more false ones.
    pub search_inlier_count_min: usize,
    /// Inliers that a located keyframe needs.
    pub inlier_count_min: usize,
    /// The share of the matches near their landmark that must be inliers.
    pub inlier_share_min: f64,
    /// A second pose with this share of the best one's inliers makes the search ambiguous.
    pub rival_share_max: f64,
    /// Cells of a 4×4 grid over the image that must hold inliers.
    pub occupied_cell_count_min: usize,
    /// Of a keyframe: standard deviation of the inliers across the image, in its widths and
    /// heights, in the direction in which they lie narrowest. A strip at the border tells the pose
    /// badly, and states that it does not: evenly filled, a strip of 0.28 widths has 0.08.
    pub inlier_breadth_min: f64,
    /// Landmark error assumed before a pose is known, on the ideal plane.
    pub search_slack: f64,
    /// How far from its landmark a feature may be once the pose is known, on the ideal plane.
    pub refine_radius: f64,
    /// Least and largest radius of the search around a predicted pose, on the ideal plane.
    pub predicted_radius_min: f64,
    pub predicted_radius_max: f64,
    /// Landmarks about a predicted pose that are looked at: beyond, those of the newest chunks. So
    /// a place that was mapped many times costs no more than one that was mapped a few times.
    pub predicted_landmark_count_max: usize,
    /// Points known to both maps that a scale needs.
    pub depth_pair_count_min: usize,
    /// Least standard deviation of the logarithm of a depth ratio.
    pub depth_ratio_sigma_min: f64,
    /// Keyframes that must agree before the first alignment, and their inliers together.
    pub first_keyframe_count: usize,
    pub first_inlier_count: usize,
    /// Keyframes that must agree with each other to overrule an alignment.
    pub switch_keyframe_count: usize,
    /// The share of the place over which both maps must look alike, a standard deviation of it
    /// allowed for, before an alignment is begun, and below which it is given up: rooms of one plan
    /// share their furniture, and no more. Higher refuses more of them, and more places that have
    /// changed.
    pub agreement_extent_min: f64,
    /// Keyframes in the sliding window: more is calmer, fewer forgets drift sooner.
    pub window_keyframe_count: usize,
    /// Squared difference per degree of freedom above which a keyframe contradicts.
    pub disagreement_max: f64,
    /// The same between anchors.
    pub anchor_disagreement_max: f64,
    /// Keyframes nearer than this many depths share their errors.
    pub correlation_depths: f64,
    /// The georeference errors of an anchor's chunks are alike over a way of so many depths: after
    /// it, half of their variance is averaged out. Less states more certainty.
    pub georeference_correlation_depths: f64,
    /// The share of that variance that all chunks have in common, so that no way averages it out.
    pub georeference_share_min: f64,
    pub drift: DriftRates,
    /// Of one located keyframe.
    pub keyframe_floor: ErrorFloor,
    /// Of the alignment to an anchor, however many keyframes it rests on: the bend of its map.
    pub alignment_floor: ErrorFloor,
}

impl Default for LocalizerSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            search_distance_count_max: 8_000_000,
            search_distance_max: 64,
            predicted_distance_max: 80,
            search_ratio_max: 0.9,
            predicted_ratio_max: 0.9,
            search_iteration_count_max: 1500,
            predicted_iteration_count_max: 200,
            search_inlier_count_min: 12,
            inlier_count_min: 15,
            inlier_share_min: 0.25,
            rival_share_max: 0.6,
            occupied_cell_count_min: 4,
            inlier_breadth_min: 0.08,
            search_slack: 0.004,
            refine_radius: 0.012,
            predicted_radius_min: 0.03,
            predicted_radius_max: 0.25,
            predicted_landmark_count_max: 40_000,
            depth_pair_count_min: 8,
            depth_ratio_sigma_min: 0.02,
            first_keyframe_count: 2,
            first_inlier_count: 50,
            switch_keyframe_count: 3,
            agreement_extent_min: EXTENT_MIN,
            window_keyframe_count: 40,
            disagreement_max: 5.0,
            anchor_disagreement_max: 4.0,
            correlation_depths: 0.3,
            georeference_correlation_depths: 2.0,
            georeference_share_min: 0.3,
            drift: DriftRates {
                rotation_rad: 0.008,
                translation: 0.004,
                log_scale: 0.01,
            },
            keyframe_floor: ErrorFloor {
                rotation_rad: 0.002,
                translation: 0.003,
                log_scale: 0.008,
            },
            alignment_floor: ErrorFloor {
                rotation_rad: 0.002,
                translation: 0.003,
                log_scale: 0.004,
            },
        }
    }
}

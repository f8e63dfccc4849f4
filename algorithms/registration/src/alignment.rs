//! What is asked of a registration, and what comes out of it.

use geometry::{Matrix7, Similarity};

use crate::evidence::Evidence;
use crate::gravity::Gravity;
use crate::likeness::Likeness;

/// The frame of the cloud that is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {}

/// The frame of the cloud that stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {}

/// What a pair of points is measured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// The distance of the points.
    Point,
    /// The distance to the plane through the target point.
    Plane,
    /// The distance whitened by the local covariances of both points (generalised ICP).
    Gicp,
}

/// Where the alignment starts.
#[derive(Clone, Copy, Debug)]
pub enum Start {
    /// The clouds are nearly aligned as they are.
    Identity,
    /// A guess.
    Given(Similarity<Target, Source>),
    /// Nothing is known: descriptors where both clouds have them, else local shape.
    Search,
}

#[derive(Clone, Debug)]
pub struct RegisterSettings {
    pub metric: Metric,
    /// Whether the scale is estimated; otherwise it stays that of the start.
    pub with_scale: bool,
    pub start: Start,
    /// Both clouds are thinned to one point per cube of this edge; `None` keeps all points.
    pub voxel_m: Option<f64>,
    /// Pairs farther apart are not pairs; `None` derives it from the spacing of the points.
    pub max_distance_m: Option<f64>,
    pub iteration_limit: usize,
    /// Which way is up in both clouds, if that is known: the search only turns about it.
    pub gravity: Option<Gravity>,
    /// The seed of the search.
    pub seed: u64,
}

impl Default for RegisterSettings {
    fn default() -> Self {
        Self {
            metric: Metric::Gicp,
            with_scale: false,
            start: Start::Identity,
            voxel_m: None,
            max_distance_m: None,
            iteration_limit: 100,
            gravity: None,
            seed: 1,
        }
    }
}

/// A registration is accepted with its alignment, or refused with a reason.
#[derive(Clone, Debug)]
pub enum Outcome {
    Accepted(Box<Alignment>),
    Refused {
        reason: Refusal,
        /// What was measured before the refusal, where it got that far.
        quality: Option<Box<Quality>>,
    },
}

#[derive(Clone, Debug)]
pub struct Alignment {
    pub target_from_source: Similarity<Target, Source>,
    /// Over `[ω; ν; ln s]`, right perturbation; zero in `ln s` where the scale was fixed.
    pub covariance: Matrix7,
    pub quality: Quality,
}

/// How well two aligned clouds agree.
#[derive(Clone, Debug, Default)]
pub struct Quality {
    /// Of the paired points, in the metric's residual.
    pub rmse_m: f64,
    /// Between paired points, the median.
    pub distance_m_p50: f64,
    /// Of the paired points, across the target's surface.
    pub surface_rmse_m: f64,
    /// The share of source points with a target point nearby.
    pub overlap_source: f64,
    /// The share of target points in the source's bounding box with a source point nearby.
    pub overlap_target: f64,
    pub iteration_count: usize,
    /// Mean cosine between the normals of paired points; `None` where hardly any have two.
    pub normal_agreement: Option<f64>,
    /// How far the points are from their partners, relative to elsewhere nearby (squared).
    pub residual_contrast: f64,
    /// Directions that the geometry does not fix, in words, along the source's axes.
    pub weak_directions: Vec<String>,
    /// What the search found; `None` without one.
    pub evidence: Option<Evidence>,
    /// How much of the common part looks alike; `None` without a search by appearance.
    pub likeness: Option<Likeness>,
}

/// Why a registration was refused.
#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    TooFewPoints {
        source_count: usize,
        target_count: usize,
    },
    SearchFoundNothing,
    /// What explains the clouds explains them about as well elsewhere.
    Ambiguous {
        consistent_count: usize,
        runner_up_count: usize,
    },
    NotConverged,
    LittleOverlap {
        source: f64,
        target: f64,
    },
    WeakGeometry {
        directions: Vec<String>,
    },
    LargeResidual {
        rmse_m: f64,
    },
    SurfacesDisagree {
        normal_agreement: Option<f64>,
    },
    ScaleOutOfBounds {
        scale: f64,
    },
    /// What looks the same lies in one spot, and may stand elsewhere too.
    NarrowEvidence {
        spread: f64,
    },
    /// Some things look the same, and where both clouds have been, too much else does not.
    AnotherPlace {
        extent: f64,
    },
    /// What was found by shape alone must fit better than what is known from elsewhere.
    ShapeAlone {
        residual_contrast: f64,
    },
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TooFewPoints {
                source_count,
                target_count,
            } => write!(f, "too few points: {source_count} and {target_count}"),
            Self::SearchFoundNothing => write!(f, "search found no alignment"),
            Self::Ambiguous {
                consistent_count,
                runner_up_count,
            } => write!(
                f,
                "ambiguous: {consistent_count} points agree with one alignment, and \
                 {runner_up_count} others with another"
            ),
            Self::NotConverged => write!(f, "not converged"),
            Self::LittleOverlap { source, target } => write!(
                f,
                "little overlap: {:.0} % of the source, {:.0} % of the target",
                source * 100.0,
                target * 100.0
            ),
            Self::WeakGeometry { directions } => {
                write!(f, "the geometry leaves free: {}", directions.join(", "))
            }
            Self::LargeResidual { rmse_m } => write!(
                f,
                "residual of {rmse_m:.3} is more than the spacing of the points explains"
            ),
            Self::SurfacesDisagree { normal_agreement } => match normal_agreement {
                Some(agreement) => write!(
                    f,
                    "the shapes differ: normals of paired points agree to {agreement:.2}, \
                     and chance alone gives 0.5"
                ),
                None => write!(
                    f,
                    "the shapes differ: too few surfaces to compare, and the points do not coincide"
                ),
            },
            Self::NarrowEvidence { spread } => write!(
                f,
                "what looks the same covers {:.0} % of the source's width, and may recur",
                spread * 100.0
            ),
            Self::AnotherPlace { extent } => write!(
                f,
                "a place that shares some things: the clouds look alike over {:.0} % of what both \
                 show",
                extent * 100.0
            ),
            Self::ShapeAlone { residual_contrast } => write!(
                f,
                "found by shape alone, and shifted clouds fit nearly as well: the residual is \
                 {residual_contrast:.2} of theirs"
            ),
            Self::ScaleOutOfBounds { scale } => write!(f, "scale {scale:.3} is out of bounds"),
        }
    }
}

impl Outcome {
    pub(crate) fn refused(reason: Refusal) -> Self {
        Self::Refused {
            reason,
            quality: None,
        }
    }
}

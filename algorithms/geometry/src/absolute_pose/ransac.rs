//! A pose without a start: minimal samples, a truncated cost, refinement of each new best.

use nalgebra::Vector3;
use rand::Rng;
use rand::seq::index::sample_array;

use super::{
    AbsolutePose, CHI_SQUARED_2_P95, PointObservation, PoseRefusal, RefineSettings, p3p,
    refine_absolute_pose, residual_squared,
};
use crate::{Camera, Transform};

/// How long to search, and what to accept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacSettings {
    /// Stop when a better pose is less likely than one minus this.
    pub confidence: f64,
    /// Samples drawn at most; 300 find a pose among 75 % outliers.
    pub iteration_count_max: usize,
    /// A squared, whitened residual above this is an outlier.
    pub chi_squared_max: f64,
    /// A pose that explains fewer observations is refused. Fewer than ten invite coincidences.
    pub inlier_count_min: usize,
}

impl Default for RansacSettings {
    fn default() -> Self {
        Self {
            confidence: 0.999,
            iteration_count_max: 500,
            chi_squared_max: CHI_SQUARED_2_P95,
            inlier_count_min: 10,
        }
    }
}

/// The pose that explains most observations.
///
/// P3P in RANSAC with a truncated quadratic cost (MSAC), local refinement of each new best
/// (Chum et al. 2003) and an adaptive number of samples. Deterministic for a given `rng`.
pub fn ransac_absolute_pose<World>(
    observations: &[PointObservation],
    settings: &RansacSettings,
    rng: &mut impl Rng,
) -> Result<AbsolutePose<World>, PoseRefusal> {
    let required = settings.inlier_count_min.max(4);
    if observations.len() < required {
        return Err(PoseRefusal::TooFewObservations {
            found: observations.len(),
            required,
        });
    }
    let directions: Vec<Vector3<f64>> = observations
        .iter()
        .map(|observation| observation.position.push(1.0).normalize())
        .collect();
    let mut best: Option<Candidate<World>> = None;
    let mut iteration_count = 0;
    let mut iteration_count_needed = settings.iteration_count_max;
    while iteration_count < iteration_count_needed {
        iteration_count += 1;
        let sample: [usize; 3] = sample_array(rng, observations.len())
            .expect("there are at least as many observations as a sample has");
        let poses = p3p(
            &sample.map(|i| observations[i].point_in_world),
            &sample.map(|i| directions[i]),
        );
        for pose in poses.into_iter().flatten() {
            let cost_limit = best.as_ref().map_or(f64::INFINITY, |best| best.cost);
            let Some(mut candidate) = Candidate::score(pose, observations, settings, cost_limit)
            else {
                continue;
            };
            candidate.improve(observations, settings);
            iteration_count_needed = settings.iteration_count_max.min(iterations_needed(
                candidate.inlier_count as f64 / observations.len() as f64,
                settings.confidence,
            ));
            best = Some(candidate);
        }
    }
    conclude(best, observations, settings, iteration_count)
}

fn conclude<World>(
    best: Option<Candidate<World>>,
    observations: &[PointObservation],
    settings: &RansacSettings,
    iteration_count: usize,
) -> Result<AbsolutePose<World>, PoseRefusal> {
    let required = settings.inlier_count_min.max(4);
    let best = best.ok_or(PoseRefusal::Degenerate)?;
    if best.inlier_count < required {
        return Err(PoseRefusal::TooFewInliers {
            found: best.inlier_count,
            required,
        });
    }
    let inliers = observations
        .iter()
        .map(|observation| is_inlier(&best.camera_from_world, observation, settings))
        .collect();
    Ok(AbsolutePose {
        camera_from_world: best.camera_from_world,
        inliers,
        inlier_count: best.inlier_count,
        iteration_count,
    })
}

/// How many samples make one without outliers likely enough.
fn iterations_needed(inlier_share: f64, confidence: f64) -> usize {
    let all_inliers = inlier_share.powi(3);
    if all_inliers <= 0.0 {
        return usize::MAX;
    }
    let needed = (1.0 - confidence).ln() / (-all_inliers).ln_1p();
    // NaN and infinity saturate to zero and to the largest number.
    needed.ceil().max(1.0) as usize
}

fn is_inlier<World>(
    pose: &Transform<Camera, World>,
    observation: &PointObservation,
    settings: &RansacSettings,
) -> bool {
    residual_squared(pose, observation).is_some_and(|r2| r2 <= settings.chi_squared_max)
}

struct Candidate<World> {
    camera_from_world: Transform<Camera, World>,
    cost: f64,
    inlier_count: usize,
}

impl<World> Candidate<World> {
    /// Sums the truncated cost, and gives up when it reaches `cost_limit`.
    fn score(
        camera_from_world: Transform<Camera, World>,
        observations: &[PointObservation],
        settings: &RansacSettings,
        cost_limit: f64,
    ) -> Option<Self> {
        let mut cost = 0.0;
        let mut inlier_count = 0;
        for observation in observations {
            let squared = residual_squared(&camera_from_world, observation);
            match squared.filter(|squared| *squared <= settings.chi_squared_max) {
                Some(squared) => {
                    cost += squared;
                    inlier_count += 1;
                }
                None => cost += settings.chi_squared_max,
            }
            if cost >= cost_limit {
                return None;
            }
        }
        Some(Self {
            camera_from_world,
            cost,
            inlier_count,
        })
    }

    /// Refines on the inliers, and keeps the result if it is better.
    fn improve(&mut self, observations: &[PointObservation], settings: &RansacSettings) {
        let refine_settings = RefineSettings {
            chi_squared_max: settings.chi_squared_max,
            round_count: 2,
            ..RefineSettings::default()
        };
        let refined = refine_absolute_pose(&self.camera_from_world, observations, &refine_settings);
        if let Ok(refined) = refined
            && let Some(better) =
                Self::score(refined.camera_from_world, observations, settings, self.cost)
        {
            *self = better;
        }
    }
}

//! The best alignment of given correspondences, under what is known of it.

use geometry::{Similarity, umeyama};
use nalgebra::{Matrix3, UnitQuaternion, UnitVector3, Vector3};

use super::lengths::Slack;
use super::{ConsensusSettings, Correspondence};
use crate::alignment::{Source, Target};
use crate::gravity::Gravity;

/// A difference of two distances, each with the noise of two ends, in inlier distances.
const SLACK_DISTANCES: f64 = 1.2;
/// Ends nearer to each other than this many inlier distances say too little of the scale.
const BASELINE_DISTANCES: f64 = 4.0;
/// Inliers must spread at least this far across their line, in inlier distances (root mean
/// square): noise alone spreads a line by 0.3.
const SPREAD_DISTANCES_MIN: f64 = 0.6;

/// What is known of the alignment, and how well correspondences are.
pub(super) struct Fit {
    with_scale: bool,
    gravity: Option<Level>,
    inlier_distance: f64,
    scale_factor_max: f64,
}

/// Rotations that turn up to z.
#[derive(Clone, Copy)]
struct Level {
    level_from_target: UnitQuaternion<f64>,
    level_from_source: UnitQuaternion<f64>,
}

impl Fit {
    pub fn new(settings: &ConsensusSettings) -> Self {
        Self {
            with_scale: settings.with_scale,
            gravity: settings.gravity.as_ref().map(Level::new),
            inlier_distance: settings.inlier_distance,
            scale_factor_max: settings.scale_factor_max,
        }
    }

    /// The scale that two lengths imply; `None` if they are too short, or it is not believed.
    pub fn scale_of(&self, in_target: f64, in_source: f64) -> Option<f64> {
        if in_target < BASELINE_DISTANCES * self.inlier_distance || in_source <= 0.0 {
            return None;
        }
        if !self.with_scale {
            return ((in_target - in_source).abs() < self.slack()).then_some(1.0);
        }
        let scale = in_target / in_source;
        self.is_believed(scale).then_some(scale)
    }

    /// For lengths that are compared under a scale from a baseline of this length.
    pub fn length_slack(&self, baseline: f64) -> Slack {
        Slack {
            absolute: self.slack() as f32,
            relative: (self.slack() / baseline) as f32,
        }
    }

    fn slack(&self) -> f64 {
        SLACK_DISTANCES * self.inlier_distance
    }

    fn is_believed(&self, scale: f64) -> bool {
        scale.max(1.0 / scale) <= self.scale_factor_max
    }

    /// The pose with the least squared error.
    pub fn of<'a>(
        &self,
        pairs: impl Iterator<Item = &'a Correspondence> + Clone,
    ) -> Option<Similarity<Target, Source>> {
        let fitted = match &self.gravity {
            Some(level) => level.fit(pairs, self.with_scale)?,
            None => {
                let weighted = pairs.map(|pair| (pair.in_target, pair.in_source, 1.0));
                umeyama(weighted, self.with_scale).ok()?
            }
        };
        self.is_believed(fitted.scale()).then_some(fitted)
    }

    /// The pose by two correspondences, where gravity is known and their heights and widths have
    /// one scale.
    pub fn of_two(
        &self,
        first: &Correspondence,
        second: &Correspondence,
    ) -> Option<Similarity<Target, Source>> {
        let level = self.gravity?;
        let in_target = level.level_from_target * (second.in_target - first.in_target);
        let in_source = level.level_from_source * (second.in_source - first.in_source);
        let scale = self.scale_of(in_target.norm(), in_source.norm())?;
        let across = in_target.xy().norm();
        let is_level = (in_target.z - scale * in_source.z).abs() < self.slack()
            && (across - scale * in_source.xy().norm()).abs() < self.slack()
            && across > BASELINE_DISTANCES * self.inlier_distance;
        if !is_level {
            return None;
        }
        self.of([*first, *second].iter())
    }

    /// Whether points spread far enough for all that is sought to be fixed.
    pub fn is_fixed_by<'a>(&self, pairs: impl Iterator<Item = &'a Correspondence> + Clone) -> bool {
        let count = pairs.clone().count().max(1) as f64;
        let mean = pairs
            .clone()
            .map(|pair| pair.in_target)
            .sum::<Vector3<f64>>()
            / count;
        let mut scatter = Matrix3::zeros();
        for pair in pairs {
            let mut offset = pair.in_target - mean;
            if let Some(level) = &self.gravity {
                // The turn about up is fixed by what lies across it, in any one direction.
                offset = level.level_from_target * offset;
                offset.z = 0.0;
            }
            scatter += offset * offset.transpose() / count;
        }
        let mut spreads = scatter.symmetric_eigenvalues();
        spreads.as_mut_slice().sort_by(f64::total_cmp);
        let spread = if self.gravity.is_some() {
            spreads[2]
        } else {
            spreads[1]
        };
        spread.max(0.0).sqrt() > SPREAD_DISTANCES_MIN * self.inlier_distance
    }
}

impl Level {
    fn new(gravity: &Gravity) -> Self {
        let level = |up: &UnitVector3<f64>| {
            let half_turn =
                || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            UnitQuaternion::rotation_between_axis(up, &Vector3::z_axis()).unwrap_or_else(half_turn)
        };
        Self {
            level_from_target: level(&gravity.up_in_target),
            level_from_source: level(&gravity.up_in_source),
        }
    }

    /// Least squares over the turn about up, the place and the scale, in closed form.
    fn fit<'a>(
        &self,
        pairs: impl Iterator<Item = &'a Correspondence> + Clone,
        with_scale: bool,
    ) -> Option<Similarity<Target, Source>> {
        let mut count = 0.0;
        let (mut mean_in_target, mut mean_in_source) = (Vector3::zeros(), Vector3::zeros());
        for pair in pairs.clone() {
            count += 1.0;
            mean_in_target += pair.in_target;
            mean_in_source += pair.in_source;
        }
        if count < 2.0 {
            return None;
        }
        mean_in_target /= count;
        mean_in_source /= count;
        // Along, across and up of the source against the target, and the source's own square.
        let (mut along, mut across, mut up, mut square) = (0.0, 0.0, 0.0, 0.0);
        for pair in pairs {
            let in_target = self.level_from_target * (pair.in_target - mean_in_target);
            let in_source = self.level_from_source * (pair.in_source - mean_in_source);
            along += in_source.x * in_target.x + in_source.y * in_target.y;
            across += in_source.x * in_target.y - in_source.y * in_target.x;
            up += in_source.z * in_target.z;
            square += in_source.norm_squared();
        }
        let turned = along.hypot(across);
        let scale = if with_scale {
            (turned + up) / square
        } else {
            1.0
        };
        if turned <= 0.0 || scale <= 0.0 || !scale.is_finite() {
            return None;
        }
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), across.atan2(along));
        let rotation = self.level_from_target.inverse() * turn * self.level_from_source;
        let translation = mean_in_target - rotation * mean_in_source * scale;
        Some(Similarity::new(scale, rotation, translation))
    }
}

//! Iterative closest points in three metrics, with the scale fixed or free.
//!
//! Works on centred clouds. The kernel's width shrinks from what the start needs to what the
//! spacing of the points allows (graduated non-convexity), so that one loop serves rough and good
//! starts. With a free scale pairs are sought from both clouds: from one side alone a cloud that
//! shrinks to a spot would fit perfectly.

mod linearise;
mod pairs;

use geometry::{Matrix7, RobustKernel, Similarity, Tangent7};
use nalgebra::Matrix6;

use crate::alignment::{Metric, Source, Target};
use crate::cloud::ShapedCloud;

pub(crate) use linearise::{NormalEquations, information};
pub(crate) use pairs::{Pair, find_pairs, overlaps};

/// The kernel's width narrows by this factor in each iteration.
const NARROWING: f64 = 0.8;
/// The final width in units of the spacing of the coarser cloud.
const FINAL_WIDTH_SPACINGS: f64 = 5.0;
/// Pairs beyond this many widths are not sought.
const GATE_WIDTHS: f64 = 3.0;
/// Pairs that stand for one independent measurement: those of a neighbourhood.
const PAIRS_PER_INDEPENDENT: f64 = 10.0;
/// Sparse clouds swing between pairings for ever; a last step below this share of the kernel's
/// width is good enough.
const SETTLED_WIDTHS: f64 = 0.02;
/// The scale stays within this factor of where it started.
const SCALE_FACTOR_MAX: f64 = 2.0;

#[derive(Clone, Copy, Debug)]
pub(crate) struct IcpSettings {
    pub metric: Metric,
    pub with_scale: bool,
    pub max_distance: Option<f64>,
    pub iteration_limit: usize,
}

/// Where the iteration ended.
#[derive(Clone, Debug)]
pub(crate) struct Icp {
    /// Between the centred clouds.
    pub target_from_source: Similarity<Target, Source>,
    pub normal: NormalEquations,
    pub iteration_count: usize,
    pub converged: bool,
    pub scale_bounded: bool,
}

/// The width of the kernel at the end.
fn final_width(source: &ShapedCloud, target: &ShapedCloud, scale: f64) -> f64 {
    FINAL_WIDTH_SPACINGS * (source.spacing * scale).max(target.spacing).max(1e-9)
}

/// `None` if the pairs do not determine a step.
pub(crate) fn iterate(
    source: &ShapedCloud,
    target: &ShapedCloud,
    start: &Similarity<Target, Source>,
    settings: &IcpSettings,
) -> Option<Icp> {
    let mut alignment = *start;
    let narrowest = final_width(source, target, start.scale());
    let mut width = start_width(source, target, start, settings).max(narrowest);
    let mut pairs = Vec::new();
    let mut iteration_count = 0;
    let mut converged = false;
    let mut settled = false;
    let mut scale_bounded = false;
    let mut normal = NormalEquations::default();
    while iteration_count < settings.iteration_limit && !converged && !scale_bounded {
        iteration_count += 1;
        let gate = (GATE_WIDTHS * width).min(settings.max_distance.unwrap_or(f64::INFINITY));
        find_pairs(
            source,
            target,
            &alignment,
            gate,
            settings.with_scale,
            &mut pairs,
        );
        let kernel = RobustKernel::GemanMcClure { threshold: width };
        normal = NormalEquations::sum(source, target, &alignment, &pairs, settings.metric, kernel);
        let step = normal.step(settings.with_scale)?;
        alignment = alignment.perturbed(&step);
        let ratio = alignment.scale() / start.scale();
        scale_bounded = !(1.0 / SCALE_FACTOR_MAX..SCALE_FACTOR_MAX).contains(&ratio);
        let narrow = width <= narrowest * 1.001;
        let moved = largest_move(&step, source.radius) * alignment.scale();
        converged = narrow && moved < 1e-5 * target.radius;
        settled = narrow && moved < SETTLED_WIDTHS * narrowest;
        width = (width * NARROWING).max(narrowest);
    }
    Some(Icp {
        target_from_source: alignment,
        normal,
        iteration_count,
        converged: converged || settled,
        scale_bounded,
    })
}

/// Twice the distance within which three quarters of the source find a partner at the start.
fn start_width(
    source: &ShapedCloud,
    target: &ShapedCloud,
    start: &Similarity<Target, Source>,
    settings: &IcpSettings,
) -> f64 {
    let gate = settings.max_distance.unwrap_or(f64::INFINITY);
    let mut pairs: Vec<Pair> = Vec::new();
    find_pairs(source, target, start, gate, false, &mut pairs);
    if pairs.is_empty() {
        return 0.0;
    }
    let rank = pairs.len() * 3 / 4;
    let (_, found, _) = pairs.select_nth_unstable_by(rank, |a, b| {
        a.distance_squared.total_cmp(&b.distance_squared)
    });
    2.0 * f64::from(found.distance_squared).sqrt()
}

/// How far a step moves a point at the cloud's radius.
fn largest_move(step: &Tangent7, radius: f64) -> f64 {
    let turn = step.fixed_rows::<3>(0).norm() + step[6].abs();
    turn * radius + step.fixed_rows::<3>(3).norm()
}

impl NormalEquations {
    /// The step that solves the equations, rigid or with scale.
    fn step(&self, with_scale: bool) -> Option<Tangent7> {
        if with_scale {
            return self
                .hessian
                .cholesky()
                .map(|factor| factor.solve(&-self.gradient));
        }
        let rigid = self.hessian.fixed_view::<6, 6>(0, 0).into_owned();
        let gradient = self.gradient.fixed_rows::<6>(0).into_owned();
        let step = rigid.cholesky()?.solve(&-gradient);
        let mut all = Tangent7::zeros();
        all.fixed_rows_mut::<6>(0).copy_from(&step);
        Some(all)
    }

    /// The covariance of the alignment; zero in the scale where that is fixed.
    ///
    /// Neighbours share their normals and the bend of their surface, so that only every
    /// `PAIRS_PER_INDEPENDENT`-th pair counts as evidence of its own.
    pub fn covariance(&self, with_scale: bool) -> Option<Matrix7> {
        let freedom = (self.weight_sum - 7.0).max(1.0);
        let variance = PAIRS_PER_INDEPENDENT * self.cost / freedom;
        if with_scale {
            return self
                .hessian
                .cholesky()
                .map(|factor| factor.inverse() * variance);
        }
        let rigid: Matrix6<f64> = self.hessian.fixed_view::<6, 6>(0, 0).into_owned();
        let mut all = Matrix7::zeros();
        let inverse = rigid.cholesky()?.inverse() * variance;
        all.fixed_view_mut::<6, 6>(0, 0).copy_from(&inverse);
        Some(all)
    }
}

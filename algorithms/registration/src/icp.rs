//! Iterative closest points in three metrics, with the scale fixed or free.
//!
//! Works on centred clouds. The kernel's width shrinks from what the start needs to what the
//! spacing of the points allows (graduated non-convexity), so that one loop serves rough and good
//! starts; meanwhile pairs beyond the part that overlaps are trimmed. With a free scale pairs are
//! sought from both clouds and their cost is symmetric: from one side alone a cloud that shrinks
//! to a spot would fit perfectly.

mod closed_form;
mod covariance;
mod linearise;
mod metric;
mod pairs;
mod trim;

use geometry::{RobustKernel, Similarity, Tangent7};

use crate::alignment::{Metric, Source, Target};
use crate::cloud::{ShapedCloud, to_single};

pub(crate) use linearise::{NormalEquations, cost};
pub(crate) use pairs::{Pair, Pairing, overlap_of_target};

/// The kernel's width narrows by this factor in each iteration.
const NARROWING: f64 = 0.6;
/// The final width in units of the spacing of the coarser cloud.
const FINAL_WIDTH_SPACINGS: f64 = 5.0;
/// So many points of the source make the first steps of large clouds.
const COARSE_POINT_COUNT: usize = 1000;
/// So many points of the source tell the width at the start.
const START_POINT_COUNT: usize = 300;
/// Pairs beyond this many widths are not sought.
const GATE_WIDTHS: f64 = 2.0;
/// Sparse clouds swing between pairings for ever; a last step below this share of the kernel's
/// width is good enough.
const SETTLED_WIDTHS: f64 = 0.005;
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
    /// Those of the last step.
    pub pairing: Pairing,
    /// Pairs farther apart are none.
    pub gate: f64,
    pub kernel: RobustKernel,
    pub iteration_count: usize,
    pub converged: bool,
    pub scale_bounded: bool,
}

/// The width of the kernel at the end.
fn final_width(source: &ShapedCloud, target: &ShapedCloud, scale: f64) -> f64 {
    FINAL_WIDTH_SPACINGS * (source.spacing * scale).max(target.spacing).max(1e-9)
}

/// `None` if the pairs do not determine a step.
///
/// Large clouds are first aligned by a part of their points.
pub(crate) fn iterate(
    source: &ShapedCloud,
    target: &ShapedCloud,
    start: &Similarity<Target, Source>,
    settings: &IcpSettings,
) -> Option<Icp> {
    let gate_max = settings.max_distance.unwrap_or(f64::INFINITY);
    let narrowest = final_width(source, target, start.scale());
    let width = start_width(source, target, start, gate_max).max(narrowest);
    let reach = settings.with_scale.then_some(GATE_WIDTHS * width);
    let mut icp = Icp {
        target_from_source: *start,
        pairing: Pairing::new(source, target, start, reach),
        gate: gate_max,
        kernel: RobustKernel::GemanMcClure { threshold: width },
        iteration_count: 0,
        converged: false,
        scale_bounded: false,
    };
    let mut widths = Widths { width, narrowest };
    if source.points.len() >= 2 * COARSE_POINT_COUNT {
        let all = icp.pairing;
        icp.pairing = all.sampled(COARSE_POINT_COUNT);
        icp.settle(source, target, start, settings, &mut widths)?;
        let sampled = std::mem::replace(&mut icp.pairing, all);
        icp.pairing.learn_from(&sampled, COARSE_POINT_COUNT);
        icp.converged = false;
    }
    icp.settle(source, target, start, settings, &mut widths)?;
    Some(icp)
}

/// How wide the kernel is, and will be in the end.
struct Widths {
    width: f64,
    narrowest: f64,
}

impl Icp {
    /// Steps until they are small, or there are too many of them.
    fn settle(
        &mut self,
        source: &ShapedCloud,
        target: &ShapedCloud,
        start: &Similarity<Target, Source>,
        settings: &IcpSettings,
        widths: &mut Widths,
    ) -> Option<()> {
        let gate_max = settings.max_distance.unwrap_or(f64::INFINITY);
        let narrowest = widths.narrowest;
        while self.iteration_count < settings.iteration_limit
            && !self.converged
            && !self.scale_bounded
        {
            self.iteration_count += 1;
            let gate = (GATE_WIDTHS * widths.width).min(gate_max);
            self.renew_pairs(source, target, gate, narrowest);
            self.kernel = RobustKernel::GemanMcClure {
                threshold: widths.width,
            };
            let step = self.step(source, target, settings)?;
            let ratio = self.target_from_source.scale() / start.scale();
            self.scale_bounded = !(1.0 / SCALE_FACTOR_MAX..SCALE_FACTOR_MAX).contains(&ratio);
            let moved = largest_move(&step, source.radius) * self.target_from_source.scale();
            let is_narrow = widths.width <= narrowest * 1.001;
            self.converged = is_narrow && moved < SETTLED_WIDTHS * narrowest;
            widths.width = (widths.width * NARROWING).max(narrowest);
        }
        Some(())
    }

    /// Pairs within the gate, without those beyond the part that overlaps.
    fn renew_pairs(
        &mut self,
        source: &ShapedCloud,
        target: &ShapedCloud,
        gate: f64,
        narrowest: f64,
    ) {
        let pairing = &mut self.pairing;
        pairing.renew(source, target, &self.target_from_source, gate);
        let trimmed = trim::distance(&pairing.pairs, pairing.seeking_count(), gate);
        self.gate = trimmed.max(narrowest).min(gate);
        let limit = self.gate * self.gate;
        pairing
            .pairs
            .retain(|pair| f64::from(pair.distance_squared) < limit);
    }

    /// Moves the alignment, and tells by how much.
    fn step(
        &mut self,
        source: &ShapedCloud,
        target: &ShapedCloud,
        settings: &IcpSettings,
    ) -> Option<Tangent7> {
        let before = self.target_from_source;
        let pairs = &self.pairing.pairs;
        let in_closed_form =
            settings.metric == Metric::Point && !source.knows_noise() && !target.knows_noise();
        if in_closed_form {
            let scale = (!settings.with_scale).then(|| before.scale());
            let after = closed_form::solve(source, target, pairs, self.kernel, scale)?;
            self.target_from_source = after;
            return Some((before.inverse() * after).log());
        }
        let metric = settings.metric;
        let normal = NormalEquations::sum(source, target, &before, pairs, metric, self.kernel);
        let step = normal.step(settings.with_scale)?;
        self.target_from_source = before.perturbed(&step);
        Some(step)
    }
}

/// Twice the distance within which three quarters of the source find a partner at the start.
fn start_width(
    source: &ShapedCloud,
    target: &ShapedCloud,
    start: &Similarity<Target, Source>,
    gate: f64,
) -> f64 {
    let mut squares = Vec::with_capacity(2 * START_POINT_COUNT);
    let stride = (source.points.len() / START_POINT_COUNT).max(1);
    let limit = (gate * gate) as f32;
    for point in source.points.iter().step_by(stride) {
        let found = target.tree.nearest(to_single(&(*start * *point)), limit);
        squares.extend(found.map(|found| found.distance_squared));
    }
    if squares.is_empty() {
        return 0.0;
    }
    let rank = squares.len() * 3 / 4;
    let (_, found, _) = squares.select_nth_unstable_by(rank, f32::total_cmp);
    2.0 * f64::from(*found).sqrt()
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
}

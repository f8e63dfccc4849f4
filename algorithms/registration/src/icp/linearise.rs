//! The normal equations of pairs, over `[ω; ν; ln s]`.

use geometry::{Matrix7, RobustKernel, Similarity, Tangent7};
use nalgebra::{Matrix3, Vector3};

use super::metric::{PairMetric, PlaneToPlane, PointToPlane, PointToPoint};
use super::pairs::Pair;
use crate::alignment::{Metric, Source, Target};
use crate::cloud::ShapedCloud;

/// Sums over all pairs, each whitened by its metric and weighted by the kernel.
///
/// The cost is `Σ w rᵀ Ω r / s`, with `r` in the target's unit: swapping the clouds does not
/// change it, so that no scale is preferred, and a cloud that shrinks or swells to nothing costs
/// ever more. The derivative by `ln s` then is along the midpoint of a pair. Up to the constant
/// scale at which it is linearised, which no step depends on.
#[derive(Clone, Debug, Default)]
pub(crate) struct NormalEquations {
    pub hessian: Matrix7,
    pub gradient: Tangent7,
}

/// One pair's part of the normal equations, in the target's axes: turned there together at the
/// end, which spares to turn each pair's information back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Term {
    /// From the target's axes' origin, but without the translation: a step turns and stretches
    /// the source about its own origin.
    point: Vector3<f64>,
    /// Of this and the partner.
    middle: Vector3<f64>,
    information: Matrix3<f64>,
    /// Information times residual.
    force: Vector3<f64>,
    cost: f64,
}

impl NormalEquations {
    pub fn sum(
        source: &ShapedCloud,
        target: &ShapedCloud,
        target_from_source: &Similarity<Target, Source>,
        pairs: &[Pair],
        metric: Metric,
        kernel: RobustKernel,
    ) -> Self {
        let mut sums = Sums::default();
        let add = |term: Term| sums.add(&term);
        terms(
            source,
            target,
            target_from_source,
            pairs,
            metric,
            kernel,
            add,
        );
        sums.assemble(target_from_source)
    }
}

/// The gradient of [`NormalEquations`] alone.
pub(crate) fn gradient(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    pairs: &[Pair],
    metric: Metric,
    kernel: RobustKernel,
) -> Tangent7 {
    let mut sum = Tangent7::zeros();
    let add = |term: Term| sum += term.gradient();
    terms(
        source,
        target,
        target_from_source,
        pairs,
        metric,
        kernel,
        add,
    );
    step_in_target(target_from_source).transpose() * sum
}

/// The cost of pairs that all count in full.
pub(crate) fn cost(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    pairs: &[Pair],
    metric: Metric,
) -> f64 {
    let kernel = RobustKernel::None;
    let mut cost = 0.0;
    let add = |term: Term| cost += term.cost;
    terms(
        source,
        target,
        target_from_source,
        pairs,
        metric,
        kernel,
        add,
    );
    cost
}

/// Calls `visit` with the term of each pair in turn.
pub(crate) fn terms(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    pairs: &[Pair],
    metric: Metric,
    kernel: RobustKernel,
    visit: impl FnMut(Term),
) {
    let clouds = (source, target);
    match metric {
        Metric::Point => {
            terms_of::<PointToPoint>(clouds, target_from_source, pairs, kernel, visit);
        }
        Metric::Plane => {
            terms_of::<PointToPlane>(clouds, target_from_source, pairs, kernel, visit);
        }
        Metric::Gicp => {
            terms_of::<PlaneToPlane>(clouds, target_from_source, pairs, kernel, visit);
        }
    }
}

fn terms_of<M: PairMetric>(
    (source, target): (&ShapedCloud, &ShapedCloud),
    target_from_source: &Similarity<Target, Source>,
    pairs: &[Pair],
    kernel: RobustKernel,
    mut visit: impl FnMut(Term),
) {
    let linear = target_from_source.linear_matrix();
    let translation = target_from_source.translation();
    let rotation = linear / target_from_source.scale();
    for pair in pairs {
        let (source_idx, target_idx) = (pair.source_idx as usize, pair.target_idx as usize);
        let point = linear * source.points[source_idx];
        let residual = target.points[target_idx] - point - translation;
        let (source_shape, target_shape) = (&source.shapes[source_idx], &target.shapes[target_idx]);
        let weight = kernel.weight(f64::from(pair.distance_squared));
        let information = M::information(source_shape, target_shape, &rotation) * weight;
        let force = information * residual;
        visit(Term {
            point,
            middle: point + residual * 0.5,
            information,
            force,
            cost: residual.dot(&force),
        });
    }
}

impl Term {
    /// `−Lᵀ Ω r`, where `L = [−x̂, 1, middle]` is how a step in the target's axes moves the point.
    pub fn gradient(&self) -> Tangent7 {
        let turn = self.point.cross(&self.force);
        let mut gradient = Tangent7::zeros();
        gradient.fixed_rows_mut::<3>(0).copy_from(&-turn);
        gradient.fixed_rows_mut::<3>(3).copy_from(&-self.force);
        gradient[6] = -self.middle.dot(&self.force);
        gradient
    }
}

/// The parts of the Hessian by rotation, translation and scale.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sums {
    turn_turn: Matrix3<f64>,
    turn_move: Matrix3<f64>,
    move_move: Matrix3<f64>,
    turn_scale: Vector3<f64>,
    move_scale: Vector3<f64>,
    scale_scale: f64,
    turn_force: Vector3<f64>,
    force: Vector3<f64>,
    scale_force: f64,
}

impl Sums {
    #[inline]
    pub fn add(&mut self, term: &Term) {
        let turned = crossed(&term.point, &term.information);
        self.turn_turn += crossed(&term.point, &turned.transpose());
        self.turn_move += turned;
        self.move_move += term.information;
        let stretched = term.information * term.middle;
        self.turn_scale += term.point.cross(&stretched);
        self.move_scale += stretched;
        self.scale_scale += term.middle.dot(&stretched);
        self.turn_force += term.point.cross(&term.force);
        self.force += term.force;
        self.scale_force += term.middle.dot(&term.force);
    }

    pub fn assemble(&self, target_from_source: &Similarity<Target, Source>) -> NormalEquations {
        let mut sums = NormalEquations::default();
        let hessian = &mut sums.hessian;
        hessian
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.turn_turn);
        hessian
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&self.turn_move);
        hessian
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&self.turn_move.transpose());
        hessian
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&self.move_move);
        for (start, column) in [(0, &self.turn_scale), (3, &self.move_scale)] {
            hessian.fixed_view_mut::<3, 1>(start, 6).copy_from(column);
            hessian
                .fixed_view_mut::<1, 3>(6, start)
                .copy_from(&column.transpose());
        }
        hessian[(6, 6)] = self.scale_scale;
        sums.gradient
            .fixed_rows_mut::<3>(0)
            .copy_from(&-self.turn_force);
        sums.gradient.fixed_rows_mut::<3>(3).copy_from(&-self.force);
        sums.gradient[6] = -self.scale_force;
        let turned = step_in_target(target_from_source);
        sums.hessian = turned.transpose() * sums.hessian * turned;
        sums.gradient = turned.transpose() * sums.gradient;
        sums
    }
}

/// A step of the source as one in the target's axes: `diag(R, s R, 1)`.
pub(crate) fn step_in_target(target_from_source: &Similarity<Target, Source>) -> Matrix7 {
    let linear = target_from_source.linear_matrix();
    let mut step = Matrix7::identity();
    step.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(linear / target_from_source.scale()));
    step.fixed_view_mut::<3, 3>(3, 3).copy_from(&linear);
    step
}

/// The cross product of a vector with each column.
#[inline]
fn crossed(vector: &Vector3<f64>, matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let column = |idx: usize| vector.cross(&matrix.column(idx));
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::Cloud;
    use crate::icp::pairs::Pairing;

    /// Goal: the gradient is that of the cost. Method: central differences of the cost over all
    /// seven axes, with pairs and weights held, in the two metrics whose information does not turn
    /// with the source.
    #[test]
    fn gradient_agrees_with_differences() {
        let grid = |count: usize| {
            (0..count).map(|idx| {
                let (x, y) = ((idx % 9) as f64 * 0.1, (idx / 9) as f64 * 0.1);
                Vector3::new(x, y, 0.3 * (3.0 * x).sin() * y)
            })
        };
        let source = ShapedCloud::new(&Cloud::from_points(grid(81).collect()), None);
        let target = ShapedCloud::new(&Cloud::from_points(grid(90).collect()), None);
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.05, 0.08));
        let start: Similarity<Target, Source> =
            Similarity::new(1.1, rotation, Vector3::new(0.02, 0.01, -0.03));
        let mut pairing = Pairing::new(&source, &target, &start, Some(1.0));
        pairing.renew(&source, &target, &start, 1.0);
        for metric in [Metric::Point, Metric::Plane] {
            let pairs = &pairing.pairs;
            let cost = |at: &Similarity<Target, Source>| {
                cost(&source, &target, at, pairs, metric) / at.scale()
            };
            let kernel = RobustKernel::None;
            let sum = NormalEquations::sum(&source, &target, &start, pairs, metric, kernel);
            let alone = gradient(&source, &target, &start, pairs, metric, kernel);
            assert!((alone - sum.gradient).amax() < 1e-9 * sum.gradient.amax());
            let analytic = sum.gradient / start.scale();
            for axis in 0..7 {
                let mut step = Tangent7::zeros();
                step[axis] = 1e-6;
                let above = cost(&start.perturbed(&step));
                let below = cost(&start.perturbed(&-step));
                // The cost is r², its gradient 2 Jᵀ r.
                let difference = (above - below) / 2e-6 / 2.0;
                assert!(
                    (difference - analytic[axis]).abs() < 1e-6 * (1.0 + difference.abs()),
                    "{metric:?} {axis}: {difference} {}",
                    analytic[axis]
                );
            }
        }
    }
}

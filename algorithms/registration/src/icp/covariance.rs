//! How well an alignment is known.

use geometry::{Matrix7, Tangent7};
use nalgebra::{DMatrix, SMatrix, SymmetricEigen, Vector3};

use super::Icp;
use super::linearise::{NormalEquations, Sums, Term, step_in_target, terms};
use super::pairs::Pair;
use crate::alignment::Metric;
use crate::cloud::ShapedCloud;

/// So many points of a cloud tell how far new partners give way; more where only points hold,
/// which give way most.
const SAMPLE_COUNT: usize = 200;
const SAMPLE_COUNT_OF_POINTS: usize = 500;
/// How far points are moved to see that, in spacings.
const TRIAL_SPACINGS: f64 = 0.5;
/// Nor are they turned (radians) or stretched (logarithm) by more, where the whole cloud is smaller
/// than the other's spacing.
const TRIAL_TURN_MAX: f64 = 0.5;
/// Points that slide keep this share of their hold at least.
const HOLD_MIN: f64 = 0.05;
/// Pairs within cubes of this many spacings share their normals and the bend of their surface.
const CLUSTER_SPACINGS: f64 = 8.0;

impl Icp {
    /// The covariance of the alignment of the centred clouds; zero in the scale where that is
    /// fixed. `None` if a direction is not determined at all.
    ///
    /// `F⁻¹ (Σ g gᵀ) F⁻¹` with the gradients `g` of clusters of neighbouring pairs (Liang and
    /// Zeger 1986): what the residuals of a cluster have in common counts in full, so that a
    /// surface seen by more points is not pretended to be known better than its normals are. `F`
    /// is the Hessian less what points give way when they may choose other partners.
    pub fn covariance(
        &self,
        source: &ShapedCloud,
        target: &ShapedCloud,
        metric: Metric,
        with_scale: bool,
    ) -> Option<Matrix7> {
        let alignment = &self.target_from_source;
        let edge = CLUSTER_SPACINGS * target.spacing.max(source.spacing * alignment.scale());
        let mut clustered: Vec<([i32; 3], Pair)> = Vec::with_capacity(self.pairing.pairs.len());
        clustered.extend(self.pairing.pairs.iter().map(|pair| {
            let place = &target.points[pair.target_idx as usize];
            (cube(place, edge), *pair)
        }));
        clustered.sort_unstable_by_key(|(cube, pair)| (*cube, pair.source_idx, pair.target_idx));
        let pairs: Vec<Pair> = clustered.iter().map(|(_, pair)| *pair).collect();
        let mut sums = Sums::default();
        let mut spread = Matrix7::zeros();
        let mut cluster = Tangent7::zeros();
        let mut cluster_count = 0;
        let mut idx = 0;
        let collect = |term: Term| {
            sums.add(&term);
            cluster += term.gradient();
            let next = clustered.get(idx + 1);
            if next.is_none_or(|next| next.0 != clustered[idx].0) {
                spread += cluster * cluster.transpose();
                cluster.fill(0.0);
                cluster_count += 1;
            }
            idx += 1;
        };
        terms(
            source,
            target,
            alignment,
            &pairs,
            metric,
            self.kernel,
            collect,
        );
        let turned = step_in_target(alignment);
        let spread = turned.transpose() * spread * turned;
        let normal = sums.assemble(alignment);
        let freedom = if with_scale { 7 } else { 6 };
        // What the fit itself has taken up of the spread, as the jackknife counts it.
        let rest = (f64::from(cluster_count) - freedom as f64).max(1.0);
        let unbiased = (f64::from(cluster_count) / rest).powi(2);
        let given = self.hold(source, target, metric, freedom);
        sandwich(&normal.hessian, &given, &(spread * unbiased), freedom)
    }

    /// How the gradient changes as the clouds move and partners are chosen anew, by differences,
    /// and the Hessian; both over a sample of the points.
    fn hold(
        &self,
        source: &ShapedCloud,
        target: &ShapedCloud,
        metric: Metric,
        freedom: usize,
    ) -> [Matrix7; 2] {
        let alignment = &self.target_from_source;
        let mut pairing = self.pairing.sampled(match metric {
            Metric::Point => SAMPLE_COUNT_OF_POINTS,
            Metric::Plane | Metric::Gicp => SAMPLE_COUNT,
        });
        let mut sum_at = |step: &Tangent7| {
            let moved = alignment.perturbed(step);
            pairing.renew(source, target, &moved, self.gate);
            NormalEquations::sum(source, target, &moved, &pairing.pairs, metric, self.kernel)
        };
        let hessian = sum_at(&Tangent7::zeros()).hessian;
        let step_m = TRIAL_SPACINGS * source.spacing.max(target.spacing / alignment.scale());
        let turn = (step_m / source.radius).min(TRIAL_TURN_MAX);
        let steps = [turn, step_m, turn];
        let mut change = Matrix7::zeros();
        for axis in 0..freedom {
            let mut step = Tangent7::zeros();
            step[axis] = steps[axis / 3];
            let apart = sum_at(&step).gradient - sum_at(&-step).gradient;
            change.set_column(axis, &(apart / (2.0 * step[axis])));
        }
        [change, hessian]
    }
}

fn cube(point: &Vector3<f64>, edge: f64) -> [i32; 3] {
    std::array::from_fn(|axis| (point[axis] / edge).floor() as i32)
}

/// `F⁻¹ B F⁻¹` over the first `freedom` directions, where `F` is the Hessian times the share of
/// its hold that is left.
fn sandwich(
    hessian: &Matrix7,
    [anew, kept]: &[Matrix7; 2],
    spread: &Matrix7,
    freedom: usize,
) -> Option<Matrix7> {
    let part = |matrix: &Matrix7| -> DMatrix<f64> {
        let part = matrix.view((0, 0), (freedom, freedom)).into_owned();
        (&part + part.transpose()) * 0.5
    };
    let whole = part(hessian).cholesky()?.l();
    // In the sample's own whitened directions, so that its size does not matter.
    let white = part(kept).cholesky()?.l().try_inverse()?;
    let held = SymmetricEigen::new(&white * part(anew) * white.transpose());
    let shares = held.eigenvalues.map(|share| share.clamp(HOLD_MIN, 1.0));
    let held = &held.eigenvectors * DMatrix::from_diagonal(&shares) * held.eigenvectors.transpose();
    let inverse = (&whole * held * whole.transpose()).cholesky()?.inverse();
    let covariance = &inverse * part(spread) * &inverse;
    let mut all: SMatrix<f64, 7, 7> = SMatrix::zeros();
    all.view_mut((0, 0), (freedom, freedom))
        .copy_from(&covariance);
    Some((all + all.transpose()) * 0.5)
}

//! How well an alignment is known.

use geometry::{Matrix7, Tangent7};
use nalgebra::{DMatrix, SMatrix, SymmetricEigen, Vector3};

use super::Icp;
use super::linearise::{NormalEquations, Sums, Term, gradient, step_in_target, terms};
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
/// Up to the first number of clusters these do not tell how much their pairs have in common; from
/// the second on they do.
const CLUSTER_COUNTS: [f64; 2] = [7.0, 21.0];
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
        let all = &self.pairing.pairs;
        let cube_of = |pair: &Pair| cube(&target.points[pair.target_idx as usize], edge);
        let (pairs, cluster_sizes) = clustered(all, cube_of);
        let mut sums = Sums::default();
        let mut spread = Spread::of(cluster_sizes.len());
        let mut clusters = cluster_sizes.into_iter();
        let mut left_count = 0;
        let collect = |term: Term| {
            sums.add(&term);
            if left_count == 0 {
                left_count = clusters.next().unwrap_or(usize::MAX);
                spread.begin_cluster();
            }
            left_count -= 1;
            spread.add(&term.gradient());
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
        let normal = sums.assemble(alignment);
        let freedom = if with_scale { 7 } else { 6 };
        let turned = step_in_target(alignment);
        let spread = turned.transpose() * spread.estimate(freedom) * turned;
        let given = self.hold(source, target, metric, freedom);
        sandwich(&normal.hessian, &given, &spread, freedom)
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
        pairing.renew(source, target, alignment, self.gate);
        let (pairs, kernel) = (&pairing.pairs, self.kernel);
        let normal = NormalEquations::sum(source, target, alignment, pairs, metric, kernel);
        let gradient_at = |step: &Tangent7| {
            let moved = alignment.perturbed(step);
            // From rest partners are nearer than from the last trial.
            let mut pairing = pairing.clone();
            pairing.renew(source, target, &moved, self.gate);
            gradient(source, target, &moved, &pairing.pairs, metric, kernel)
        };
        let step_m = TRIAL_SPACINGS * source.spacing.max(target.spacing / alignment.scale());
        let turn = (step_m / source.radius).min(TRIAL_TURN_MAX);
        let steps = [turn, step_m, turn];
        let mut change = Matrix7::zeros();
        for axis in 0..freedom {
            let mut step = Tangent7::zeros();
            step[axis] = steps[axis / 3];
            let apart = gradient_at(&step) - gradient_at(&-step);
            change.set_column(axis, &(apart / (2.0 * step[axis])));
        }
        [change, normal.hessian]
    }
}

/// The pairs cube by cube, and how many are in each: neighbours come one after the other, so that
/// there are few runs to sort.
fn clustered(all: &[Pair], cube_of: impl Fn(&Pair) -> u64) -> (Vec<Pair>, Vec<usize>) {
    let mut runs: Vec<(u64, usize, usize)> = Vec::with_capacity(all.len());
    for (idx, pair) in all.iter().enumerate() {
        let cube = cube_of(pair);
        match runs.last_mut() {
            Some((last, _, end)) if *last == cube => *end = idx + 1,
            _ => runs.push((cube, idx, idx + 1)),
        }
    }
    runs.sort_unstable();
    let mut pairs = Vec::with_capacity(all.len());
    let mut sizes = Vec::with_capacity(runs.len());
    for cluster in runs.chunk_by(|a, b| a.0 == b.0) {
        let before = pairs.len();
        for (_, start, end) in cluster {
            pairs.extend_from_slice(&all[*start..*end]);
        }
        sizes.push(pairs.len() - before);
    }
    (pairs, sizes)
}

/// What the gradients of all pairs add up to by chance.
#[derive(Default)]
struct Spread {
    of_clusters: Matrix7,
    of_pairs: Matrix7,
    pair_count: f64,
    cluster_count: f64,
    cluster: Tangent7,
    /// So much of what all pairs might have in common is taken, 0 to 1.
    doubt: f64,
}

impl Spread {
    fn of(cluster_count: usize) -> Self {
        let [few, enough] = CLUSTER_COUNTS;
        Self {
            doubt: ((enough - cluster_count as f64) / (enough - few)).clamp(0.0, 1.0),
            ..Self::default()
        }
    }

    fn begin_cluster(&mut self) {
        self.of_clusters += self.cluster * self.cluster.transpose();
        self.cluster.fill(0.0);
        self.cluster_count += 1.0;
    }

    fn add(&mut self, gradient: &Tangent7) {
        self.cluster += gradient;
        if self.doubt > 0.0 {
            self.of_pairs += gradient * gradient.transpose();
        }
        self.pair_count += 1.0;
    }

    /// Of few clusters, whose sums nearly cancel out where the fit ended, the pairs are taken to
    /// have all in common instead.
    fn estimate(mut self, freedom: usize) -> Matrix7 {
        self.begin_cluster();
        let cluster_count = self.cluster_count - 1.0;
        // What the fit itself has taken up of the spread, as the jackknife counts it.
        let rest = (cluster_count - freedom as f64).max(1.0);
        let unbiased = self.of_clusters * (cluster_count / rest).powi(2);
        let in_common = self.of_pairs * (self.pair_count / cluster_count.max(1.0));
        unbiased * (1.0 - self.doubt) + in_common * self.doubt
    }
}

/// Cubes are numbered along an axis by so many bits, from the middle; those beyond are one.
const CUBE_BITS: u32 = 21;

fn cube(point: &Vector3<f64>, edge: f64) -> u64 {
    let middle = f64::from(1_u32 << (CUBE_BITS - 1));
    point.iter().fold(0, |number, value| {
        // Casts saturate, at zero too.
        let along = (value / edge + middle) as u64;
        (number << CUBE_BITS) | along.min((1 << CUBE_BITS) - 1)
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    /// So many clusters of ten equal gradients along one axis each, and what they say of the axes.
    fn variances(cluster_count: usize) -> Tangent7 {
        let mut spread = Spread::of(cluster_count);
        for cluster in 0..cluster_count {
            spread.begin_cluster();
            for _ in 0..10 {
                spread.add(&Tangent7::ith(cluster % 7, 1.0));
            }
        }
        spread.estimate(6).diagonal()
    }

    #[test]
    fn pairs_of_a_cube_come_together() {
        let pair = |source_idx| Pair {
            source_idx,
            target_idx: source_idx % 3,
            distance_squared: 0.0,
        };
        let all: Vec<Pair> = (0..8).map(pair).collect();
        let (pairs, sizes) = clustered(&all, |pair| u64::from(pair.target_idx) % 2);
        let order: Vec<u32> = pairs.iter().map(|pair| pair.source_idx).collect();
        assert_eq!((order, sizes), (vec![0, 2, 3, 5, 6, 1, 4, 7], vec![5, 3]));
    }

    /// Goal: what pairs have in common counts, whether there are clusters enough to tell or not.
    #[test]
    fn pairs_that_agree_are_no_more_certain_together() {
        for (cluster_count, unbiased) in [(7, 1.0), (700, (700.0_f64 / 694.0).powi(2))] {
            let each = 100.0 * unbiased * (cluster_count / 7) as f64;
            let found = variances(cluster_count);
            assert!((found - Tangent7::repeat(each)).amax() < 1e-9, "{found}");
        }
    }

    /// Goal: clusters that cancel out, as few do where a fit ended, do not seem certain.
    #[test]
    fn two_opposite_clusters_are_doubted() {
        let mut spread = Spread::of(2);
        for side in [1.0, -1.0] {
            spread.begin_cluster();
            for axis in 0..7 {
                spread.add(&Tangent7::ith(axis, side));
            }
        }
        let doubted = spread.estimate(6);
        assert!(doubted.symmetric_eigenvalues().min() > 1.0, "{doubted}");
    }
}

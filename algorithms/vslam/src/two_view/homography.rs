//! The map that a plane (or a pure rotation) induces between two views.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::null_space::null_space;
use super::pair::{CHI_SQUARED_2_P95, Pair};
use super::ransac::Model;

/// A homography with its inverse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Homography {
    pub second_from_first: Matrix3<f64>,
    pub first_from_second: Matrix3<f64>,
}

impl Homography {
    pub(super) fn new(second_from_first: Matrix3<f64>) -> Option<Self> {
        let first_from_second = second_from_first.try_inverse()?;
        first_from_second
            .iter()
            .all(|entry| entry.is_finite())
            .then_some(Self {
                second_from_first,
                first_from_second,
            })
    }

    /// The poses, up to four, from which a plane looks like this: Ma et al. 2004, section 5.3.
    ///
    /// Empty for a pure rotation.
    pub(super) fn poses(&self, pairs: &[Pair]) -> Vec<Transform<Camera, Camera>> {
        let Some(euclidean) = self.euclidean(pairs) else {
            return Vec::new();
        };
        let eigen = (euclidean.transpose() * euclidean).symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [largest, _, smallest] = order.map(|i| eigen.eigenvalues[i]);
        let [v1, v2, v3] = order.map(|i| eigen.eigenvectors.column(i).into_owned());
        // The middle one is one; noise may push the others past it.
        let (above, below) = (
            (largest - 1.0).max(0.0).sqrt(),
            (1.0 - smallest).max(0.0).sqrt(),
        );
        let spread = (largest - smallest).sqrt();
        if spread < 1e-6 {
            return Vec::new();
        }
        let in_plane = [
            (v1 * below + v3 * above) / spread,
            (v1 * below - v3 * above) / spread,
        ];
        let frame = |a: Vector3<f64>, b: Vector3<f64>| Matrix3::from_columns(&[a, b, a.cross(&b)]);
        let mut poses = Vec::with_capacity(4);
        for direction in in_plane {
            let matrix =
                frame(euclidean * v2, euclidean * direction) * frame(v2, direction).transpose();
            let rotation =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
            let normal = v2.cross(&direction);
            let translation = (euclidean - rotation.to_rotation_matrix().matrix()) * normal;
            let Some(translation) = translation.try_normalize(1e-9) else {
                continue;
            };
            poses.push(Transform::new(rotation, translation));
            poses.push(Transform::new(rotation, -translation));
        }
        poses
    }

    /// Scaled so that the middle singular value is one, and signed so that points keep in front.
    fn euclidean(&self, pairs: &[Pair]) -> Option<Matrix3<f64>> {
        let mut singular_values = self.second_from_first.singular_values();
        singular_values.as_mut_slice().sort_by(f64::total_cmp);
        let scaled = self.second_from_first / singular_values[1];
        let front_count = pairs
            .iter()
            .filter(|pair| pair.second.dot(&(scaled * pair.first)) > 0.0)
            .count();
        let sign = if 2 * front_count >= pairs.len() {
            1.0
        } else {
            -1.0
        };
        scaled
            .iter()
            .all(|entry| entry.is_finite())
            .then_some(scaled * sign)
    }
}

impl Model for Homography {
    const SAMPLE_SIZE: usize = 4;
    const CHI_SQUARED_MAX: f64 = CHI_SQUARED_2_P95;
    const DIMENSION: f64 = 2.0;
    const PARAMETER_COUNT: f64 = 8.0;

    fn fit(pairs: &[Pair], sample: &[usize], models: &mut Vec<Self>) {
        let mut rows = [SVector::<f64, 9>::zeros(); 8];
        for (i, idx) in sample.iter().enumerate() {
            [rows[2 * i], rows[2 * i + 1]] = constraint_rows(&pairs[*idx]);
        }
        let solution = null_space::<8, 1>(rows);
        models.extend(solution.and_then(|[entries]| Self::new(from_entries(&entries))));
    }

    /// The squared distance to the nearest pair that fits, from the transfer errors both ways.
    fn residual_squared(&self, pair: &Pair) -> f64 {
        let in_second = self.second_from_first * pair.first;
        let in_first = self.first_from_second * pair.second;
        let forward = in_second.xy() / in_second.z - pair.second.xy();
        let backward = in_first.xy() / in_first.z - pair.first.xy();
        // Each error has the noise of both views in it: twice the variance, and counted twice.
        0.25 * (forward.norm_squared() + backward.norm_squared())
    }

    /// Least squares of the algebraic error over the inliers, weighted to be nearly geometric.
    fn improve(&self, pairs: &[Pair], sigma: f64) -> Option<Self> {
        let mut model = *self;
        // A sample of four extrapolates badly: start wide.
        for factor in [4.0, 2.0, 1.0, 1.0] {
            let squared_max = factor * sigma * sigma * Self::CHI_SQUARED_MAX;
            let scale = 1.0 / model.second_from_first.norm();
            let mut normal = SMatrix::<f64, 9, 9>::zeros();
            for pair in pairs {
                if model.residual_squared(pair) > squared_max {
                    continue;
                }
                let depth = (model.second_from_first.row(2) * pair.first)[0] * scale;
                for row in constraint_rows(pair) {
                    let row = row / depth;
                    normal += row * row.transpose();
                }
            }
            let eigen = normal.symmetric_eigen();
            let entries = eigen
                .eigenvectors
                .column(eigen.eigenvalues.imin())
                .into_owned();
            model = Self::new(from_entries(&entries))?;
        }
        Some(model)
    }
}

/// The two rows by which a pair constrains the entries of the matrix, row-major.
fn constraint_rows(pair: &Pair) -> [SVector<f64, 9>; 2] {
    let (p, q) = (&pair.first, &pair.second);
    [
        SVector::from([
            p.x,
            p.y,
            p.z,
            0.0,
            0.0,
            0.0,
            -q.x * p.x,
            -q.x * p.y,
            -q.x * p.z,
        ]),
        SVector::from([
            0.0,
            0.0,
            0.0,
            p.x,
            p.y,
            p.z,
            -q.y * p.x,
            -q.y * p.y,
            -q.y * p.z,
        ]),
    ]
}

fn from_entries(entries: &SVector<f64, 9>) -> Matrix3<f64> {
    Matrix3::from_row_slice(entries.as_slice())
}

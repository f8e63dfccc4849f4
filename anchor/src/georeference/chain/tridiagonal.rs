//! Normal equations `H x = b` of a chain: 7×7 blocks on the diagonal and beside it.

use geometry::{Matrix7, Tangent7};

#[derive(Clone, Debug)]
pub(super) struct Tridiagonal {
    diagonal: Vec<Matrix7>,
    /// `H[i, i + 1]`.
    upper: Vec<Matrix7>,
    right: Vec<Tangent7>,
}

impl Tridiagonal {
    pub(super) fn new(node_count: usize) -> Self {
        Self {
            diagonal: vec![Matrix7::zeros(); node_count],
            upper: vec![Matrix7::zeros(); node_count.saturating_sub(1)],
            right: vec![Tangent7::zeros(); node_count],
        }
    }

    /// Adds a term of one node: its Hessian and its share of the right-hand side.
    pub(super) fn add_diagonal(&mut self, idx: usize, hessian: &Matrix7, right: &Tangent7) {
        self.diagonal[idx] += hessian;
        self.right[idx] += right;
    }

    /// Adds the term `eᵀ W e` of the nodes `idx` and `idx + 1`, where the derivative of `e` to the
    /// second is the identity.
    pub(super) fn add_pair(
        &mut self,
        idx: usize,
        d_error_d_first: &Matrix7,
        weight: &Matrix7,
        error: &Tangent7,
    ) {
        let weighted = d_error_d_first.transpose() * weight;
        self.diagonal[idx] += weighted * d_error_d_first;
        self.diagonal[idx + 1] += weight;
        self.upper[idx] += weighted;
        self.right[idx] -= weighted * error;
        self.right[idx + 1] -= weight * error;
    }

    /// The solution, by elimination from the first node to the last and back.
    pub(super) fn solve(&mut self) -> Option<Vec<Tangent7>> {
        let pivots = self.eliminate()?;
        let mut steps = vec![Tangent7::zeros(); self.diagonal.len()];
        for idx in (0..steps.len()).rev() {
            let mut right = self.right[idx];
            if let Some(next) = steps.get(idx + 1) {
                right -= self.upper[idx] * next;
            }
            steps[idx] = pivots[idx] * right;
        }
        Some(steps)
    }

    /// The blocks on the diagonal of `H⁻¹`, from the last node to the first.
    pub(super) fn marginals(&mut self) -> Option<Vec<Matrix7>> {
        let mut covariances = self.eliminate()?;
        for idx in (0..covariances.len().saturating_sub(1)).rev() {
            let gain = covariances[idx] * self.upper[idx];
            let from_next = gain * covariances[idx + 1] * gain.transpose();
            let covariance = covariances[idx] + from_next;
            covariances[idx] = (covariance + covariance.transpose()) * 0.5;
        }
        Some(covariances)
    }

    /// The logarithm of the determinant of `H`.
    pub(super) fn log_determinant(&mut self) -> Option<f64> {
        let pivots = self.eliminate()?;
        Some(-pivots.iter().map(|one| one.determinant().ln()).sum::<f64>())
    }

    /// Eliminates each node from the next; gives the inverses of the pivots.
    fn eliminate(&mut self) -> Option<Vec<Matrix7>> {
        let mut pivots: Vec<Matrix7> = Vec::with_capacity(self.diagonal.len());
        for idx in 0..self.diagonal.len() {
            if idx > 0 {
                let factor = self.upper[idx - 1].transpose() * pivots[idx - 1];
                self.diagonal[idx] -= factor * self.upper[idx - 1];
                let carried = factor * self.right[idx - 1];
                self.right[idx] -= carried;
            }
            let pivot = (self.diagonal[idx] + self.diagonal[idx].transpose()) * 0.5;
            pivots.push(pivot.cholesky()?.inverse());
        }
        Some(pivots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: elimination gives what the dense inverse gives. Method: a chain of four nodes with
    /// arbitrary couplings, solved both ways; the tolerance is rounding over its conditioning.
    #[test]
    fn agrees_with_the_dense_inverse() {
        let node_count = 4;
        let mut system = Tridiagonal::new(node_count);
        let value = |seed: usize| ((seed * 7919 + 13) % 101) as f64 / 101.0 - 0.5;
        for idx in 0..node_count {
            let weight = Matrix7::identity() * (1.0 + idx as f64);
            let right = Tangent7::from_fn(|row, _| value(row + 10 * idx));
            system.add_diagonal(idx, &weight, &right);
        }
        for idx in 0..node_count - 1 {
            let jacobian = Matrix7::from_fn(|row, column| value(row * 7 + column + idx));
            let error = Tangent7::from_fn(|row, _| value(row + 31 * idx));
            system.add_pair(idx, &jacobian, &(Matrix7::identity() * 3.0), &error);
        }
        let mut dense = nalgebra::DMatrix::zeros(28, 28);
        let mut right = nalgebra::DVector::zeros(28);
        for idx in 0..node_count {
            dense
                .view_mut((7 * idx, 7 * idx), (7, 7))
                .copy_from(&system.diagonal[idx]);
            right.rows_mut(7 * idx, 7).copy_from(&system.right[idx]);
        }
        for idx in 0..node_count - 1 {
            let upper = system.upper[idx];
            dense
                .view_mut((7 * idx, 7 * idx + 7), (7, 7))
                .copy_from(&upper);
            dense
                .view_mut((7 * idx + 7, 7 * idx), (7, 7))
                .copy_from(&upper.transpose());
        }
        let log_determinant = dense.determinant().ln();
        let inverse = dense.try_inverse().unwrap();
        let expected = &inverse * right;
        let mut copy = system.clone();
        let (steps, covariances) = (system.solve().unwrap(), copy.clone().marginals().unwrap());
        assert!((copy.log_determinant().unwrap() - log_determinant).abs() < 1e-10);
        for idx in 0..node_count {
            assert!((steps[idx] - expected.rows(7 * idx, 7)).norm() < 1e-10);
            let block = inverse.view((7 * idx, 7 * idx), (7, 7));
            assert!((covariances[idx] - block).norm() < 1e-10);
        }
    }
}

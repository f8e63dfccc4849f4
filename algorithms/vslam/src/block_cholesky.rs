//! Symmetric positive definite systems of square blocks, stored within their envelope.

use nalgebra::{SMatrix, SVector};

/// The lower triangle of a symmetric matrix of `N × N` blocks; row `i` begins at its first block
/// that is not zero, and nothing before that fills in when it is factorised.
///
/// Memory is kept when the shape changes, so that a system of known size allocates once.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockEnvelope<const N: usize> {
    blocks: Vec<SMatrix<f64, N, N>>,
    rows: Vec<Row>,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    first_column: usize,
    /// Where the block of column zero would be: blocks are found by adding the column.
    start: usize,
}

/// The matrix is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NotPositiveDefinite;

impl<const N: usize> BlockEnvelope<N> {
    /// Makes room for rows that begin at these columns, each at most its own index.
    pub(crate) fn reshape(&mut self, first_columns: impl Iterator<Item = usize>) {
        self.rows.clear();
        let mut block_count = 0;
        for (row_idx, first_column) in first_columns.enumerate() {
            assert!(
                first_column <= row_idx,
                "a row begins at or before its diagonal"
            );
            // Each earlier row holds at least its diagonal, so this does not underflow.
            let start = block_count - first_column;
            self.rows.push(Row {
                first_column,
                start,
            });
            block_count += row_idx + 1 - first_column;
        }
        self.blocks.clear();
        self.blocks.resize(block_count, SMatrix::zeros());
    }

    pub(crate) fn set_zero(&mut self) {
        self.blocks.fill(SMatrix::zeros());
    }

    /// The block at `row ≥ column`, which must be within the envelope.
    pub(crate) fn block_mut(&mut self, row: usize, column: usize) -> &mut SMatrix<f64, N, N> {
        debug_assert!(column <= row && column >= self.rows[row].first_column);
        &mut self.blocks[self.rows[row].start + column]
    }

    fn block(&self, row: usize, column: usize) -> &SMatrix<f64, N, N> {
        &self.blocks[self.rows[row].start + column]
    }

    fn left_of_diagonal(&self, row: usize) -> impl Iterator<Item = (usize, &SMatrix<f64, N, N>)> {
        (self.rows[row].first_column..row).map(move |column| (column, self.block(row, column)))
    }

    /// Replaces the matrix by its Cholesky factor.
    pub(crate) fn factorise(&mut self) -> Result<(), NotPositiveDefinite> {
        for row in 0..self.rows.len() {
            for column in self.rows[row].first_column..=row {
                let first = self.rows[row]
                    .first_column
                    .max(self.rows[column].first_column);
                let mut block = *self.block(row, column);
                for inner in first..column {
                    subtract_product(
                        &mut block,
                        self.block(row, inner),
                        self.block(column, inner),
                    );
                }
                *self.block_mut(row, column) = if column == row {
                    cholesky(&block)?
                } else {
                    solve_right(block, self.block(column, column))
                };
            }
        }
        Ok(())
    }

    /// Solves for a right-hand side in place, after [`Self::factorise`].
    pub(crate) fn solve(&self, unknowns: &mut [SVector<f64, N>]) {
        for row in 0..self.rows.len() {
            let mut value = unknowns[row];
            for (column, block) in self.left_of_diagonal(row) {
                value -= block * unknowns[column];
            }
            self.block(row, row).solve_lower_triangular_mut(&mut value);
            unknowns[row] = value;
        }
        for row in (0..self.rows.len()).rev() {
            let mut value = unknowns[row];
            self.block(row, row)
                .tr_solve_lower_triangular_mut(&mut value);
            unknowns[row] = value;
            for (column, block) in self.left_of_diagonal(row) {
                unknowns[column] -= block.tr_mul(&value);
            }
        }
    }
}

/// `target -= left rightᵀ`.
fn subtract_product<const N: usize>(
    target: &mut SMatrix<f64, N, N>,
    left: &SMatrix<f64, N, N>,
    right: &SMatrix<f64, N, N>,
) {
    for inner in 0..N {
        for column in 0..N {
            let factor = right[(column, inner)];
            for row in 0..N {
                target[(row, column)] -= left[(row, inner)] * factor;
            }
        }
    }
}

/// The lower factor of one block, zeros above its diagonal.
fn cholesky<const N: usize>(
    block: &SMatrix<f64, N, N>,
) -> Result<SMatrix<f64, N, N>, NotPositiveDefinite> {
    let mut factor = SMatrix::zeros();
    for column in 0..N {
        for row in column..N {
            let mut value = block[(row, column)];
            for inner in 0..column {
                value -= factor[(row, inner)] * factor[(column, inner)];
            }
            factor[(row, column)] = if row > column {
                value / factor[(column, column)]
            } else if value > 0.0 && value.is_finite() {
                value.sqrt()
            } else {
                return Err(NotPositiveDefinite);
            };
        }
    }
    Ok(factor)
}

/// `block · factor⁻ᵀ` for a lower factor.
fn solve_right<const N: usize>(
    mut block: SMatrix<f64, N, N>,
    factor: &SMatrix<f64, N, N>,
) -> SMatrix<f64, N, N> {
    for column in 0..N {
        for inner in 0..column {
            let scale = factor[(column, inner)];
            for row in 0..N {
                block[(row, column)] -= block[(row, inner)] * scale;
            }
        }
        let inverse = 1.0 / factor[(column, column)];
        for row in 0..N {
            block[(row, column)] *= inverse;
        }
    }
    block
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn solves_what_a_dense_factorisation_solves() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let first_columns = [0, 0, 1, 1, 0, 4, 4];
        let size = first_columns.len();
        let mut envelope = BlockEnvelope::<3>::default();
        for _ in 0..2 {
            envelope.reshape(first_columns.into_iter());
            let mut dense = DMatrix::zeros(3 * size, 3 * size);
            for (row, first_column) in first_columns.into_iter().enumerate() {
                for column in first_column..=row {
                    let mut block = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
                    if column == row {
                        block = block + block.transpose() + Matrix3::identity() * 20.0;
                    }
                    *envelope.block_mut(row, column) = block;
                    dense
                        .view_mut((3 * row, 3 * column), (3, 3))
                        .copy_from(&block);
                    dense
                        .view_mut((3 * column, 3 * row), (3, 3))
                        .copy_from(&block.transpose());
                }
            }
            let expected = DVector::from_fn(3 * size, |_, _| rng.random_range(-1.0..1.0));
            let right = &dense * &expected;
            let mut unknowns: Vec<Vector3<f64>> = (0..size)
                .map(|i| right.fixed_rows::<3>(3 * i).into_owned())
                .collect();
            envelope.factorise().unwrap();
            envelope.solve(&mut unknowns);
            for (i, found) in unknowns.iter().enumerate() {
                assert!((found - expected.fixed_rows::<3>(3 * i)).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn refuses_an_indefinite_matrix() {
        let mut envelope = BlockEnvelope::<3>::default();
        envelope.reshape([0, 0].into_iter());
        *envelope.block_mut(0, 0) = Matrix3::identity();
        *envelope.block_mut(1, 1) = -Matrix3::identity();
        assert_eq!(envelope.factorise(), Err(NotPositiveDefinite));
        *envelope.block_mut(0, 0) = Matrix3::repeat(f64::NAN);
        assert_eq!(envelope.factorise(), Err(NotPositiveDefinite));
    }
}

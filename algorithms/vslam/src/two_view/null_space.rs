//! What a few rows of nine entries leave free.

use nalgebra::SVector;

/// An orthonormal basis of the vectors that `rows` map to zero, by Householder reflections.
///
/// `ROWS + FREE` must be nine. `None` if the rows are dependent or not finite.
pub(super) fn null_space<const ROWS: usize, const FREE: usize>(
    mut rows: [SVector<f64, 9>; ROWS],
) -> Option<[SVector<f64, 9>; FREE]> {
    assert_eq!(ROWS + FREE, 9, "a vector has nine entries");
    let mut reflectors = [SVector::<f64, 9>::zeros(); ROWS];
    let largest = rows.iter().map(SVector::norm).fold(0.0, f64::max);
    for step in 0..ROWS {
        let mut reflector = rows[step];
        reflector
            .iter_mut()
            .take(step)
            .for_each(|entry| *entry = 0.0);
        let norm = reflector.norm();
        let independent = norm > 1e-12 * largest && norm.is_finite();
        if !independent {
            return None;
        }
        reflector[step] += norm.copysign(reflector[step]);
        reflector /= reflector.norm();
        for row in rows.iter_mut().skip(step + 1) {
            *row -= reflector * (2.0 * reflector.dot(row));
        }
        reflectors[step] = reflector;
    }
    Some(std::array::from_fn(|free| {
        let mut vector = SVector::zeros();
        vector[ROWS + free] = 1.0;
        for reflector in reflectors.iter().rev() {
            vector -= reflector * (2.0 * reflector.dot(&vector));
        }
        vector
    }))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn basis_is_orthonormal_and_annihilated() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for _ in 0..50 {
            let rows: [SVector<f64, 9>; 5] =
                std::array::from_fn(|_| SVector::from_fn(|_, _| rng.random_range(-1.0..1.0)));
            let basis = null_space::<5, 4>(rows).unwrap();
            for (i, vector) in basis.iter().enumerate() {
                assert!(rows.iter().all(|row| row.dot(vector).abs() < 1e-13));
                for (j, other) in basis.iter().enumerate() {
                    let expected = f64::from(u8::from(i == j));
                    assert!((vector.dot(other) - expected).abs() < 1e-13);
                }
            }
        }
    }

    #[test]
    fn dependent_rows_are_refused() {
        let row = SVector::<f64, 9>::repeat(1.0);
        assert!(null_space::<5, 4>([row; 5]).is_none());
        assert!(null_space::<8, 1>([row * f64::NAN; 8]).is_none());
    }
}

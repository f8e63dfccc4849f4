//! The essential matrices that five correspondences allow (Nistér 2004).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::null_space::null_space;
use super::polynomial::real_roots;

/// The up to ten essential matrices of five correspondences, appended to `solutions`.
///
/// `second[i]ᵀ E first[i] = 0` for points `(x, y, 1)` on the ideal planes. Each has Frobenius
/// norm one. Degenerate or infinite input appends nothing.
pub(super) fn essential_matrices(
    first: &[Vector3<f64>; 5],
    second: &[Vector3<f64>; 5],
    solutions: &mut Vec<Matrix3<f64>>,
) {
    let rows = [0, 1, 2, 3, 4]
        .map(|i| SVector::<f64, 9>::from_fn(|entry, _| second[i][entry / 3] * first[i][entry % 3]));
    let Some(basis) = null_space::<5, 4>(rows) else {
        return;
    };
    let basis = basis.map(|vector| Matrix3::from_row_slice(vector.as_slice()));
    let Some(reduced) = reduced_constraints(&basis) else {
        return;
    };
    let equations = [(4, 5), (6, 7), (8, 9)].map(|(high, low)| eliminate(&reduced, high, low));
    for z in real_roots(&determinant(&equations)).iter() {
        let Some((x, y)) = solve_for_xy(&equations, *z) else {
            continue;
        };
        let essential = basis[0] * x + basis[1] * y + basis[2] * *z + basis[3];
        let norm = essential.norm();
        if norm > 0.0 && norm.is_finite() {
            solutions.push(essential / norm);
        }
    }
}

/// A polynomial in `x, y, z` of degree one: coefficients of `x, y, z, 1`.
type Linear = [f64; 4];
/// Of degree two: coefficients of [`QUADRATIC`].
type Quadratic = [f64; 10];
/// Of degree three: coefficients of [`CUBIC`].
type Cubic = [f64; 20];

/// Exponents of `x, y, z` in each monomial of a [`Quadratic`].
const QUADRATIC: [[u8; 3]; 10] = [
    [2, 0, 0],
    [1, 1, 0],
    [1, 0, 1],
    [0, 2, 0],
    [0, 1, 1],
    [0, 0, 2],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [0, 0, 0],
];

/// Exponents of `x, y, z` in each monomial of a [`Cubic`], in the order of Nistér's elimination:
/// the first ten lead a row each, the others are `x`, `y` and one times powers of `z`.
const CUBIC: [[u8; 3]; 20] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];

const LINEAR: [[u8; 3]; 4] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]];

/// Where the product of two monomials is found in a longer list.
const fn product_table<const L: usize, const M: usize, const N: usize>(
    left: [[u8; 3]; L],
    right: [[u8; 3]; M],
    product: [[u8; 3]; N],
) -> [[usize; M]; L] {
    let mut table = [[0; M]; L];
    let mut i = 0;
    while i < L {
        let mut j = 0;
        while j < M {
            let mut k = 0;
            while product[k][0] != left[i][0] + right[j][0]
                || product[k][1] != left[i][1] + right[j][1]
                || product[k][2] != left[i][2] + right[j][2]
            {
                k += 1;
            }
            table[i][j] = k;
            j += 1;
        }
        i += 1;
    }
    table
}

static LINEAR_TIMES_LINEAR: [[usize; 4]; 4] = product_table(LINEAR, LINEAR, QUADRATIC);
static QUADRATIC_TIMES_LINEAR: [[usize; 4]; 10] = product_table(QUADRATIC, LINEAR, CUBIC);

/// `sum += factor · left · right`.
fn add_linear_product(sum: &mut Quadratic, left: &Linear, right: &Linear, factor: f64) {
    for (a, row) in left.iter().zip(&LINEAR_TIMES_LINEAR) {
        for (b, target) in right.iter().zip(row) {
            sum[*target] += factor * a * b;
        }
    }
}

/// `sum += left · right`.
fn add_cubic_product(sum: &mut Cubic, left: &Quadratic, right: &Linear) {
    for (a, row) in left.iter().zip(&QUADRATIC_TIMES_LINEAR) {
        for (b, target) in right.iter().zip(row) {
            sum[*target] += a * b;
        }
    }
}

const AXES: [usize; 3] = [0, 1, 2];

/// The ten cubic constraints on `E = x X + y Y + z Z + W`, with the first ten monomials
/// eliminated: row `i` reads `CUBIC[i] + Σⱼ reduced[(i, j)] CUBIC[10 + j] = 0`.
fn reduced_constraints(basis: &[Matrix3<f64>; 4]) -> Option<SMatrix<f64, 10, 10>> {
    let entry =
        |row: usize, column: usize| -> Linear { [0, 1, 2, 3].map(|k| basis[k][(row, column)]) };
    let mut rows = [[0.0; 20]; 10];
    // det E = 0, by the first row's minors.
    for column in AXES {
        let (a, b) = ((column + 1) % 3, (column + 2) % 3);
        let mut minor = [0.0; 10];
        add_linear_product(&mut minor, &entry(1, a), &entry(2, b), 1.0);
        add_linear_product(&mut minor, &entry(1, b), &entry(2, a), -1.0);
        add_cubic_product(&mut rows[9], &minor, &entry(0, column));
    }
    // E Eᵀ E − ½ trace(E Eᵀ) E = 0.
    let mut form = AXES.map(|i| {
        AXES.map(|j| {
            let mut product = [0.0; 10];
            for k in AXES {
                add_linear_product(&mut product, &entry(i, k), &entry(j, k), 1.0);
            }
            product
        })
    });
    let half_trace: Quadratic =
        std::array::from_fn(|k| 0.5 * AXES.iter().map(|i| form[*i][*i][k]).sum::<f64>());
    for i in AXES {
        for (entry, trace) in form[i][i].iter_mut().zip(&half_trace) {
            *entry -= trace;
        }
        for j in AXES {
            for k in AXES {
                add_cubic_product(&mut rows[3 * i + j], &form[i][k], &entry(k, j));
            }
        }
    }
    gauss_jordan(rows)
}

/// Makes the left half of ten rows the identity, with partial pivoting, and returns the right.
fn gauss_jordan(mut rows: [Cubic; 10]) -> Option<SMatrix<f64, 10, 10>> {
    for column in 0..10 {
        let size = |row: &usize| rows[*row][column].abs();
        let pivot = (column..10).max_by(|a, b| size(a).total_cmp(&size(b)))?;
        rows.swap(column, pivot);
        let inverse = 1.0 / rows[column][column];
        if !inverse.is_finite() {
            return None;
        }
        rows[column].iter_mut().for_each(|entry| *entry *= inverse);
        let pivot_row = rows[column];
        for (row_idx, row) in rows.iter_mut().enumerate() {
            if row_idx == column {
                continue;
            }
            let factor = row[column];
            for k in column..20 {
                row[k] -= factor * pivot_row[k];
            }
        }
    }
    let reduced = SMatrix::<f64, 10, 10>::from_fn(|row, column| rows[row][10 + column]);
    reduced
        .iter()
        .all(|entry| entry.is_finite())
        .then_some(reduced)
}

/// A polynomial in `z`, lowest power first.
type InZ<const N: usize> = [f64; N];

/// `x · x_factor(z) + y · y_factor(z) + rest(z) = 0`.
struct EquationInZ {
    x_factor: InZ<4>,
    y_factor: InZ<4>,
    rest: InZ<5>,
}

/// Row `high` minus `z` times row `low`, whose leading monomials cancel.
fn eliminate(reduced: &SMatrix<f64, 10, 10>, high: usize, low: usize) -> EquationInZ {
    let (a, b) = (|j: usize| reduced[(high, j)], |j: usize| reduced[(low, j)]);
    let cubic = |j: usize| [a(j + 2), a(j + 1) - b(j + 2), a(j) - b(j + 1), -b(j)];
    EquationInZ {
        x_factor: cubic(0),
        y_factor: cubic(3),
        rest: [a(9), a(8) - b(9), a(7) - b(8), a(6) - b(7), -b(6)],
    }
}

fn multiply<const L: usize, const M: usize, const N: usize>(
    left: &InZ<L>,
    right: &InZ<M>,
) -> InZ<N> {
    let mut product = [0.0; N];
    for (i, a) in left.iter().enumerate() {
        for (j, b) in right.iter().enumerate() {
            product[i + j] += a * b;
        }
    }
    product
}

/// The determinant of the three equations' coefficients, of degree ten.
fn determinant(equations: &[EquationInZ; 3]) -> InZ<11> {
    let mut sum = [0.0; 11];
    for i in 0..3 {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let left: InZ<7> = multiply(&equations[j].x_factor, &equations[k].y_factor);
        let right: InZ<7> = multiply(&equations[k].x_factor, &equations[j].y_factor);
        let minor: InZ<7> = std::array::from_fn(|power| left[power] - right[power]);
        let product: InZ<11> = multiply(&minor, &equations[i].rest);
        for (total, term) in sum.iter_mut().zip(product) {
            *total += term;
        }
    }
    sum
}

/// The `x` and `y` that belong to a root: the null vector of the coefficients, scaled.
fn solve_for_xy(equations: &[EquationInZ; 3], z: f64) -> Option<(f64, f64)> {
    let value = |coefficients: &[f64]| coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c);
    let rows = [0, 1, 2].map(|i| {
        let equation = &equations[i];
        Vector3::new(
            value(&equation.x_factor),
            value(&equation.y_factor),
            value(&equation.rest),
        )
    });
    let null_vector = [(0, 1), (0, 2), (1, 2)]
        .map(|(i, j)| rows[i].cross(&rows[j]))
        .into_iter()
        .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
    let (x, y) = (null_vector.x / null_vector.z, null_vector.y / null_vector.z);
    (x.is_finite() && y.is_finite()).then_some((x, y))
}

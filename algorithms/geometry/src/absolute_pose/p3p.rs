//! The poses from which three known points are seen in three known directions.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::polynomial::{cubic_roots, quadratic_roots};
use crate::{Camera, Transform};

/// The up to four poses that see three points in three directions.
///
/// Two homogeneous quadrics in the three depths share their solutions with the degenerate member
/// of their pencil, which is a pair of planes (the route of Persson and Nordberg 2018).
///
/// - `directions_in_camera`: of unit length.
///
/// Empty if the points are collinear, or if any number is not finite.
pub fn p3p<World>(
    points_in_world: &[Vector3<f64>; 3],
    directions_in_camera: &[Vector3<f64>; 3],
) -> [Option<Transform<Camera, World>>; 4] {
    let mut poses = [None; 4];
    let triangle = Triangle::new(points_in_world, directions_in_camera);
    let edges = edge_frame(points_in_world);
    let Some(edges_inverse) = edges.try_inverse() else {
        return poses;
    };
    let Some(planes) = triangle.plane_pair() else {
        return poses;
    };
    let mut pose_count = 0;
    for normal in planes {
        for depths in triangle.depths_on(&normal).into_iter().flatten() {
            let depths = triangle.polish(depths);
            if depths.min() <= 0.0 {
                continue;
            }
            let points_in_camera = [0, 1, 2].map(|i| directions_in_camera[i] * depths[i]);
            let matrix = edge_frame(&points_in_camera) * edges_inverse;
            let rotation =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
            let translation = points_in_camera[0] - rotation * points_in_world[0];
            if translation.iter().all(|t| t.is_finite()) && pose_count < poses.len() {
                poses[pose_count] = Some(Transform::new(rotation, translation));
                pose_count += 1;
            }
        }
    }
    poses
}

/// Two edges of a triangle and their normal, as columns.
fn edge_frame(points: &[Vector3<f64>; 3]) -> Matrix3<f64> {
    let first = points[1] - points[0];
    let second = points[2] - points[0];
    Matrix3::from_columns(&[first, second, first.cross(&second)])
}

/// What the depths `λ` must satisfy: `λᵢ² + λⱼ² − 2 cᵢⱼ λᵢ λⱼ = aᵢⱼ` for each pair.
struct Triangle {
    /// Squared side lengths `a₀₁`, `a₀₂`, `a₁₂`.
    sides_squared: [f64; 3],
    /// Cosines between the directions, same order.
    cosines: [f64; 3],
    /// The homogeneous quadrics that follow from pairs of these equations.
    quadrics: [Matrix3<f64>; 2],
}

const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

impl Triangle {
    fn new(points: &[Vector3<f64>; 3], directions: &[Vector3<f64>; 3]) -> Self {
        let sides_squared = PAIRS.map(|(i, j)| (points[i] - points[j]).norm_squared());
        let cosines = PAIRS.map(|(i, j)| directions[i].dot(&directions[j]));
        let mut forms = [Matrix3::zeros(); 3];
        for (form, ((i, j), cosine)) in forms.iter_mut().zip(PAIRS.into_iter().zip(cosines)) {
            form[(i, i)] = 1.0;
            form[(j, j)] = 1.0;
            form[(i, j)] = -cosine;
            form[(j, i)] = -cosine;
        }
        let quadrics = [0, 1].map(|k| forms[k] * sides_squared[2] - forms[2] * sides_squared[k]);
        Self {
            sides_squared,
            cosines,
            quadrics,
        }
    }

    /// Normals of the two planes that contain every real solution.
    fn plane_pair(&self) -> Option<[Vector3<f64>; 2]> {
        let [first, second] = &self.quadrics;
        let (first_adjugate, second_adjugate) = (adjugate(first), adjugate(second));
        let coefficients = [
            first.determinant(),
            (first_adjugate * second).trace(),
            (second_adjugate * first).trace(),
            second.determinant(),
        ];
        let members = cubic_roots(coefficients)
            .map(|root| root.map(|factor| first + second * factor))
            .into_iter()
            .flatten()
            // The root at infinity.
            .chain(std::iter::once(*second));
        let mut best: Option<(f64, [Vector3<f64>; 2])> = None;
        for member in members {
            let Some((quality, planes)) = split_into_planes(&member) else {
                continue;
            };
            if best.is_none_or(|(best_quality, _)| quality > best_quality) {
                best = Some((quality, planes));
            }
        }
        best.map(|(_, planes)| planes)
    }

    /// The depths in the plane through the origin that satisfy all three equations.
    fn depths_on(&self, normal: &Vector3<f64>) -> [Option<Vector3<f64>>; 2] {
        let u = normal.cross(&smallest_axis(normal)).normalize();
        let v = normal.cross(&u);
        // Of the two quadrics, the one that says more about this plane.
        let restricted = self.quadrics.map(|quadric| {
            (
                u.dot(&(quadric * u)),
                2.0 * u.dot(&(quadric * v)),
                v.dot(&(quadric * v)),
            )
        });
        let size = |(a, b, c): (f64, f64, f64)| a.abs() + b.abs() + c.abs();
        let (a, b, c) = if size(restricted[0]) >= size(restricted[1]) {
            restricted[0]
        } else {
            restricted[1]
        };
        // λ ∝ x u + v, or u + x v where that is better conditioned.
        let directions = if a.abs() >= c.abs() {
            quadratic_roots(a, b, c).map(|root| root.map(|x| u * x + v))
        } else {
            quadratic_roots(c, b, a).map(|root| root.map(|x| u + v * x))
        };
        directions.map(|direction| direction.and_then(|direction| self.scaled(direction)))
    }

    /// The multiple of a solution of the homogeneous equations that has the right side lengths.
    fn scaled(&self, direction: Vector3<f64>) -> Option<Vector3<f64>> {
        let form = |k: usize| {
            let (i, j) = PAIRS[k];
            let (x, y) = (direction[i], direction[j]);
            x * x + y * y - 2.0 * self.cosines[k] * x * y
        };
        let form_sum: f64 = (0..3).map(form).sum();
        let scale = (self.sides_squared.iter().sum::<f64>() / form_sum).sqrt();
        let depths = direction * scale.copysign(direction.sum());
        (depths.min() > 0.0 && depths.max().is_finite()).then_some(depths)
    }

    /// Newton steps on the three equations, which undo the loss of digits on the way.
    fn polish(&self, mut depths: Vector3<f64>) -> Vector3<f64> {
        for _ in 0..2 {
            let mut residual = Vector3::zeros();
            let mut jacobian = Matrix3::zeros();
            for (k, (i, j)) in PAIRS.into_iter().enumerate() {
                let (x, y, cosine) = (depths[i], depths[j], self.cosines[k]);
                residual[k] = x * x + y * y - 2.0 * cosine * x * y - self.sides_squared[k];
                jacobian[(k, i)] = 2.0 * (x - cosine * y);
                jacobian[(k, j)] = 2.0 * (y - cosine * x);
            }
            match jacobian.try_inverse() {
                Some(inverse) => depths -= inverse * residual,
                None => break,
            }
        }
        depths
    }
}

/// Splits a singular symmetric form into two planes, with a quality that is largest for planes
/// at right angles; `None` if it is not singular or has no real planes.
fn split_into_planes(form: &Matrix3<f64>) -> Option<(f64, [Vector3<f64>; 2])> {
    if !form.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let eigen = form.symmetric_eigen();
    let (lowest, highest) = (eigen.eigenvalues.imin(), eigen.eigenvalues.imax());
    let (negative, positive) = (eigen.eigenvalues[lowest], eigen.eigenvalues[highest]);
    let middle = eigen.eigenvalues.sum() - negative - positive;
    let singular = middle.abs() < 1e-7 * positive.max(-negative);
    if negative >= 0.0 || positive <= 0.0 || !singular {
        return None;
    }
    let along = eigen.eigenvectors.column(highest) * positive.sqrt();
    let across = eigen.eigenvectors.column(lowest) * (-negative).sqrt();
    let quality = positive.min(-negative) / positive.max(-negative);
    let planes = [(along + across).normalize(), (along - across).normalize()];
    Some((quality, planes))
}

fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_rows(&[
        b.cross(&c).transpose(),
        c.cross(&a).transpose(),
        a.cross(&b).transpose(),
    ])
}

fn smallest_axis(v: &Vector3<f64>) -> Vector3<f64> {
    let mut axis = Vector3::zeros();
    axis[v.abs().imin()] = 1.0;
    axis
}

//! Rotations: exponential, logarithm and their derivatives.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Below this angle (rad) series replace the closed forms.
const SMALL_ANGLE_RAD: f64 = 1e-5;

/// The matrix `[v]×` with `[v]× w = v × w`.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The rotation by `|omega|` radians about `omega`.
pub fn exp(omega: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle_squared = omega.norm_squared();
    let angle = angle_squared.sqrt();
    let (half_sinc, cosine) = if angle < SMALL_ANGLE_RAD {
        (0.5 - angle_squared / 48.0, 1.0 - angle_squared / 8.0)
    } else {
        ((0.5 * angle).sin() / angle, (0.5 * angle).cos())
    };
    let vector = omega * half_sinc;
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(
        cosine, vector.x, vector.y, vector.z,
    ))
}

/// The rotation vector of `rotation`, with a norm of at most π.
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let sign = if rotation.w < 0.0 { -1.0 } else { 1.0 };
    let vector = rotation.imag() * sign;
    let sine = vector.norm();
    let cosine = rotation.w * sign;
    if sine < SMALL_ANGLE_RAD {
        return vector * (2.0 / cosine * (1.0 - sine * sine / (3.0 * cosine * cosine)));
    }
    vector * (2.0 * sine.atan2(cosine) / sine)
}

/// The left Jacobian: `exp(ω + δ) ≈ exp(J δ) exp(ω)` (Barfoot 2017, eq. 7.37).
pub fn left_jacobian(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = omega.norm_squared();
    let angle = angle_squared.sqrt();
    let omega_hat = hat(omega);
    let (a, b) = if angle < 1e-4 {
        (
            0.5 - angle_squared / 24.0,
            1.0 / 6.0 - angle_squared / 120.0,
        )
    } else {
        (
            (1.0 - angle.cos()) / angle_squared,
            (angle - angle.sin()) / (angle_squared * angle),
        )
    };
    Matrix3::identity() + omega_hat * a + omega_hat * omega_hat * b
}

/// The right Jacobian: `exp(ω + δ) ≈ exp(ω) exp(J δ)`.
pub fn right_jacobian(omega: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-omega)
}

/// The inverse of [`left_jacobian`], for `|ω| < 2π`.
pub fn left_jacobian_inverse(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = omega.norm_squared();
    let angle = angle_squared.sqrt();
    let omega_hat = hat(omega);
    let c = if angle < 1e-3 {
        1.0 / 12.0 + angle_squared / 720.0
    } else {
        1.0 / angle_squared - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    Matrix3::identity() - omega_hat * 0.5 + omega_hat * omega_hat * c
}

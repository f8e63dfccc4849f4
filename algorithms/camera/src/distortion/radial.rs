//! Models that bend only along the radius: to the bent radius with its derivative, and back to the
//! angle from the optical axis.

use std::f64::consts::{FRAC_PI_2, PI};

/// `θ_d` and its derivative by `θ`.
pub fn equidistant([k1, k2, k3, k4]: [f64; 4], angle: f64) -> (f64, f64) {
    let a2 = angle * angle;
    let bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
    let slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)));
    (bent, slope)
}

/// By Newton's method; `None` where it does not converge or the model folds.
pub fn equidistant_angle(coefficients: [f64; 4], bent: f64) -> Option<f64> {
    let mut angle = bent;
    for _ in 0..20 {
        let (value, slope) = equidistant(coefficients, angle);
        let step = (value - bent) / slope;
        angle -= step;
        if step.abs() < 1e-14 {
            break;
        }
    }
    let (value, slope) = equidistant(coefficients, angle);
    let valid = (value - bent).abs() < 1e-9 && slope > 0.0 && (0.0..=PI).contains(&angle);
    valid.then_some(angle)
}

pub fn field_of_view(omega_rad: f64, radius: f64) -> (f64, f64) {
    let spread = 2.0 * (0.5 * omega_rad).tan();
    let wide = spread * radius;
    (wide.atan() / spread, 1.0 / (1.0 + wide * wide))
}

pub fn field_of_view_angle(omega_rad: f64, bent: f64) -> Option<f64> {
    let spread = 2.0 * (0.5 * omega_rad).tan();
    let wide = spread * bent;
    (wide < FRAC_PI_2).then(|| (wide.tan() / spread).atan())
}

pub fn double_sphere([xi, alpha]: [f64; 2], radius: f64) -> (f64, f64) {
    let d1 = radius.hypot(1.0);
    let d_d1 = radius / d1;
    let shifted = xi * d1 + 1.0;
    let d2 = radius.hypot(shifted);
    let d_d2 = (radius + shifted * xi * d_d1) / d2;
    let depth = alpha * d2 + (1.0 - alpha) * shifted;
    let d_depth = alpha * d_d2 + (1.0 - alpha) * xi * d_d1;
    let bent = (1.0 + xi) * radius / depth;
    (
        bent,
        (1.0 + xi) * (depth - radius * d_depth) / (depth * depth),
    )
}

/// Usenko et al. 2018, eq. 46–52; `None` outside the image of the projection.
pub fn double_sphere_angle([xi, alpha]: [f64; 2], bent: f64) -> Option<f64> {
    let m = bent / (1.0 + xi);
    let m2 = m * m;
    let under_root = 1.0 - (2.0 * alpha - 1.0) * m2;
    if under_root < 0.0 {
        return None;
    }
    let depth = (1.0 - alpha * alpha * m2) / (alpha * under_root.sqrt() + 1.0 - alpha);
    let under_root = depth * depth + (1.0 - xi * xi) * m2;
    if under_root < 0.0 {
        return None;
    }
    let length = (depth * xi + under_root.sqrt()) / (depth * depth + m2);
    let angle = (length * m).atan2(length * depth - xi);
    angle.is_finite().then_some(angle)
}

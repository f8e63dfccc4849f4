//! Radial and tangential distortion, with a polynomial or a quotient of two.

use nalgebra::{Matrix2, Vector2};

#[derive(Clone, Copy, Default)]
pub struct Brown {
    pub numerator: [f64; 3],
    pub denominator: Option<[f64; 3]>,
    pub p1: f64,
    pub p2: f64,
}

impl Brown {
    pub fn distort_with_derivative(&self, ideal: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let Self { p1, p2, .. } = *self;
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let (radial, slope) = self.factor(r2);
        let distorted = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let derivative = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (distorted, derivative)
    }

    /// By Newton's method; `None` where it does not converge.
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let mut ideal = *distorted;
        for _ in 0..20 {
            let (bent, derivative) = self.distort_with_derivative(&ideal);
            let error = bent - distorted;
            if error.norm_squared() < 1e-24 {
                return Some(ideal);
            }
            ideal -= derivative.try_inverse()? * error;
        }
        let error = self.distort_with_derivative(&ideal).0 - distorted;
        (error.norm() < 1e-9).then_some(ideal)
    }

    pub fn bent_radius(&self, radius: f64) -> (f64, f64) {
        let r2 = radius * radius;
        let (factor, slope) = self.factor(r2);
        (radius * factor, factor + 2.0 * r2 * slope)
    }

    /// The radial factor and its derivative by the squared radius.
    fn factor(&self, r2: f64) -> (f64, f64) {
        let (top, d_top) = polynomial(self.numerator, r2);
        let Some(denominator) = self.denominator else {
            return (top, d_top);
        };
        let (bottom, d_bottom) = polynomial(denominator, r2);
        let factor = top / bottom;
        (factor, (d_top - factor * d_bottom) / bottom)
    }
}

/// `1 + a r² + b r⁴ + c r⁶` and its derivative by `r²`.
fn polynomial([a, b, c]: [f64; 3], r2: f64) -> (f64, f64) {
    let value = 1.0 + r2 * (a + r2 * (b + r2 * c));
    let slope = a + r2 * (2.0 * b + r2 * 3.0 * c);
    (value, slope)
}

//! Lens distortion on the normalised image plane.

use nalgebra::{Matrix2, Vector2};

/// How a lens bends rays, as a map of the normalised plane `(x/z, y/z)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// An ideal pinhole.
    None,
    /// Brown–Conrady, "plumb bob": `x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2x²)`,
    /// and `y` likewise with `p1 (r² + 2y²) + 2 p2 x y`.
    ///
    /// Holds while the radial part grows with r: see [`Distortion::radius_limit`].
    RadialTangential {
        k1: f64,
        k2: f64,
        p1: f64,
        p2: f64,
        k3: f64,
    },
    /// Kannala–Brandt: `θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)` with `θ = atan r`.
    Equidistant { k1: f64, k2: f64, k3: f64, k4: f64 },
}

/// Steps in which the radial polynomial is searched for its turning point.
const LIMIT_SEARCH_STEPS: u32 = 400;

impl Distortion {
    /// The bent position of an ideal one.
    pub fn distort(&self, ideal: &Vector2<f64>) -> Vector2<f64> {
        self.distort_with_derivative(ideal).0
    }

    /// The bent position, and `d_distorted_d_ideal`.
    pub fn distort_with_derivative(&self, ideal: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        match *self {
            Self::None => (*ideal, Matrix2::identity()),
            Self::RadialTangential { k1, k2, p1, p2, k3 } => {
                let (x, y) = (ideal.x, ideal.y);
                let r2 = x * x + y * y;
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
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
            Self::Equidistant { .. } => self.equidistant_with_derivative(ideal),
        }
    }

    fn equidistant_with_derivative(&self, ideal: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let radius = ideal.norm();
        if radius < 1e-9 {
            return (*ideal, Matrix2::identity());
        }
        let (bent, slope) = self.bent_angle(radius.atan());
        let factor = bent / radius;
        let d_bent_d_radius = slope / (1.0 + radius * radius);
        let outward = ideal / radius;
        let derivative = Matrix2::identity() * factor
            + outward * outward.transpose() * (d_bent_d_radius - factor);
        (ideal * factor, derivative)
    }

    /// `θ_d` and `dθ_d/dθ` of the equidistant model; other models are linear in the angle.
    pub(crate) fn bent_angle(&self, angle: f64) -> (f64, f64) {
        let Self::Equidistant { k1, k2, k3, k4 } = *self else {
            return (angle, 1.0);
        };
        let a2 = angle * angle;
        let bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
        let slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)));
        (bent, slope)
    }

    /// The ideal position of a bent one, by Newton's method; `None` where it does not converge.
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        match self {
            Self::None => Some(*distorted),
            Self::RadialTangential { .. } => self.undistort_radial_tangential(distorted),
            Self::Equidistant { .. } => {
                let angle = self.straight_angle(distorted.norm())?;
                let below_horizon = angle < std::f64::consts::FRAC_PI_2 - 1e-6;
                let norm = distorted.norm();
                let factor = if norm < 1e-9 { 1.0 } else { angle.tan() / norm };
                below_horizon.then(|| distorted * factor)
            }
        }
    }

    fn undistort_radial_tangential(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let mut ideal = *distorted;
        for _ in 0..20 {
            let (bent, derivative) = self.distort_with_derivative(&ideal);
            let error = bent - distorted;
            if error.norm_squared() < 1e-24 {
                return Some(ideal);
            }
            ideal -= derivative.try_inverse()? * error;
        }
        let error = self.distort(&ideal) - distorted;
        (error.norm() < 1e-9).then_some(ideal)
    }

    /// The angle from the optical axis whose image is at this radius on the bent plane.
    pub(crate) fn straight_angle(&self, bent: f64) -> Option<f64> {
        let mut angle = bent;
        for _ in 0..20 {
            let (value, slope) = self.bent_angle(angle);
            let step = (value - bent) / slope;
            angle -= step;
            if step.abs() < 1e-14 {
                break;
            }
        }
        let (value, slope) = self.bent_angle(angle);
        let valid = (value - bent).abs() < 1e-9
            && slope > 0.0
            && (0.0..=std::f64::consts::PI).contains(&angle);
        valid.then_some(angle)
    }

    /// The radius on the ideal plane up to which the model is one-to-one.
    ///
    /// Beyond it the polynomial folds back and would map two rays to one pixel.
    pub fn radius_limit(&self) -> f64 {
        let Self::RadialTangential { k1, k2, k3, .. } = *self else {
            return f64::INFINITY;
        };
        let slope = |r2: f64| 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3));
        // Ideal pinholes beyond 80° are not used in practice: tan 80° = 5.7.
        let radius_max = 5.7;
        (1..=LIMIT_SEARCH_STEPS)
            .map(|step| radius_max * f64::from(step) / f64::from(LIMIT_SEARCH_STEPS))
            .find(|radius| slope(radius * radius) <= 0.0)
            .map_or(f64::INFINITY, |radius| radius * 0.98)
    }
}

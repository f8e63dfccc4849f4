//! Lens distortion on the normalised image plane.

mod brown;
mod radial;

use nalgebra::{Matrix2, Vector2};

use brown::Brown;

/// How a lens bends rays, as a map of the normalised plane `(x/z, y/z)`.
///
/// Every model is scaled so that it leaves the neighbourhood of the centre as it is: focal lengths
/// are pixels per unit of the ideal plane there. Where custom writes a model otherwise, files hold
/// focal lengths that [`Distortion::customary_slope`] translates.
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
    /// OpenCV's `rational_polynomial`: as [`Distortion::RadialTangential`], with the radial factor
    /// `(1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)`.
    ///
    /// Holds while the radial part grows with r: see [`Distortion::radius_limit`].
    Rational {
        /// `k1` to `k6`.
        radial: [f64; 6],
        p1: f64,
        p2: f64,
    },
    /// Kannala–Brandt: `θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)` with `θ = atan r`.
    ///
    /// Holds for rays up to 180° off the axis, of which the ideal plane has those that point
    /// forward, while `θ_d` grows with `θ`.
    Equidistant { k1: f64, k2: f64, k3: f64, k4: f64 },
    /// Devernay and Faugeras 2001, the FOV model: `r_d = atan(2 r tan(ω/2)) / (2 tan(ω/2))`;
    /// custom divides by `ω` instead.
    ///
    /// Holds for all rays that point forward, and `0 < ω < π`.
    FieldOfView { omega_rad: f64 },
    /// Usenko, Demmel and Cremers 2018:
    /// `r_d = (1+ξ) r / (α d₂ + (1-α) (ξ d₁ + 1))` with `d₁ = √(r² + 1)` and
    /// `d₂ = √(r² + (ξ d₁ + 1)²)`; custom leaves out `1+ξ`.
    ///
    /// Holds for `ξ > -1` and `0 ≤ α ≤ 1`: of the rays that point forward for all where
    /// `w₂ = (w₁ + ξ) / √(2 w₁ ξ + ξ² + 1) ≥ 0`, else for those with `1 > -w₂ d₁`;
    /// `w₁ = min(α, 1-α) / max(α, 1-α)`. With `α = 0` it is the unified model of Mei.
    DoubleSphere { xi: f64, alpha: f64 },
}

/// Steps in which the radial part is searched for its turning point.
const LIMIT_SEARCH_STEPS: u32 = 400;

impl Distortion {
    /// The bent position of an ideal one.
    pub fn distort(&self, ideal: &Vector2<f64>) -> Vector2<f64> {
        self.distort_with_derivative(ideal).0
    }

    /// The bent position, and `d_distorted_d_ideal`.
    pub fn distort_with_derivative(&self, ideal: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        if let Self::None = self {
            return (*ideal, Matrix2::identity());
        }
        if let Some(brown) = self.brown() {
            return brown.distort_with_derivative(ideal);
        }
        let radius = ideal.norm();
        if radius < 1e-9 {
            return (*ideal, Matrix2::identity());
        }
        let (bent, d_bent_d_radius) = self.bent_radius(radius);
        let factor = bent / radius;
        let outward = ideal / radius;
        let derivative = Matrix2::identity() * factor
            + outward * outward.transpose() * (d_bent_d_radius - factor);
        (ideal * factor, derivative)
    }

    /// The ideal position of a bent one; `None` where no ray that points forward is seen.
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        if let Self::None = self {
            return Some(*distorted);
        }
        if let Some(brown) = self.brown() {
            return brown.undistort(distorted);
        }
        let norm = distorted.norm();
        let angle = self.straight_angle(norm)?;
        let below_horizon = angle < std::f64::consts::FRAC_PI_2 - 1e-6;
        let factor = if norm < 1e-9 { 1.0 } else { angle.tan() / norm };
        below_horizon.then(|| distorted * factor)
    }

    /// The radius on the ideal plane up to which the model is one-to-one.
    ///
    /// Beyond it the model folds back and would map two rays to one pixel.
    pub fn radius_limit(&self) -> f64 {
        if let Self::None = self {
            return f64::INFINITY;
        }
        // Rays beyond 80° are not used in practice: tan 80° = 5.7.
        let radius_max = 5.7;
        (1..=LIMIT_SEARCH_STEPS)
            .map(|step| radius_max * f64::from(step) / f64::from(LIMIT_SEARCH_STEPS))
            .find(|radius| {
                let (bent, slope) = self.bent_radius(*radius);
                slope.is_nan() || slope <= 0.0 || bent.is_nan() || bent <= 0.0
            })
            .map_or(f64::INFINITY, |radius| radius * 0.98)
    }

    /// The slope at the centre of the model as it is customarily written. A focal length from a
    /// file times this is one of [`crate::Intrinsics`].
    pub fn customary_slope(&self) -> f64 {
        match *self {
            Self::FieldOfView { omega_rad } => 2.0 * (0.5 * omega_rad).tan() / omega_rad,
            Self::DoubleSphere { xi, .. } => 1.0 / (1.0 + xi),
            _ => 1.0,
        }
    }

    /// The bent radius of an ideal one, without the tangential part, and its derivative.
    fn bent_radius(&self, radius: f64) -> (f64, f64) {
        match *self {
            Self::None => (radius, 1.0),
            Self::RadialTangential { .. } | Self::Rational { .. } => {
                self.brown().unwrap_or_default().bent_radius(radius)
            }
            Self::Equidistant { k1, k2, k3, k4 } => {
                let (bent, slope) = radial::equidistant([k1, k2, k3, k4], radius.atan());
                (bent, slope / (1.0 + radius * radius))
            }
            Self::FieldOfView { omega_rad } => radial::field_of_view(omega_rad, radius),
            Self::DoubleSphere { xi, alpha } => radial::double_sphere([xi, alpha], radius),
        }
    }

    /// The angle from the optical axis whose image is at this radius on the bent plane, of the
    /// models that are maps of that angle; for others that of the same radius.
    pub(crate) fn straight_angle(&self, bent: f64) -> Option<f64> {
        match *self {
            Self::Equidistant { k1, k2, k3, k4 } => {
                radial::equidistant_angle([k1, k2, k3, k4], bent)
            }
            Self::FieldOfView { omega_rad } => radial::field_of_view_angle(omega_rad, bent),
            Self::DoubleSphere { xi, alpha } => radial::double_sphere_angle([xi, alpha], bent),
            _ => Some(bent.atan()),
        }
    }

    /// Whether pixels may show rays that do not point forward.
    pub(crate) fn sees_behind(&self) -> bool {
        matches!(self, Self::Equidistant { .. } | Self::DoubleSphere { .. })
    }

    fn brown(&self) -> Option<Brown> {
        match *self {
            Self::RadialTangential { k1, k2, p1, p2, k3 } => Some(Brown {
                numerator: [k1, k2, k3],
                denominator: None,
                p1,
                p2,
            }),
            Self::Rational {
                radial: [k1, k2, k3, k4, k5, k6],
                p1,
                p2,
            } => Some(Brown {
                numerator: [k1, k2, k3],
                denominator: Some([k4, k5, k6]),
                p1,
                p2,
            }),
            _ => None,
        }
    }
}

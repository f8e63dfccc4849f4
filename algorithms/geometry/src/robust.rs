//! Weights that keep outliers from deciding a least-squares fit.

/// How the cost of a residual grows once it exceeds what noise explains.
///
/// Residuals are passed squared and whitened (divided by their variance).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RobustKernel {
    /// Plain least squares.
    None,
    /// Quadratic up to `threshold`, linear beyond (Huber 1964).
    Huber {
        /// Where the cost turns linear, in standard deviations.
        threshold: f64,
    },
    /// Logarithmic growth (Cauchy).
    Cauchy {
        /// The width, in standard deviations.
        threshold: f64,
    },
    /// Bounded cost (Geman and McClure 1985).
    GemanMcClure {
        /// The width, in standard deviations.
        threshold: f64,
    },
    /// Bounded cost, no influence beyond `threshold` (Tukey's biweight).
    Tukey {
        /// Beyond this many standard deviations a residual has no weight.
        threshold: f64,
    },
}

impl RobustKernel {
    /// The weight of a squared, whitened residual in iteratively reweighted least squares.
    #[inline]
    pub fn weight(self, residual_squared: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber { threshold } => {
                let residual = residual_squared.sqrt();
                if residual <= threshold {
                    1.0
                } else {
                    threshold / residual
                }
            }
            Self::Cauchy { threshold } => 1.0 / (1.0 + residual_squared / (threshold * threshold)),
            Self::GemanMcClure { threshold } => {
                let ratio = 1.0 + residual_squared / (threshold * threshold);
                1.0 / (ratio * ratio)
            }
            Self::Tukey { threshold } => {
                let ratio = residual_squared / (threshold * threshold);
                if ratio < 1.0 {
                    (1.0 - ratio) * (1.0 - ratio)
                } else {
                    0.0
                }
            }
        }
    }

    /// The cost ρ(r²), scaled so that it equals r² for small residuals.
    pub fn cost(self, residual_squared: f64) -> f64 {
        match self {
            Self::None => residual_squared,
            Self::Huber { threshold } => {
                let residual = residual_squared.sqrt();
                if residual <= threshold {
                    residual_squared
                } else {
                    2.0 * threshold * residual - threshold * threshold
                }
            }
            Self::Cauchy { threshold } => {
                let width = threshold * threshold;
                width * (residual_squared / width).ln_1p()
            }
            Self::GemanMcClure { threshold } => {
                residual_squared / (1.0 + residual_squared / (threshold * threshold))
            }
            Self::Tukey { threshold } => {
                let width = threshold * threshold;
                let rest = (1.0 - residual_squared / width).max(0.0);
                width / 3.0 * (1.0 - rest * rest * rest)
            }
        }
    }
}

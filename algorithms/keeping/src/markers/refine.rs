//! The centre of a light from the flanks of its image, where its peak is clipped or another light
//! is near.
//!
//! The logarithm of a Gaussian is a quadratic polynomial, so one weighted linear fit gives centre,
//! width and peak (Guo 2011). Clipped pixels are left out, and streaks are long Gaussians.

use camera::Image;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

use super::light::Light;

/// A Gaussian over pixels: `exp(constant + g·x + xᵀ H x / 2)`, with `x` from the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LogParabola {
    origin_px: [f64; 2],
    constant: f64,
    gradient: Vector2<f64>,
    hessian: Matrix2<f64>,
    pub center_px: [f64; 2],
    /// Standard deviation of each coordinate of the centre.
    pub sigma_px: f64,
    sigma_log_peak: f64,
}

/// The natural logarithm of a light's peak above the background, were it not clipped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LogPeak {
    pub value: f64,
    pub sigma: f64,
}

/// From here on a pixel may be clipped.
const CLIPPED_FROM: u8 = 250;
/// Pixels below this share of the peak say more about the background than about the light.
const LEVEL_OF_CONTRAST_MIN: f64 = 0.1;
/// Below this many sigmas of the noise the logarithm is not that of the light.
const LEVEL_SIGMAS_MIN: f64 = 3.0;
/// Peaks are guessed from flanks with this share of what is missing as their sigma.
const CLIPPED_SIGMA_SHARE: f64 = 0.15;
/// Six numbers need more pixels than that.
const PIXEL_COUNT_MIN: usize = 9;
/// Pixels this far outside the brighter half still belong to the light.
const REACH_PX: f64 = 1.6;
/// A centre farther than this from where it was thought to be is no refinement.
const STEP_MAX_PX: f64 = 1.0;

impl LogParabola {
    /// Fits the pixels around a light.
    ///
    /// - `mate`: the other light of a pair; pixels nearer to it are left to it.
    /// - `other`: what the mate adds to the rest, if that is known already.
    pub fn fit(
        image: &Image,
        light: &Light,
        mate: Option<&Light>,
        noise: f64,
        other: Option<&Self>,
    ) -> Option<Self> {
        let origin_px = light.center_px;
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        let (mut squares, mut count) = (0.0, 0);
        let noise = noise.max(0.5);
        let level_min = (LEVEL_OF_CONTRAST_MIN * light.contrast).max(LEVEL_SIGMAS_MIN * noise);
        let reach_px = (f64::from(light.area_px) / std::f64::consts::PI).sqrt()
            * light.elongation.sqrt()
            + REACH_PX;
        let range = |axis: usize, side: usize| {
            let start = (origin_px[axis] - reach_px).ceil().max(0.0) as usize;
            let end = (origin_px[axis] + reach_px).floor().max(0.0) as usize + 1;
            start..end.min(side)
        };
        for y in range(1, image.height()) {
            for x in range(0, image.width()) {
                let offset = [x as f64 - origin_px[0], y as f64 - origin_px[1]];
                let pixel = image.get(x, y);
                if pixel >= CLIPPED_FROM || offset[0].hypot(offset[1]) > reach_px {
                    continue;
                }
                let at = [x as f64, y as f64];
                let is_of_mate = mate.is_some_and(|mate| {
                    let to_mate = [0, 1].map(|axis| mate.center_px[axis] - at[axis]);
                    to_mate[0].hypot(to_mate[1]) < offset[0].hypot(offset[1])
                });
                if is_of_mate {
                    continue;
                }
                let of_other = other.map_or(0.0, |other| other.level_at(at));
                let level =
                    f64::from(pixel) - light.background.behind(offset[0], offset[1]) - of_other;
                if level < level_min {
                    continue;
                }
                let [dx, dy] = offset;
                let powers = Vector6::new(1.0, dx, dy, dx * dx, dx * dy, dy * dy);
                // The noise of the logarithm is the noise over the level.
                let weighted = powers * level;
                let target = level.ln() * level;
                normal.syger(1.0, &weighted, &weighted, 1.0);
                right += weighted * target;
                squares += target * target;
                count += 1;
            }
        }
        if count < PIXEL_COUNT_MIN {
            return None;
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let factor = normal.cholesky()?;
        let solution: Vector6<f64> = factor.solve(&right);
        let inverse = factor.inverse();
        let residual = (squares - solution.dot(&right)).max(0.0) / (count as f64 - 6.0).max(1.0);
        // What the model does not explain counts as noise.
        let variance = residual.max(noise * noise);
        Self::from_solution(origin_px, &solution, &(inverse * variance))
    }

    fn from_solution(
        origin_px: [f64; 2],
        solution: &Vector6<f64>,
        solution_covariance: &Matrix6<f64>,
    ) -> Option<Self> {
        let gradient = Vector2::new(solution[1], solution[2]);
        let hessian = Matrix2::new(
            2.0 * solution[3],
            solution[4],
            solution[4],
            2.0 * solution[5],
        );
        let is_peak = hessian.trace() < 0.0 && hessian.determinant() > 0.0;
        let inverse = hessian.try_inverse().filter(|_| is_peak)?;
        let step = -inverse * gradient;
        let gradient_covariance = solution_covariance.fixed_view::<2, 2>(1, 1);
        let covariance = inverse * gradient_covariance * inverse;
        let sigma_px = (0.5 * covariance.trace()).sqrt();
        (step.norm() <= STEP_MAX_PX && sigma_px.is_finite()).then(|| Self {
            origin_px,
            constant: solution[0],
            gradient,
            hessian,
            center_px: [origin_px[0] + step.x, origin_px[1] + step.y],
            sigma_px,
            // The centre is so near the origin that the constant is the peak.
            sigma_log_peak: solution_covariance[(0, 0)].sqrt(),
        })
    }

    ///
    /// - `contrast`: of the peak as it is seen; the farther above it, the less sure.
    pub fn log_peak(&self, contrast: f64) -> LogPeak {
        let value = self.log_level_at(self.center_px);
        let clipped = (value - contrast.ln()).max(0.0);
        LogPeak {
            value,
            sigma: self.sigma_log_peak.hypot(CLIPPED_SIGMA_SHARE * clipped),
        }
    }

    /// Grey levels above the background.
    fn level_at(&self, at_px: [f64; 2]) -> f64 {
        self.log_level_at(at_px).exp()
    }

    fn log_level_at(&self, at_px: [f64; 2]) -> f64 {
        let offset = Vector2::new(at_px[0] - self.origin_px[0], at_px[1] - self.origin_px[1]);
        self.constant + self.gradient.dot(&offset) + 0.5 * offset.dot(&(self.hessian * offset))
    }
}

//! The centre of a light from the flanks of its image, where its peak is clipped or another light
//! is near.
//!
//! The logarithm of a Gaussian is a quadratic polynomial, so one weighted linear fit gives centre,
//! width and peak (Guo 2011). Clipped pixels are left out, and streaks are long Gaussians.

use camera::Image;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

use super::light::{Light, SATURATED_FROM};

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

/// Pixels below this share of the peak say more about the background than about the light.
const LEVEL_OF_CONTRAST_MIN: f64 = 0.1;
/// Below this many sigmas of the noise the logarithm is not that of the light.
const LEVEL_SIGMAS_MIN: f64 = 3.0;
/// Peaks are guessed from flanks with this share of what is clipped as their sigma, and a larger
/// share of what is clipped beyond a factor of two: little is left of those flanks.
const CLIPPED_SIGMA_SHARE: f64 = 0.1;
const DEEP_SIGMA_SHARE: f64 = 0.35;
/// Grey levels are rounded.
const NOISE_MIN: f64 = 0.5;
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
        let sums = LogSums::over(image, light, mate, noise, other);
        if sums.count < PIXEL_COUNT_MIN {
            return None;
        }
        let normal = Matrix6::from_fn(|row, column| sums.normal[row.min(column)][row.max(column)]);
        let right = Vector6::from(sums.right);
        let factor = normal.cholesky()?;
        let solution: Vector6<f64> = factor.solve(&right);
        let inverse = factor.inverse();
        let freedom = (sums.count as f64 - 6.0).max(1.0);
        let residual = (sums.squares - solution.dot(&right)).max(0.0) / freedom;
        // What the model does not explain counts as noise.
        let variance = residual.max(noise.max(NOISE_MIN).powi(2));
        Self::from_solution(light.center_px, &solution, &(inverse * variance))
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

    /// The logarithm of the fitted peak.
    ///
    /// - `contrast`: of the peak as it is seen; the farther above it, the less sure.
    pub fn log_peak(&self, contrast: f64) -> LogPeak {
        let value = self.log_level_at(self.center_px);
        let clipped = (value - contrast.ln()).max(0.0);
        let deep = (clipped - std::f64::consts::LN_2).max(0.0);
        LogPeak {
            value,
            sigma: self.sigma_log_peak + CLIPPED_SIGMA_SHARE * clipped + DEEP_SIGMA_SHARE * deep,
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

/// The normal equations of the fit, as sums over the pixels of a light.
struct LogSums {
    count: usize,
    /// Its upper triangle.
    normal: [[f64; 6]; 6],
    right: [f64; 6],
    squares: f64,
}

impl LogSums {
    fn over(
        image: &Image,
        light: &Light,
        mate: Option<&Light>,
        noise: f64,
        other: Option<&LogParabola>,
    ) -> Self {
        let mut sums = Self {
            count: 0,
            normal: [[0.0; 6]; 6],
            right: [0.0; 6],
            squares: 0.0,
        };
        let [center_x, center_y] = light.center_px;
        let level_min =
            (LEVEL_OF_CONTRAST_MIN * light.contrast).max(LEVEL_SIGMAS_MIN * noise.max(NOISE_MIN));
        let radius_px = (f64::from(light.area_px) / std::f64::consts::PI).sqrt();
        let reach_px = radius_px * light.elongation.sqrt() + REACH_PX;
        let range = |center: f64, side: usize| {
            let start = (center - reach_px).ceil().max(0.0) as usize;
            let end = (center + reach_px).floor().max(0.0) as usize + 1;
            start.min(side)..end.min(side)
        };
        for y in range(center_y, image.height()) {
            let dy = y as f64 - center_y;
            let columns = range(center_x, image.width());
            for (x, pixel) in columns.clone().zip(&image.row(y)[columns]) {
                let dx = x as f64 - center_x;
                let distance_squared = dx * dx + dy * dy;
                if *pixel >= SATURATED_FROM || distance_squared > reach_px * reach_px {
                    continue;
                }
                let at = [x as f64, y as f64];
                let is_of_mate = mate.is_some_and(|mate| {
                    let to_mate = [0, 1].map(|axis| mate.center_px[axis] - at[axis]);
                    to_mate[0] * to_mate[0] + to_mate[1] * to_mate[1] < distance_squared
                });
                let of_other = other.map_or(0.0, |other| other.level_at(at));
                let level = f64::from(*pixel) - light.background.behind(dx, dy) - of_other;
                if level >= level_min && !is_of_mate {
                    sums.add(dx, dy, level);
                }
            }
        }
        sums
    }

    /// The noise of the logarithm is the noise over the level, hence the weights.
    fn add(&mut self, dx: f64, dy: f64, level: f64) {
        let powers = [1.0, dx, dy, dx * dx, dx * dy, dy * dy];
        let target = level.ln();
        let weight = level * level;
        let rows = self.normal.iter_mut().zip(&mut self.right);
        for (row, (sums, right)) in rows.enumerate() {
            let weighted = weight * powers[row];
            for (sum, power) in sums.iter_mut().zip(powers).skip(row) {
                *sum += weighted * power;
            }
            *right += weighted * target;
        }
        self.squares += weight * target * target;
        self.count += 1;
    }
}

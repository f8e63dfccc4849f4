//! Which two lights belong together.

use camera::Image;

use super::light::Light;
use super::refine::LogParabola;

/// Two lights of one neighbour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerPair {
    /// The upper one first, or the left one if they are level.
    pub lights: [Light; 2],
    /// Half-way between them.
    pub center_px: [f64; 2],
    pub separation_px: f64,
    pub sigma_separation_px: f64,
    /// How unlike a pair they are; zero for equal lights along the expected baseline.
    pub mismatch: f64,
}

/// A neighbour so far away that its lights are one blob: farther than
/// `fx · baseline / separation_px_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MergedPair {
    pub center_px: [f64; 2],
    /// The lights would be told apart if they were this far from each other.
    pub separation_px_max: f64,
    /// From the blob's shape; about half a pixel good.
    pub separation_px: f64,
}

/// Which lights may be a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PairGates {
    pub separation_px_min: f64,
    pub separation_px_max: f64,
    pub baseline_rad: f64,
    pub tilt_max_rad: f64,
    pub area_ratio_max: f64,
    pub contrast_ratio_max: f64,
}

/// Two lights, by number, and how unlike a pair they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    mismatch: f64,
    first: u16,
    second: u16,
}

/// Brightness of the two lights of one drone, one standard deviation of its log.
const LOG_FLUX_SIGMA: f64 = 0.2;
/// A whole number of pixels: coarse for small lights.
const LOG_AREA_SIGMA: f64 = 0.4;
/// Lights of one drone have the same shape, whatever blurs them.
const ELONGATION_SIGMA: f64 = 0.6;

/// The angle between two undirected lines, `0..=π/2`.
pub(super) fn angle_between_lines(a_rad: f64, b_rad: f64) -> f64 {
    let turn = (a_rad - b_rad).rem_euclid(std::f64::consts::PI);
    turn.min(std::f64::consts::PI - turn)
}

/// Finds disjoint pairs, the likeliest first.
///
/// - `candidates`, `taken`: buffers, cleared here.
/// - `pairs`: filled up to its capacity.
pub(super) fn find_pairs(
    lights: &[Light],
    gates: &PairGates,
    candidates: &mut Vec<Candidate>,
    taken: &mut Vec<bool>,
    pairs: &mut Vec<MarkerPair>,
) {
    candidates.clear();
    for (first, a) in lights.iter().enumerate() {
        for (second, b) in lights.iter().enumerate().skip(first + 1) {
            if candidates.len() == candidates.capacity() {
                break;
            }
            if let Some(mismatch) = mismatch(a, b, gates) {
                candidates.push(Candidate {
                    mismatch,
                    first: first as u16,
                    second: second as u16,
                });
            }
        }
    }
    candidates.sort_unstable_by(|a, b| {
        let order = a.mismatch.total_cmp(&b.mismatch);
        order.then((a.first, a.second).cmp(&(b.first, b.second)))
    });
    taken.clear();
    taken.resize(lights.len(), false);
    for candidate in candidates {
        let (first, second) = (usize::from(candidate.first), usize::from(candidate.second));
        if taken[first] || taken[second] || pairs.len() == pairs.capacity() {
            continue;
        }
        taken[first] = true;
        taken[second] = true;
        pairs.push(MarkerPair::of(
            lights[first],
            lights[second],
            candidate.mismatch,
        ));
    }
}

/// `None` if they are no pair for sure.
fn mismatch(a: &Light, b: &Light, gates: &PairGates) -> Option<f64> {
    let offset = [0, 1].map(|axis| b.center_px[axis] - a.center_px[axis]);
    let separation_px = offset[0].hypot(offset[1]);
    if !(gates.separation_px_min..=gates.separation_px_max).contains(&separation_px) {
        return None;
    }
    let tilt = angle_between_lines(offset[1].atan2(offset[0]), gates.baseline_rad);
    let log_area = (f64::from(a.area_px) / f64::from(b.area_px)).ln().abs();
    let log_contrast = (a.contrast / b.contrast).ln().abs();
    // Clipped peaks are equal, however different the backgrounds are.
    let log_contrast = if a.saturated && b.saturated {
        0.0
    } else {
        log_contrast
    };
    let is_possible = tilt <= gates.tilt_max_rad
        && log_area <= gates.area_ratio_max.ln()
        && log_contrast <= gates.contrast_ratio_max.ln();
    let log_flux = (a.flux / b.flux).ln();
    let square = |value: f64| value * value;
    is_possible.then(|| {
        square(log_flux / LOG_FLUX_SIGMA)
            + square(log_area / LOG_AREA_SIGMA)
            + square((a.elongation - b.elongation) / ELONGATION_SIGMA)
            + square(tilt / gates.tilt_max_rad)
            + separation_px / gates.separation_px_max
    })
}

/// Closer lights than this add to each other's flanks.
const OVERLAP_PX: f64 = 9.0;
/// How often each light is measured without the other.
const OVERLAP_ROUNDS: usize = 2;

impl MarkerPair {
    /// Measures both lights again, where that is better than their centroids.
    pub(super) fn refine(&mut self, image: &Image, noise: f64) {
        let [first, second] = &self.lights;
        let fit = |idx: usize, other: Option<&LogParabola>| {
            let (light, mate) = if idx == 0 {
                (first, second)
            } else {
                (second, first)
            };
            LogParabola::fit(image, light, mate, noise, other)
        };
        let mut fits = [0, 1].map(|idx| fit(idx, None));
        let overlaps = self.separation_px < OVERLAP_PX;
        for _ in 0..if overlaps { OVERLAP_ROUNDS } else { 0 } {
            let before = fits;
            fits = [0, 1].map(|idx| fit(idx, before[1 - idx].as_ref()));
        }
        for (light, fit) in self.lights.iter_mut().zip(fits) {
            let is_better = (light.saturated || overlaps) && !light.is_before_edge();
            if let Some(fit) = fit.filter(|_| is_better) {
                light.center_px = fit.center_px;
                light.sigma_px = fit.sigma_px;
            }
        }
        *self = Self::of(self.lights[0], self.lights[1], self.mismatch);
    }

    fn of(a: Light, b: Light, mismatch: f64) -> Self {
        let [ax, ay] = a.center_px;
        let [bx, by] = b.center_px;
        let lights = if (ay, ax) <= (by, bx) { [a, b] } else { [b, a] };
        Self {
            lights,
            center_px: [0.5 * (ax + bx), 0.5 * (ay + by)],
            separation_px: (ax - bx).hypot(ay - by),
            sigma_separation_px: a.sigma_px.hypot(b.sigma_px),
            mismatch,
        }
    }
}

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

/// The least likely are not given.
pub(super) const PAIR_COUNT_MAX: usize = 16;
/// Every pair of [`super::finder`]'s lights, once.
pub(super) const CANDIDATE_COUNT_MAX: usize = 512;
/// Brightness of the two lights of one drone, one standard deviation of its logarithm.
const LOG_CONTRAST_SIGMA: f64 = 0.15;
/// A whole number of pixels: coarse for small lights.
const LOG_AREA_SIGMA: f64 = 0.4;
/// Lights of one drone have the same shape, whatever blurs them.
const ELONGATION_SIGMA: f64 = 0.6;

/// True pairs stay below 10, in every kind of light.
const UNLIKENESS_MAX: f64 = 12.0;

/// The angle between two undirected lines, `0..=π/2`.
pub(super) fn angle_between_lines(a_rad: f64, b_rad: f64) -> f64 {
    let turn = (a_rad - b_rad).rem_euclid(std::f64::consts::PI);
    turn.min(std::f64::consts::PI - turn)
}

/// Finds disjoint pairs, the likeliest first.
///
/// - `noise`: of a pixel of `image`.
/// - `candidates`, `taken`: buffers, cleared here.
/// - `pairs`: filled up to [`PAIR_COUNT_MAX`].
pub(super) fn find_pairs(
    image: &Image,
    noise: f64,
    lights: &mut [Light],
    gates: &PairGates,
    candidates: &mut Vec<Candidate>,
    taken: &mut Vec<bool>,
    pairs: &mut Vec<MarkerPair>,
) {
    candidates.clear();
    for (first, a) in lights.iter().enumerate() {
        for (second, b) in lights.iter().enumerate().skip(first + 1) {
            if candidates.len() == CANDIDATE_COUNT_MAX {
                break;
            }
            if fits_geometry(a, b, gates) {
                candidates.push(Candidate {
                    mismatch: 0.0,
                    first: first as u16,
                    second: second as u16,
                });
            }
        }
    }
    taken.clear();
    taken.resize(lights.len(), false);
    for candidate in candidates.iter() {
        for idx in candidate.lights() {
            // Only lights that may have a mate are worth the time.
            if !std::mem::replace(&mut taken[idx], true) {
                lights[idx].fit_flanks(image, noise);
            }
        }
    }
    candidates.retain_mut(|candidate| {
        let [first, second] = candidate.lights();
        let mismatch = mismatch(&lights[first], &lights[second], gates);
        candidate.mismatch = mismatch.unwrap_or(f64::INFINITY);
        mismatch.is_some()
    });
    candidates.sort_unstable_by(|a, b| {
        let order = a.mismatch.total_cmp(&b.mismatch);
        order.then((a.first, a.second).cmp(&(b.first, b.second)))
    });
    taken.fill(false);
    for candidate in candidates {
        let [first, second] = candidate.lights();
        if taken[first] || taken[second] || pairs.len() == PAIR_COUNT_MAX {
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

impl Candidate {
    fn lights(&self) -> [usize; 2] {
        [self.first, self.second].map(usize::from)
    }
}

/// Separation, and angle from the expected baseline.
fn geometry(a: &Light, b: &Light, gates: &PairGates) -> (f64, f64) {
    let offset = [0, 1].map(|axis| b.center_px[axis] - a.center_px[axis]);
    let tilt = angle_between_lines(offset[1].atan2(offset[0]), gates.baseline_rad);
    (offset[0].hypot(offset[1]), tilt)
}

fn fits_geometry(a: &Light, b: &Light, gates: &PairGates) -> bool {
    let (separation_px, tilt) = geometry(a, b, gates);
    (gates.separation_px_min..=gates.separation_px_max).contains(&separation_px)
        && tilt <= gates.tilt_max_rad
}

/// `None` if their brightness or size says that they are no pair.
fn mismatch(a: &Light, b: &Light, gates: &PairGates) -> Option<f64> {
    let (separation_px, tilt) = geometry(a, b, gates);
    let log_area = (f64::from(a.area_px) / f64::from(b.area_px)).ln().abs();
    let (log_contrast, sigma) = compare_brightness(a, b, separation_px);
    let is_possible = log_area <= gates.area_ratio_max.ln()
        && log_contrast <= gates.contrast_ratio_max.ln() + GATE_SIGMAS * sigma;
    let contrast_sigma = sigma.hypot(LOG_CONTRAST_SIGMA);
    let square = |value: f64| value * value;
    let unlikeness = square(log_contrast / contrast_sigma)
        + square(log_area / LOG_AREA_SIGMA)
        + square((a.elongation - b.elongation) / ELONGATION_SIGMA)
        + square(tilt / gates.tilt_max_rad);
    // Strangers are the likelier to stand in line the larger the distance: its logarithm counts
    // twice, as in a likelihood.
    let mismatch = unlikeness + 2.0 * (separation_px / gates.separation_px_min).ln();
    (is_possible && unlikeness <= UNLIKENESS_MAX).then_some(mismatch)
}

/// How far apart the logarithms of their brightness are, and how well that is known.
///
/// Clipped peaks are equal; flanks tell them apart, unless other things disturb those.
fn compare_brightness(a: &Light, b: &Light, separation_px: f64) -> (f64, f64) {
    let disturbance = if separation_px < OVERLAP_PX {
        OVERLAP_LOG_SIGMA
    } else {
        0.0
    };
    match a.log_peak().zip(b.log_peak()) {
        Some((a, b)) => {
            let sigma = a.sigma.hypot(b.sigma).hypot(disturbance);
            ((a.value - b.value).abs(), sigma)
        }
        None if a.saturated && b.saturated => (0.0, 0.0),
        None => ((a.contrast / b.contrast).ln().abs(), 0.0),
    }
}

/// Closer lights than this add to each other's flanks.
const OVERLAP_PX: f64 = 9.0;
/// And make each other's peaks uncertain by this.
const OVERLAP_LOG_SIGMA: f64 = 0.4;
/// Gates open by this many sigmas of what is compared.
const GATE_SIGMAS: f64 = 3.0;
/// How often each light is measured without the other.
const OVERLAP_ROUNDS: usize = 2;

impl MarkerPair {
    /// Measures the lights by their flanks, where that is better than their centroids: where
    /// peaks are clipped, and where each shines on the other's flanks.
    pub(super) fn refine(&mut self, image: &Image, noise: f64) {
        let overlaps = self.separation_px < OVERLAP_PX;
        let before_edge = self.lights.iter().any(Light::is_before_edge);
        let flanks = if overlaps && !before_edge {
            self.separate_flanks(image, noise)
        } else {
            self.lights.map(|light| light.flanks)
        };
        for (light, flanks) in self.lights.iter_mut().zip(flanks) {
            if let Some(flanks) = flanks.filter(|_| light.saturated || overlaps) {
                light.move_to(&flanks);
            }
        }
        *self = Self::of(self.lights[0], self.lights[1], self.mismatch);
    }

    /// Of the brighter of its lights.
    pub(super) fn log_peak_bounds(&self) -> [f64; 2] {
        let [first, second] = self.lights.map(|light| light.log_peak_bounds());
        [0, 1].map(|bound| f64::max(first[bound], second[bound]))
    }

    /// Fits each light without what the other adds to it.
    fn separate_flanks(&self, image: &Image, noise: f64) -> [Option<LogParabola>; 2] {
        let [first, second] = &self.lights;
        let fit = |idx: usize, other: Option<&LogParabola>| {
            let (light, mate) = if idx == 0 {
                (first, second)
            } else {
                (second, first)
            };
            LogParabola::fit(image, light, Some(mate), noise, other)
        };
        let mut fits = [0, 1].map(|idx| fit(idx, None));
        for _ in 0..OVERLAP_ROUNDS {
            let before = fits;
            fits = [0, 1].map(|idx| fit(idx, before[1 - idx].as_ref()));
        }
        fits
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

//! One light: told from its background, and measured to a fraction of a pixel.

use camera::Image;

use super::background::{
    self, BOX_SIDE_MAX_PX, Background, PixelBox, RING_MARGIN_PX, RING_SIDE_MAX_PX,
};
use super::refine::{LogParabola, LogPeak};
use super::runs::Component;

/// A small bright blob.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Column and row of its centre.
    pub center_px: [f64; 2],
    /// Standard deviation of each coordinate of the centre.
    pub sigma_px: f64,
    /// Pixels brighter than half-way between background and peak.
    pub area_px: u32,
    /// Grey levels of its brightest pixel above the background.
    pub contrast: f64,
    /// Sum of grey levels above the background, near its centre more than far from it.
    pub flux: f64,
    /// Flux in standard deviations of its noise.
    pub signal_to_noise: f64,
    /// The sensor could not resolve its centre.
    pub saturated: bool,
    /// How much longer than wide it is.
    pub elongation: f64,
    /// Direction of its long side, from the image's x axis towards its y axis, in `-π/2..=π/2`.
    pub axis_rad: f64,
    /// Standard deviations of its brighter half along and across that direction.
    pub spread_px: [f64; 2],
    pub(super) background: Background,
    /// What its flanks tell, unless there is an edge behind them.
    pub(super) flanks: Option<LogParabola>,
}

impl Light {
    pub(super) fn log_peak(&self) -> Option<LogPeak> {
        self.flanks.map(|flanks| flanks.log_peak(self.contrast))
    }

    /// The logarithm of its peak above the background: at least, and at most. A clipped peak may be
    /// anything; its flanks say how much it is at least.
    pub(super) fn log_peak_bounds(&self) -> [f64; 2] {
        let seen = self.contrast.ln();
        if !self.saturated {
            return [seen, seen];
        }
        let fitted = self.log_peak();
        let at_least = fitted.map_or(seen, |peak| seen.max(peak.value - peak.sigma));
        [at_least, f64::INFINITY]
    }

    /// Fits its flanks, if they tell anything.
    pub(super) fn fit_flanks(&mut self, image: &Image, noise: f64) {
        if !self.is_before_edge() {
            self.flanks = LogParabola::fit(image, self, None, noise, None);
        }
    }

    pub(super) fn move_to(&mut self, flanks: &LogParabola) {
        self.center_px = flanks.center_px;
        self.sigma_px = flanks.sigma_px;
    }

    /// What is behind it differs too much from side to side to be taken from its flanks.
    pub(super) fn is_before_edge(&self) -> bool {
        self.background.edge() > EDGE_OF_CONTRAST_MAX * self.contrast
    }
}

/// What counts as a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LightGates {
    pub noise: f64,
    pub contrast_min: f64,
    /// The same for lights whose peak is clipped.
    pub clipped_contrast_min: f64,
    pub signal_to_noise_min: f64,
    pub area_px_max: u32,
    pub elongation_max: f64,
}

/// Blobs of fewer pixels are hot pixels or noise.
const AREA_PX_MIN: u32 = 2;
/// A lens spreads a point: 3×3 pixels hold at least this many times the peak.
const CORE_OF_PEAK_MIN: f64 = 2.2;
/// Radius of a round blob at half its height, in sigmas of its Gaussian.
const HALF_HEIGHT_SIGMAS: f64 = 1.1774;
/// Narrower weights would see single pixels.
const WEIGHT_SIGMA_MIN_PX: f64 = 0.85;
const WEIGHT_SIGMA_MAX_PX: f64 = 4.0;
/// Weights end here.
const WEIGHT_REACH_SIGMAS: f64 = 3.0;
const WEIGHT_SIDE_MAX_PX: usize = 2 * 13 + 1;
const CENTROID_ROUNDS: usize = 4;
const CENTROID_STEP_MAX_PX: f64 = 1.0;
const CENTROID_STEP_MIN_PX: f64 = 0.03;
const SLOPE_OF_FLUX_MIN: f64 = 0.1;
/// Flanks tell more than the shape of the brighter half unless an edge is this share of them.
const EDGE_OF_CONTRAST_MAX: f64 = 0.25;
/// Accuracy of the centre of the brighter half.
const SIGMA_OF_HALF_PX: f64 = 0.1;
/// Sampling and rounding leave this much even without noise.
const SIGMA_FLOOR_PX: f64 = 0.012;
/// From here on a pixel may be clipped.
pub(super) const SATURATED_FROM: u8 = 250;

/// Rows of bits, one for each pixel inside a ring and on it.
type Mask = [u32; RING_SIDE_MAX_PX];

/// Gives `emit` each light in a component of pixels that stand out.
///
/// Two lights whose tails meet are one component and are told apart by its brighter half.
pub(super) fn measure(
    image: &Image,
    component: &Component,
    gates: &LightGates,
    mut emit: impl FnMut(Light),
) {
    if component.area_px < AREA_PX_MIN {
        return;
    }
    let too_long = |low: u16, high: u16| high - low >= BOX_SIDE_MAX_PX;
    if too_long(component.left, component.right) || too_long(component.top, component.bottom) {
        return;
    }
    let area = PixelBox::around(component, RING_MARGIN_PX, image);
    let peak = brightest(image, &PixelBox::around(component, 0, image));
    let background = background::around(image, component, gates.noise);
    if f64::from(peak) - background.upper < gates.clipped_contrast_min {
        return;
    }
    // Half-way above the brighter side of what is around it.
    let half_level = 0.5 * (f64::from(peak) + background.upper);
    let mut mask = mask_above(image, &area, half_level);
    while let Some(blob_mask) = take_blob(&mut mask) {
        // What reaches the ring goes on outside: a cable, or a light with a component of its own.
        if reaches_ring(&blob_mask, &area, image) {
            continue;
        }
        let blob = Blob::of(&blob_mask, &area, image);
        if let Some(light) = blob.measure(image, &background, &area, &blob_mask, gates) {
            emit(light);
        }
    }
}

fn brightest(image: &Image, area: &PixelBox) -> u8 {
    (area.top..=area.bottom)
        .flat_map(|y| &image.row(y)[area.left..=area.right])
        .copied()
        .max()
        .unwrap_or(0)
}

fn mask_above(image: &Image, area: &PixelBox, level: f64) -> Mask {
    // The smallest whole level above; levels lie below the peak.
    let from = level.floor() as u8 + 1;
    let mut mask = Mask::default();
    for (bits, y) in mask.iter_mut().zip(area.top..=area.bottom) {
        let row = &image.row(y)[area.left..=area.right];
        for (idx, pixel) in row.iter().enumerate() {
            *bits |= u32::from(*pixel >= from) << idx;
        }
    }
    mask
}

/// Takes one 8-connected blob out of the mask, by growing a bit until it fills its blob.
fn take_blob(mask: &mut Mask) -> Option<Mask> {
    let first_row = mask.iter().position(|bits| *bits != 0)?;
    let mut blob = Mask::default();
    blob[first_row] = mask[first_row] & mask[first_row].wrapping_neg();
    loop {
        let mut changed = false;
        // Downwards and upwards in turn, so that convex blobs take two sweeps.
        for row in (first_row..mask.len()).chain((first_row..mask.len()).rev()) {
            let above = if row > 0 { blob[row - 1] } else { 0 };
            let below = blob.get(row + 1).copied().unwrap_or(0);
            let mut grown = widen(above | below | blob[row]) & mask[row];
            grown |= widen(grown) & mask[row];
            changed |= grown != blob[row];
            blob[row] = grown;
        }
        if !changed {
            break;
        }
    }
    for (bits, taken) in mask.iter_mut().zip(blob) {
        *bits &= !taken;
    }
    Some(blob)
}

/// Whether a blob touches the ring; the edge of the image is none.
fn reaches_ring(blob: &Mask, area: &PixelBox, image: &Image) -> bool {
    let (width, height) = (area.right - area.left, area.bottom - area.top);
    let columns = blob.iter().fold(0, |any, bits| any | bits);
    area.top > 0 && blob[0] != 0
        || area.bottom + 1 < image.height() && blob[height] != 0
        || area.left > 0 && columns & 1 != 0
        || area.right + 1 < image.width() && columns >> width != 0
}

/// Pixels in the brighter half of a light.
struct Blob {
    area_px: u32,
    mean_px: [f64; 2],
    /// Of the pixels' places: xx, xy, yy.
    covariance: [f64; 3],
    peak: u8,
}

impl Blob {
    fn of(mask: &Mask, area: &PixelBox, image: &Image) -> Self {
        let (mut count, mut sum, mut squares) = (0_u32, [0_u32; 2], [0_u32; 3]);
        let mut peak = 0;
        for (row, bits) in mask.iter().enumerate() {
            let mut rest = *bits;
            while rest != 0 {
                let column = rest.trailing_zeros();
                rest &= rest - 1;
                let (x, y) = (column, row as u32);
                count += 1;
                sum[0] += x;
                sum[1] += y;
                squares[0] += x * x;
                squares[1] += x * y;
                squares[2] += y * y;
                peak = peak.max(image.get(area.left + column as usize, area.top + row));
            }
        }
        let scale = 1.0 / f64::from(count);
        let [x, y] = sum.map(|sum| f64::from(sum) * scale);
        let [xx, xy, yy] = squares.map(|sum| f64::from(sum) * scale);
        Self {
            area_px: count,
            mean_px: [area.left as f64 + x, area.top as f64 + y],
            covariance: [xx - x * x, xy - x * y, yy - y * y],
            peak,
        }
    }

    /// Standard deviations along and across its long side, and that side's direction. A pixel is
    /// as wide as a pixel.
    fn axes(&self) -> ([f64; 2], f64) {
        let [xx, xy, yy] = self.covariance;
        let half_trace = 0.5 * (xx + yy) + 1.0 / 12.0;
        let half_gap = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        let spread = [
            half_trace + half_gap,
            (half_trace - half_gap).max(1.0 / 12.0),
        ];
        (spread.map(f64::sqrt), 0.5 * (2.0 * xy).atan2(xx - yy))
    }

    fn measure(
        &self,
        image: &Image,
        background: &Background,
        area: &PixelBox,
        mask: &Mask,
        gates: &LightGates,
    ) -> Option<Light> {
        let contrast = f64::from(self.peak) - background.level;
        let (spread_px, axis_rad) = self.axes();
        let elongation = spread_px[0] / spread_px[1];
        let is_compact = (AREA_PX_MIN..=gates.area_px_max).contains(&self.area_px)
            && elongation <= gates.elongation_max;
        let saturated = self.peak >= SATURATED_FROM;
        let contrast_min = if saturated {
            gates.clipped_contrast_min
        } else {
            gates.contrast_min
        };
        if contrast < contrast_min || !is_compact {
            return None;
        }
        if core_sum(image, self.mean_px, background.level) < CORE_OF_PEAK_MIN * contrast {
            return None;
        }
        let sigma_px = (f64::from(self.area_px) / std::f64::consts::PI).sqrt() / HALF_HEIGHT_SIGMAS;
        let weights = Weights::new(sigma_px.clamp(WEIGHT_SIGMA_MIN_PX, WEIGHT_SIGMA_MAX_PX));
        let centroid = weights.centroid(image, self.mean_px, background, gates.noise)?;
        let mut light = Light {
            center_px: centroid.center_px,
            sigma_px: centroid.sigma_px.hypot(SIGMA_FLOOR_PX),
            area_px: self.area_px,
            contrast,
            flux: centroid.flux,
            signal_to_noise: centroid.signal_to_noise,
            saturated,
            elongation,
            axis_rad,
            spread_px,
            background: *background,
            flanks: None,
        };
        if light.saturated && light.is_before_edge() {
            light.center_px = half_centroid(mask, area, image, background.upper);
            light.sigma_px = SIGMA_OF_HALF_PX;
        }
        let is_usable = area.contains(centroid.center_px)
            && centroid.signal_to_noise >= gates.signal_to_noise_min;
        is_usable.then_some(light)
    }
}

/// The centroid of a blob and the pixels that touch it, above the brighter side of what is behind.
fn half_centroid(mask: &Mask, area: &PixelBox, image: &Image, upper: f64) -> [f64; 2] {
    let row_bits = |row: usize| mask.get(row).copied().unwrap_or(0);
    let (mut sum, mut moment) = (0.0, [0.0; 2]);
    for (row, y) in (area.top..=area.bottom).enumerate() {
        let near = row_bits(row) | row_bits(row.wrapping_sub(1)) | row_bits(row + 1);
        let near = widen(near);
        for (column, x) in (area.left..=area.right).enumerate() {
            if near >> column & 1 == 0 {
                continue;
            }
            let level = (f64::from(image.get(x, y)) - upper).max(0.0);
            sum += level;
            moment[0] += level * x as f64;
            moment[1] += level * y as f64;
        }
    }
    moment.map(|moment| moment / sum)
}

/// The bits and their neighbours.
fn widen(bits: u32) -> u32 {
    bits | bits << 1 | bits >> 1
}

/// The sum of the 3×3 pixels at a centre, above the background.
fn core_sum(image: &Image, center_px: [f64; 2], background: f64) -> f64 {
    let [x, y] = center_px.map(|value| value.round() as usize);
    let mut sum = 0.0;
    for row in y.saturating_sub(1)..=(y + 1).min(image.height() - 1) {
        for column in x.saturating_sub(1)..=(x + 1).min(image.width() - 1) {
            sum += f64::from(image.get(column, row)) - background;
        }
    }
    sum
}

struct Centroid {
    center_px: [f64; 2],
    sigma_px: f64,
    flux: f64,
    signal_to_noise: f64,
}

/// A round Gaussian that weighs pixels by their distance from the centre.
struct Weights {
    sigma_px: f64,
    radius_px: usize,
}

/// Weighted sums over a window.
#[derive(Default)]
struct WeightedSums {
    flux: f64,
    moment: [f64; 2],
    /// Second moments, in units of the weights' own.
    curvature: [f64; 2],
    squared_weights: f64,
    squared_moments: [f64; 2],
}

impl Weights {
    fn new(sigma_px: f64) -> Self {
        Self {
            sigma_px,
            radius_px: (WEIGHT_REACH_SIGMAS * sigma_px).ceil() as usize,
        }
    }

    /// Moves the weights until their centroid is their centre (Newton's method): what is left of
    /// the noise is near the least possible, and neither a light beside it nor a clipped peak
    /// pulls it away.
    fn centroid(
        &self,
        image: &Image,
        start_px: [f64; 2],
        background: &Background,
        noise: f64,
    ) -> Option<Centroid> {
        let mut center_px = start_px;
        let mut sums = WeightedSums::default();
        for _ in 0..CENTROID_ROUNDS {
            sums = self.sum(image, center_px, background)?;
            let mut largest_step: f64 = 0.0;
            for (axis, center) in center_px.iter_mut().enumerate() {
                let step = (sums.moment[axis] / sums.slope(axis))
                    .clamp(-CENTROID_STEP_MAX_PX, CENTROID_STEP_MAX_PX);
                *center += step;
                largest_step = largest_step.max(step.abs());
            }
            // The next step would be about its square.
            if largest_step < CENTROID_STEP_MIN_PX {
                break;
            }
        }
        let sigma_px = |axis: usize| noise * sums.squared_moments[axis].sqrt() / sums.slope(axis);
        Some(Centroid {
            center_px,
            sigma_px: 0.5 * (sigma_px(0) + sigma_px(1)),
            flux: sums.flux,
            signal_to_noise: sums.flux / (noise.max(0.5) * sums.squared_weights.sqrt()),
        })
    }

    /// `None` if nothing there is brighter than the background.
    fn sum(
        &self,
        image: &Image,
        center_px: [f64; 2],
        background: &Background,
    ) -> Option<WeightedSums> {
        let mut falloff = [[0.0; WEIGHT_SIDE_MAX_PX]; 2];
        let sides = [image.width(), image.height()];
        let mut range = [(0, 0); 2];
        for axis in 0..2 {
            let middle = center_px[axis].round();
            if !(middle >= 0.0 && middle < sides[axis] as f64) {
                return None;
            }
            let middle = middle as usize;
            let start = middle.saturating_sub(self.radius_px);
            let end = (middle + self.radius_px + 1).min(sides[axis]);
            range[axis] = (start, end);
            for (weight, at) in falloff[axis].iter_mut().zip(start..end) {
                let offset = (at as f64 - center_px[axis]) / self.sigma_px;
                *weight = (-0.5 * offset * offset).exp();
            }
        }
        let mut sums = WeightedSums::default();
        for (weight_y, y) in falloff[1].iter().zip(range[1].0..range[1].1) {
            let dy = y as f64 - center_px[1];
            let row = &image.row(y)[range[0].0..range[0].1];
            for (idx, (pixel, weight_x)) in row.iter().zip(&falloff[0]).enumerate() {
                let dx = (range[0].0 + idx) as f64 - center_px[0];
                let weight = weight_x * weight_y;
                let value = weight * (f64::from(*pixel) - background.behind(dx, dy));
                sums.flux += value;
                sums.moment[0] += value * dx;
                sums.moment[1] += value * dy;
                sums.curvature[0] += value * dx * dx;
                sums.curvature[1] += value * dy * dy;
                sums.squared_weights += weight * weight;
                sums.squared_moments[0] += (weight * dx).powi(2);
                sums.squared_moments[1] += (weight * dy).powi(2);
            }
        }
        for curvature in &mut sums.curvature {
            *curvature /= self.sigma_px.powi(2);
        }
        (sums.flux > 0.0).then_some(sums)
    }
}

impl WeightedSums {
    /// How fast the moment falls as the weights move. Half the flux for a light as wide as the
    /// weights; near zero for a plain, where the centre is anywhere.
    fn slope(&self, axis: usize) -> f64 {
        (self.flux - self.curvature[axis]).max(SLOPE_OF_FLUX_MIN * self.flux)
    }
}

//! The paper's pipeline as it is written (section 2.1.1): one threshold, connected components, the
//! closest pair of plausible direction, nearest-neighbour association, a low-pass filter.
//!
//! Kept for comparison and for the paper's flight test; [`super::PairFinder`] is what flies.

use std::f64::consts::FRAC_PI_2;
use std::ops::RangeInclusive;

use camera::Image;
use geometry::Timestamp;

use super::pairs::angle_between_lines;
use super::runs::{RunJoiner, bright_runs};

/// The numbers of the pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperPipelineSettings {
    /// Pixels from this grey level on belong to lights.
    pub threshold: u8,
    pub area_px: RangeInclusive<u32>,
    pub separation_px: RangeInclusive<f64>,
    /// Direction of the baseline in the image, from its x axis towards its y axis.
    pub baseline_rad: f64,
    pub tilt_max_rad: f64,
    /// Markers keep their identity over steps up to this.
    pub association_px: f64,
    /// Time constant of the low-pass filter.
    pub low_pass_s: f64,
}

impl Default for PaperPipelineSettings {
    fn default() -> Self {
        Self {
            threshold: 230,
            area_px: 1..=120,
            separation_px: 2.0..=60.0,
            baseline_rad: FRAC_PI_2,
            tilt_max_rad: 20_f64.to_radians(),
            association_px: 12.0,
            low_pass_s: 0.2,
        }
    }
}

/// The pair of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperPair {
    /// Each marker keeps its place in this list from frame to frame.
    pub markers_px: [[f64; 2]; 2],
    /// `dist_meas` before the filter.
    pub separation_raw_px: f64,
    pub separation_px: f64,
    /// Column of the middle of both markers, before the filter.
    pub u_raw_px: f64,
    pub u_px: f64,
    /// The markers were not where they had been: identities and filter start again.
    pub reacquired: bool,
}

/// The paper's pipeline; it remembers the pair of the frame before.
#[derive(Clone, Debug)]
pub struct PaperPipeline {
    settings: PaperPipelineSettings,
    joiner: RunJoiner,
    centroids_px: Vec<[f64; 2]>,
    previous: Option<(PaperPair, Timestamp)>,
}

/// Bounds time and memory; a frame with more is refused as a whole.
const RUN_COUNT_MAX: u16 = 1024;

impl PaperPipeline {
    pub fn new(settings: PaperPipelineSettings) -> Self {
        Self {
            settings,
            joiner: RunJoiner::with_run_count_max(RUN_COUNT_MAX),
            centroids_px: Vec::with_capacity(usize::from(RUN_COUNT_MAX)),
            previous: None,
        }
    }

    /// The pair in this image, or `None` if there is none; the next image may have one again.
    pub fn find(&mut self, image: &Image, captured_at: Timestamp) -> Option<PaperPair> {
        let measured_px = self.closest_pair(image)?;
        let pair = self.associate(measured_px, captured_at);
        self.previous = Some((pair, captured_at));
        Some(pair)
    }

    fn closest_pair(&mut self, image: &Image) -> Option<[[f64; 2]; 2]> {
        self.joiner.clear();
        for y in 0..image.height() {
            for run in bright_runs(image.row(y), y, self.settings.threshold) {
                self.joiner.push(run).ok()?;
            }
        }
        let components = self.joiner.components().iter();
        self.centroids_px.clear();
        self.centroids_px.extend(
            components
                .filter(|component| self.settings.area_px.contains(&component.area_px))
                .map(|component| component.centroid_px()),
        );
        let mut closest: Option<(f64, [[f64; 2]; 2])> = None;
        for (idx, a) in self.centroids_px.iter().enumerate() {
            for b in &self.centroids_px[idx + 1..] {
                let separation_px = separation_px(&[*a, *b]);
                let is_closer = closest.is_none_or(|(least, _)| separation_px < least);
                if is_closer && self.is_plausible(a, b, separation_px) {
                    closest = Some((separation_px, [*a, *b]));
                }
            }
        }
        closest.map(|(_, pair)| pair)
    }

    fn is_plausible(&self, a: &[f64; 2], b: &[f64; 2], separation_px: f64) -> bool {
        let direction_rad = (b[1] - a[1]).atan2(b[0] - a[0]);
        self.settings.separation_px.contains(&separation_px)
            && angle_between_lines(direction_rad, self.settings.baseline_rad)
                <= self.settings.tilt_max_rad
    }

    fn associate(&self, [a, b]: [[f64; 2]; 2], captured_at: Timestamp) -> PaperPair {
        let separation_raw_px = separation_px(&[a, b]);
        let u_raw_px = 0.5 * (a[0] + b[0]);
        let fresh = PaperPair {
            markers_px: [a, b],
            separation_raw_px,
            separation_px: separation_raw_px,
            u_raw_px,
            u_px: u_raw_px,
            reacquired: true,
        };
        let Some((previous, previous_at)) = &self.previous else {
            return fresh;
        };
        let steps = |markers_px: [[f64; 2]; 2]| {
            let step = |idx: usize| separation_px(&[markers_px[idx], previous.markers_px[idx]]);
            [step(0), step(1)]
        };
        let sum = |steps: [f64; 2]| steps[0] + steps[1];
        let markers_px = if sum(steps([a, b])) <= sum(steps([b, a])) {
            [a, b]
        } else {
            [b, a]
        };
        if steps(markers_px)
            .into_iter()
            .any(|step| step > self.settings.association_px)
        {
            return fresh;
        }
        let elapsed_s = (captured_at - *previous_at).max(0.0);
        let gain = elapsed_s / (elapsed_s + self.settings.low_pass_s);
        let pass = |filtered: f64, raw: f64| filtered + gain * (raw - filtered);
        PaperPair {
            markers_px,
            separation_px: pass(previous.separation_px, separation_raw_px),
            u_px: pass(previous.u_px, u_raw_px),
            reacquired: false,
            ..fresh
        }
    }
}

fn separation_px([a, b]: &[[f64; 2]; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

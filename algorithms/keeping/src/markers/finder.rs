//! All marker pairs of one image.

use std::f64::consts::FRAC_PI_2;

use camera::Image;

use super::light::{self, Light, LightGates};
use super::pairs::{
    self, CANDIDATE_COUNT_MAX, Candidate, MarkerPair, MergedPair, PAIR_COUNT_MAX, PairGates,
};
use super::runs::{Component, RunJoiner, TooManyRuns};
use super::scan;

/// What counts as a pair of marker lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinderSettings {
    /// Grey levels that a light stands out by, at least; also at least five sigmas of the noise.
    /// Lower finds fainter lights, and more things that are none. Where the picture is clipped a
    /// part of it is enough: nothing but a light is that bright.
    pub contrast_min: f64,
    /// Lights of one drone that are closer than this look like one.
    pub separation_px_min: f64,
    /// Pairs farther apart than this are nearer than any drone may come.
    pub separation_px_max: f64,
    /// Direction of the baseline in the image, from its x axis towards its y axis; turn it by the
    /// roll of the camera. One above the other by default, so that no heading shortens it.
    pub baseline_rad: f64,
    /// How far a pair may be tilted from that.
    pub tilt_max_rad: f64,
}

impl Default for FinderSettings {
    fn default() -> Self {
        Self {
            contrast_min: 40.0,
            separation_px_min: 2.5,
            separation_px_max: 60.0,
            baseline_rad: FRAC_PI_2,
            tilt_max_rad: 20_f64.to_radians(),
        }
    }
}

/// What one image shows; borrowed from the finder until the next image.
#[derive(Clone, Copy, Debug)]
pub struct FramePairs<'a> {
    /// Disjoint, the likeliest first.
    pub pairs: &'a [MarkerPair],
    /// Neighbours too far away to tell their lights apart.
    pub merged: &'a [MergedPair],
    /// Every light, paired or not.
    pub lights: &'a [Light],
    /// Standard deviation of a pixel, grey levels.
    pub noise: f64,
    /// So much stands out that nothing can be told from it; the lists are empty.
    pub crowded: bool,
}

/// Finds marker pairs. An object because its buffers live from image to image.
#[derive(Clone, Debug)]
pub struct PairFinder {
    settings: FinderSettings,
    padded_row: Vec<u8>,
    joiner: RunJoiner,
    /// Components with the grey level at their centre.
    brightest: Vec<(u8, Component)>,
    lights: Vec<Light>,
    candidates: Vec<Candidate>,
    taken: Vec<bool>,
    pairs: Vec<MarkerPair>,
    merged: Vec<MergedPair>,
}

/// A frame with more runs than this is full of noise.
const RUN_COUNT_MAX: u16 = 1024;
/// Of more components only the brightest are looked at.
const COMPONENT_COUNT_MAX: usize = 48;
/// The faintest are forgotten.
const LIGHT_COUNT_MAX: usize = 32;
/// Contrasts from here on tell nothing about the noise.
const CONTRAST_MIN_MAX: f64 = 200.0;
const CLIPPED_CONTRAST_SHARE: f64 = 0.4;
/// Before a busy background the contrast is raised by this until few enough things stand out.
const BUSY_STEP: f64 = 1.6;
/// Beside things that are this much brighter, what is not clipped is no light but lit.
const CONTRAST_OF_BRIGHTEST_MIN: f64 = 0.35;
/// A light stands out by this many sigmas of the noise.
const CONTRAST_SIGMAS: f64 = 5.0;
const SIGNAL_TO_NOISE_MIN: f64 = 10.0;
/// The paper's gate on areas, for the brighter half of a light.
const AREA_PX_MAX: u32 = 120;
/// A streak of 6 px of the sharpest light is this much longer than wide.
const ELONGATION_MAX: f64 = 3.5;
const AREA_RATIO_MAX: f64 = 3.0;
/// `e^0.5`.
const CONTRAST_RATIO_MAX: f64 = 1.6487;
/// Centres nearer than this are one light, met twice.
const SAME_LIGHT_PX: f64 = 1.5;
/// A blob that is this much longer than wide, along the baseline, is two lights.
const MERGED_ELONGATION_MIN: f64 = 1.35;
/// Blobs of a few pixels look a little long by chance.
const MERGED_SEPARATION_MIN_PX: f64 = 1.7;
/// Lights this far apart are told apart, whatever their brightness.
const RESOLVED_PX: f64 = 4.0;

impl PairFinder {
    /// - `width_max_px`: of the images to come; wider ones cost an allocation once.
    pub fn new(settings: FinderSettings, width_max_px: usize) -> Self {
        Self {
            settings,
            padded_row: vec![0; width_max_px + 2 * scan::ARM_PX],
            joiner: RunJoiner::with_run_count_max(RUN_COUNT_MAX),
            brightest: Vec::with_capacity(usize::from(RUN_COUNT_MAX)),
            lights: Vec::with_capacity(LIGHT_COUNT_MAX),
            candidates: Vec::with_capacity(CANDIDATE_COUNT_MAX),
            taken: Vec::with_capacity(LIGHT_COUNT_MAX),
            pairs: Vec::with_capacity(PAIR_COUNT_MAX),
            merged: Vec::with_capacity(PAIR_COUNT_MAX),
        }
    }

    pub fn settings(&self) -> &FinderSettings {
        &self.settings
    }

    /// Turns the expected baseline, as the camera rolls.
    pub fn expect_baseline(&mut self, baseline_rad: f64) {
        self.settings.baseline_rad = baseline_rad;
    }

    /// Finds the pairs of one image.
    ///
    /// Deterministic. Cost: one pass over the image, measured in `benches/markers.rs`; bounded on
    /// any image.
    pub fn find(&mut self, image: &Image) -> FramePairs<'_> {
        self.lights.clear();
        self.pairs.clear();
        self.merged.clear();
        let noise = scan::estimate_noise(image);
        let from_noise = |wanted: f64| wanted.max(CONTRAST_SIGMAS * noise).min(CONTRAST_MIN_MAX);
        let gates = LightGates {
            noise,
            contrast_min: from_noise(self.settings.contrast_min)
                .max(CONTRAST_OF_BRIGHTEST_MIN * f64::from(scan::sample_brightest(image))),
            clipped_contrast_min: from_noise(CLIPPED_CONTRAST_SHARE * self.settings.contrast_min),
            signal_to_noise_min: SIGNAL_TO_NOISE_MIN,
            area_px_max: AREA_PX_MAX,
            elongation_max: ELONGATION_MAX,
        };
        let crowded = self.collect_lights(image, &gates).is_err();
        self.pair_lights(image, noise);
        for pair in &mut self.pairs {
            pair.refine(image, noise);
        }
        self.merge_lights();
        FramePairs {
            pairs: &self.pairs,
            merged: &self.merged,
            lights: &self.lights,
            noise,
            crowded,
        }
    }

    fn collect_lights(&mut self, image: &Image, gates: &LightGates) -> Result<(), TooManyRuns> {
        self.padded_row.resize(image.width() + 2 * scan::ARM_PX, 0);
        let mut gates = *gates;
        if self.find_bright(image, gates.clipped_contrast_min)? {
            // Print and pebbles are as small and as bright as lights, but for what is clipped.
            gates.contrast_min = f64::INFINITY;
        }
        let brightness = |component: &Component| {
            let [x, y] = component.centroid_px();
            image.get(x.round() as usize, y.round() as usize)
        };
        let (lights, brightest) = (&mut self.lights, &mut self.brightest);
        brightest.clear();
        let components = self.joiner.components().iter();
        brightest.extend(
            components
                .filter(|component| component.area_px > 1)
                .map(|component| (brightness(component), *component)),
        );
        if brightest.len() > COMPONENT_COUNT_MAX {
            brightest.select_nth_unstable_by_key(COMPONENT_COUNT_MAX, |(brightness, _)| {
                std::cmp::Reverse(*brightness)
            });
            brightest.truncate(COMPONENT_COUNT_MAX);
        }
        for (_, component) in brightest {
            light::measure(image, component, &gates, |light| keep(lights, light));
        }
        Ok(())
    }

    /// Runs of what stands out: of everything, or before a busy background of what stands out most;
    /// whether it is busy.
    fn find_bright(&mut self, image: &Image, contrast_min: f64) -> Result<bool, TooManyRuns> {
        let mut threshold = contrast_min;
        loop {
            let (row, joiner) = (&mut self.padded_row, &mut self.joiner);
            let found = scan::find_bright(image, threshold as u8, row, joiner);
            if found.is_ok() || threshold >= CONTRAST_MIN_MAX {
                return found.map(|()| threshold > contrast_min);
            }
            threshold = (threshold * BUSY_STEP).min(CONTRAST_MIN_MAX);
        }
    }

    fn pair_lights(&mut self, image: &Image, noise: f64) {
        let gates = PairGates {
            separation_px_min: self.settings.separation_px_min,
            separation_px_max: self.settings.separation_px_max,
            baseline_rad: self.settings.baseline_rad,
            tilt_max_rad: self.settings.tilt_max_rad,
            area_ratio_max: AREA_RATIO_MAX,
            contrast_ratio_max: CONTRAST_RATIO_MAX,
        };
        pairs::find_pairs(
            image,
            noise,
            &mut self.lights,
            &gates,
            &mut self.candidates,
            &mut self.taken,
            &mut self.pairs,
        );
    }

    /// Unpaired lights that are long in the direction of the baseline are two.
    fn merge_lights(&mut self) {
        for (light, taken) in self.lights.iter().zip(&self.taken) {
            let tilt = pairs::angle_between_lines(light.axis_rad, self.settings.baseline_rad);
            // Two equal lights spread a blob by half their separation in its direction.
            let [along, across] = light.spread_px;
            let separation_px = 2.0 * (along * along - across * across).max(0.0).sqrt();
            let is_merged = !taken
                && light.elongation >= MERGED_ELONGATION_MIN
                && separation_px >= MERGED_SEPARATION_MIN_PX
                && tilt <= self.settings.tilt_max_rad;
            if is_merged && self.merged.len() < PAIR_COUNT_MAX {
                self.merged.push(MergedPair {
                    center_px: light.center_px,
                    separation_px_max: RESOLVED_PX,
                    separation_px,
                });
            }
        }
    }
}

/// Keeps a light unless it is known, in the place of the faintest if there are too many.
fn keep(lights: &mut Vec<Light>, light: Light) {
    let is_same = |other: &Light| {
        let offset = [0, 1].map(|axis| other.center_px[axis] - light.center_px[axis]);
        offset[0].hypot(offset[1]) < SAME_LIGHT_PX
    };
    let fainter = if let Some(known) = lights.iter_mut().find(|other| is_same(other)) {
        known
    } else if lights.len() < LIGHT_COUNT_MAX {
        lights.push(light);
        return;
    } else {
        let by_contrast = |a: &&mut Light, b: &&mut Light| a.contrast.total_cmp(&b.contrast);
        lights
            .iter_mut()
            .min_by(by_contrast)
            .expect("the list is full")
    };
    if light.contrast > fainter.contrast {
        *fainter = light;
    }
}

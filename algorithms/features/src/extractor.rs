//! From an image to features.

use camera::Image;
use nalgebra::Vector2;

use crate::blur::Blur;
use crate::corners::{Corner, CornerFinder};
use crate::patch::{self, Placement};
use crate::plane::Plane;
use crate::pyramid::{Pyramid, PyramidShape};
use crate::simd::InstructionSet;
use crate::spread::{self, Selection};
use crate::{Features, Keypoint, histogram, orientation, projection};

/// What an [`Extractor`] looks for. Values out of range are brought to the nearest in range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtractorSettings {
    /// At most this many features. More cost time in proportion and track longer.
    pub feature_count: usize,
    /// Pyramid levels, 1 to 16; images get only those whose sides are 40 px or more. Cameras of
    /// different focal length share what their levels share: see the crate's documentation.
    pub level_count: usize,
    /// Size ratio of neighbouring levels, 1.05 to 2. Larger is faster and matches less well
    /// between the levels.
    pub scale_factor: f64,
    /// Image pixels per pixel of level 0, 0.5 to 1. Below 1 the image is enlarged first, which
    /// finds finer corners at up to four times the cost.
    pub finest_scale: f64,
    /// Contrast of a corner to its ring, grey values; lower finds more corners in dull cells.
    pub corner_threshold: u8,
    /// Used in cells where `corner_threshold` finds nothing. Too low and noise becomes corners.
    pub corner_threshold_min: u8,
}

const LEVEL_COUNT_MAX: usize = 16;

impl Default for ExtractorSettings {
    fn default() -> Self {
        Self {
            feature_count: 1000,
            level_count: 12,
            scale_factor: 1.2,
            finest_scale: 1.0,
            corner_threshold: 20,
            corner_threshold_min: 10,
        }
    }
}

impl ExtractorSettings {
    fn scale(&self, level: usize) -> f64 {
        self.finest_scale * self.scale_factor.powi(level as i32)
    }

    fn in_range(self) -> Self {
        Self {
            level_count: self.level_count.clamp(1, LEVEL_COUNT_MAX),
            scale_factor: self.scale_factor.clamp(1.05, 2.0),
            finest_scale: self.finest_scale.clamp(0.5, 1.0),
            corner_threshold: self.corner_threshold.max(self.corner_threshold_min),
            ..self
        }
    }
}

/// Distance of a corner's pixel from the border of its level.
///
/// The disc of the orientation and nearly all of the patch lie inside; the patch's corners, which
/// hardly count, may lie in the padding.
pub(crate) const MARGIN_PX: usize = 16;
/// Around smoothed levels, for patches at the margin that are shifted by up to one pixel.
const PADDING_PX: usize = patch::REACH_PX + 1 - MARGIN_PX;

/// Finds features; keeps its buffers from image to image.
#[derive(Clone, Debug)]
pub struct Extractor {
    settings: ExtractorSettings,
    instructions: InstructionSet,
    pyramid: Pyramid,
    finder: CornerFinder,
    blur: Blur,
    /// Corners of all levels, one list each.
    corners: Vec<Vec<Corner>>,
    strongest: Vec<u8>,
    selection: Selection,
    smooth: Plane,
}

impl Extractor {
    pub fn new(settings: ExtractorSettings) -> Self {
        Self::with_instructions(settings, InstructionSet::detect())
    }

    /// The results do not depend on the instructions.
    pub(crate) fn with_instructions(
        settings: ExtractorSettings,
        instructions: InstructionSet,
    ) -> Self {
        let settings = settings.in_range();
        Self {
            settings,
            instructions,
            pyramid: Pyramid::default(),
            finder: CornerFinder::default(),
            blur: Blur::default(),
            corners: vec![Vec::new(); settings.level_count],
            strongest: Vec::new(),
            selection: Selection::default(),
            smooth: Plane::default(),
        }
    }

    pub fn settings(&self) -> &ExtractorSettings {
        &self.settings
    }

    /// Image pixels per pixel of this level.
    pub fn level_scale(&self, level: u8) -> f64 {
        self.settings.scale(usize::from(level))
    }

    /// Replaces `features` by those of the image, level by level.
    ///
    /// Deterministic, on any machine. Allocates only while images or lists grow. Images wider or
    /// higher than 16384 px have no features.
    pub fn extract(&mut self, image: &Image, features: &mut Features) {
        features.clear();
        self.pyramid.build(self.instructions, image, &self.shape());
        for level in 0..self.pyramid.levels().len() {
            self.find_corners(level);
        }
        let quotas = self.quotas();
        for level in (0..self.pyramid.levels().len()).rev() {
            self.describe_level(level, quotas[level], features);
        }
    }

    /// How many features each level gives: in proportion to 1 / scale, and what a level has too
    /// few corners for is shared by all others. Blur leaves corners on coarse levels only.
    fn quotas(&self) -> [usize; LEVEL_COUNT_MAX] {
        let shrink = 1.0 / self.settings.scale_factor;
        let weight = |level: usize| shrink.powi(level as i32);
        let mut quotas = [0; LEVEL_COUNT_MAX];
        let mut wanted = self.settings.feature_count;
        let mut open = [true; LEVEL_COUNT_MAX];
        open[self.pyramid.levels().len()..].fill(false);
        let total = |open: &[bool]| {
            let weights = open.iter().enumerate().filter(|(_, open)| **open);
            weights.map(|(level, _)| weight(level)).sum::<f64>()
        };
        loop {
            let per_weight = wanted as f64 / total(&open);
            let before = open;
            for level in (0..LEVEL_COUNT_MAX).filter(|&level| before[level]) {
                let corner_count = self.corners[level].len();
                if corner_count as f64 <= weight(level) * per_weight {
                    (quotas[level], open[level]) = (corner_count, false);
                    wanted -= corner_count;
                }
            }
            if open == before {
                break;
            }
        }
        for level in (0..LEVEL_COUNT_MAX).rev().filter(|&level| open[level]) {
            let share = weight(level) / total(&open[..=level]);
            quotas[level] = (wanted as f64 * share).round() as usize;
            wanted -= quotas[level];
        }
        quotas
    }

    fn shape(&self) -> PyramidShape {
        PyramidShape {
            finest_scale: self.settings.finest_scale,
            scale_factor: self.settings.scale_factor,
            level_count_max: self.settings.level_count,
            side_px_min: 2 * MARGIN_PX + 8,
        }
    }

    fn find_corners(&mut self, level: usize) {
        let plane = &self.pyramid.levels()[level];
        let corners = &mut self.corners[level];
        corners.clear();
        let threshold = self.settings.corner_threshold_min;
        self.finder
            .find(self.instructions, plane, MARGIN_PX, threshold, corners);
        let threshold = self.settings.corner_threshold;
        spread::keep_strong_or_only(plane, threshold, &mut self.strongest, corners);
    }

    fn describe_level(&mut self, level: usize, quota: usize, features: &mut Features) {
        let plane = &self.pyramid.levels()[level];
        let corners = &self.corners[level];
        if corners.is_empty() || quota == 0 {
            return;
        }
        self.blur
            .smooth(self.instructions, plane, PADDING_PX, &mut self.smooth);
        let scale = self.settings.scale(level);
        for corner_idx in self.selection.choose(plane, corners, quota) {
            let corner = &corners[corner_idx];
            let (x, y) = (usize::from(corner.x), usize::from(corner.y));
            let position = Vector2::new(x as f64, y as f64) + corner.shift_px();
            let centroid = orientation::centroid(plane, x, y);
            let placement = Placement {
                centre_px: position.add_scalar(PADDING_PX as f64).cast(),
                direction: centroid.try_normalize(0.0).unwrap_or_else(Vector2::x),
            };
            let patch = patch::sample(self.instructions, &self.smooth, &placement);
            let mut histogram = [0.0; histogram::BIN_COUNT];
            histogram::gather(self.instructions, &patch, &mut histogram);
            let descriptor = projection::binarise(self.instructions, &histogram);
            let angle_rad = centroid.y.atan2(centroid.x);
            features.descriptors.push(descriptor);
            features.keypoints.push(Keypoint {
                position_px: (position.add_scalar(0.5) * scale).add_scalar(-0.5),
                level: level as u8,
                angle_rad,
                response: f32::from(corner.score()),
            });
        }
    }
}

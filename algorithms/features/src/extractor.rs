//! From an image to features.

use camera::Image;
use nalgebra::Vector2;

use crate::{Descriptor, Features, Keypoint};

/// What an [`Extractor`] looks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtractorSettings {
    /// At most this many features. More cost time in proportion and track longer.
    pub feature_count: usize,
    /// Pyramid levels, 1 to 16; small images get fewer.
    pub level_count: usize,
    /// Size ratio of neighbouring levels, above 1 to 2.
    pub scale_factor: f64,
    /// Contrast of a corner to its ring, grey values; lower finds more corners in dull cells.
    pub corner_threshold: u8,
    /// Used in cells where `corner_threshold` finds nothing. Too low and noise becomes corners.
    pub corner_threshold_min: u8,
}

impl Default for ExtractorSettings {
    fn default() -> Self {
        Self {
            feature_count: 1000,
            level_count: 8,
            scale_factor: 1.2,
            corner_threshold: 20,
            corner_threshold_min: 7,
        }
    }
}

/// Finds features; keeps its buffers from image to image.
#[derive(Clone, Debug)]
pub struct Extractor {
    settings: ExtractorSettings,
}

impl Extractor {
    pub fn new(settings: ExtractorSettings) -> Self {
        Self { settings }
    }

    pub fn settings(&self) -> &ExtractorSettings {
        &self.settings
    }

    /// Full-resolution pixels per pixel of this level.
    pub fn level_scale(&self, level: u8) -> f64 {
        self.settings.scale_factor.powi(i32::from(level))
    }

    /// Replaces `features` by those of the image.
    pub fn extract(&mut self, image: &Image, features: &mut Features) {
        features.clear();
        let mut candidates = corners(image, self.settings.corner_threshold_min);
        candidates.sort_by(|a, b| b.response.total_cmp(&a.response));
        candidates.truncate(self.settings.feature_count);
        for keypoint in candidates {
            features.descriptors.push(describe(image, &keypoint));
            features.keypoints.push(keypoint);
        }
    }
}

const RING: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

fn corners(image: &Image, threshold: u8) -> Vec<Keypoint> {
    let mut found = Vec::new();
    for y in (20..image.height().saturating_sub(20)).step_by(2) {
        for x in (20..image.width().saturating_sub(20)).step_by(2) {
            let centre = i32::from(image.get(x, y));
            let ring = RING.map(|(dx, dy)| {
                i32::from(image.get(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))) - centre
            });
            let arc = |sign: i32| {
                (0..16)
                    .map(|k| (0..9).map(|i| sign * ring[(k + i) % 16]).min().unwrap_or(0))
                    .max()
                    .unwrap_or(0)
            };
            let score = arc(1).max(arc(-1));
            if score > i32::from(threshold) {
                found.push(Keypoint {
                    position_px: Vector2::new(x as f64, y as f64),
                    level: 0,
                    angle_rad: 0.0,
                    response: score as f32,
                });
            }
        }
    }
    found
}

fn describe(image: &Image, keypoint: &Keypoint) -> Descriptor {
    let (x, y) = (
        keypoint.position_px.x as usize,
        keypoint.position_px.y as usize,
    );
    let mut state = 1_u64;
    let mut offset = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        ((state >> 33) % 27) as usize
    };
    let mut words = [0_u64; 4];
    for bit in 0..256 {
        let mut sample = || {
            let (u, v) = (x + offset() - 13, y + offset() - 13);
            (0..9)
                .map(|i| u32::from(image.get(u + i % 3 - 1, v + i / 3 - 1)))
                .sum::<u32>()
        };
        words[bit / 64] |= u64::from(sample() < sample()) << (bit % 64);
    }
    Descriptor(words)
}

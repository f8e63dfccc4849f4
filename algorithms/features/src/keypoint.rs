//! What is found in an image.

use nalgebra::Vector2;

use crate::Descriptor;

/// A corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// In the full-resolution image; (0, 0) is the centre of its top-left pixel.
    pub position_px: Vector2<f64>,
    /// Pyramid level it was found on; [`crate::Extractor::level_scale`] is its pixel size there.
    pub level: u8,
    /// Direction from the corner to the brightness centroid of its surroundings, from x to y.
    pub angle_rad: f32,
    /// Contrast of the corner to its ring, grey values.
    pub response: f32,
}

/// Keypoints and, at the same index, their descriptors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    pub keypoints: Vec<Keypoint>,
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Forgets the contents, keeps the buffers.
    pub fn clear(&mut self) {
        self.keypoints.clear();
        self.descriptors.clear();
    }
}

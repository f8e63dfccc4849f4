#![doc = include_str!("../README.md")]

mod blur;
mod corners;
mod descriptor;
mod extractor;
mod grid;
mod histogram;
mod keypoint;
pub mod matching;
pub mod optical_flow;
mod orientation;
mod patch;
mod plane;
mod projection;
mod pyramid;
mod simd;
mod spread;

pub use descriptor::Descriptor;
pub use extractor::{Extractor, ExtractorSettings};
pub use grid::FeatureGrid;
pub use keypoint::{Features, Keypoint};

#[cfg(test)]
mod tests;

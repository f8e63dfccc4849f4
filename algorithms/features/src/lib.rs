#![doc = include_str!("../README.md")]

mod descriptor;
mod extractor;
mod grid;
mod keypoint;
pub mod matching;

pub use descriptor::Descriptor;
pub use extractor::{Extractor, ExtractorSettings};
pub use grid::FeatureGrid;
pub use keypoint::{Features, Keypoint};

//! Pairs of marker lights in an image: two lights a known length apart, one above the other.
//!
//! [`PairFinder`] finds all pairs of one image, [`MarkerTracker`] follows them from image to image,
//! and [`MarkerVision`] does both for several cameras. [`PaperPipeline`] is the paper's own method,
//! kept as it is written for comparison.
//!
//! Buffers are reserved when a finder is made: no image costs an allocation, whatever it shows.

mod background;
mod blink;
mod finder;
mod light;
mod pairs;
mod paper;
mod refine;
mod runs;
mod scan;
mod tracker;
mod vision;

pub use blink::BlinkCode;
pub use finder::{FinderSettings, FramePairs, PairFinder};
pub use light::Light;
pub use pairs::{MarkerPair, MergedPair};
pub use paper::{PaperPair, PaperPipeline, PaperPipelineSettings};
pub use tracker::{EgoMotion, MarkerTrack, MarkerTracker, TrackId, TrackState, TrackerSettings};
pub use vision::{CameraMarkers, MarkerVision};

#[cfg(test)]
mod tests;

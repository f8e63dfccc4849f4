#![doc = include_str!("../README.md")]

mod fix;
pub mod georeference;
mod input;
mod machine;
mod settings;
#[cfg(test)]
mod simulation;

pub use fix::{FixCounts, FixPosition, Heading, PositionFix};
pub use georeference::{Georeference, Georeferencer, NotObservable};
pub use input::{FrameInput, KeyframeInput, KeyframePose, PointInput, keyframe_poses};
pub use machine::{Anchor, Counts, Effect, Event, Registration};
pub use settings::{AnchorSettings, CutSettings, GeoreferenceSettings};

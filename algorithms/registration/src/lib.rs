#![doc = include_str!("../README.md")]

mod acceptance;
mod alignment;
pub mod cloud;
mod evidence;
mod gravity;
mod icp;
pub mod kd_tree;
mod likeness;
pub mod localizer;
mod median;
pub mod register;
pub mod search;

pub use alignment::{
    Alignment, Metric, Outcome, Quality, Refusal, RegisterSettings, Source, Start, Target,
};
pub use cloud::{Cloud, Descriptors, ShapedCloud, is_usable};
pub use evidence::{Clue, Evidence};
pub use gravity::Gravity;
pub use likeness::Likeness;
pub use localizer::{
    AlignmentReport, AnchorIdx, ChunkIdx, CorrectedKeyframe, Estimate, FrameLocation,
    FrameObservation, KeyframeIdx, KeyframeObservation, Landmark, Localizer, LocalizerSettings,
    NearPose, ObservedFeature, ObservedPoint,
};
pub use register::{align, register};

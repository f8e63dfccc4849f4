#![doc = include_str!("../README.md")]

pub mod cloud;
pub mod localizer;
pub mod register;

pub use cloud::{Cloud, Descriptors};
pub use localizer::{
    AlignmentReport, AnchorIdx, ChunkIdx, Estimate, KeyframeIdx, KeyframeObservation, Landmark,
    Localizer, LocalizerSettings, ObservedFeature, ObservedPoint,
};
pub use register::{
    Alignment, Metric, Outcome, Refusal, RegisterSettings, Source, Start, Target, register,
};

#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

pub mod absolute_pose;
mod alignment;
mod frames;
mod robust;
mod similarity;
pub mod so3;
mod time;
mod transform;

pub use alignment::{DegenerateAlignment, umeyama};
pub use frames::{Body, Camera, Chunk, Ecef, Enu, Map};
pub use robust::RobustKernel;
pub use similarity::{Matrix7, Similarity, Tangent7};
pub use time::Timestamp;
pub use transform::Transform;

#[cfg(test)]
mod tests;

//! How good vSLAM and registration are, as numbers: over recordings and rendered worlds, and over
//! many seeds.
//!
//! Estimates meet the truth here and nowhere else.

pub mod accuracy;
mod catalogue;
pub mod registration;
pub mod robustness;
mod score;
mod table;
mod variant;
mod verdict;

pub use score::{Score, score};
pub use verdict::{LivePose, Verdict, verdict};

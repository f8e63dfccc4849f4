//! Whole-team scenarios over real zenoh, and how good vSLAM is over many recordings.

pub mod measure;

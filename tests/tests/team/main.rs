//! The team over real zenoh sessions, each vehicle a process of its own.
//!
//! Recordings are rendered once, from the simulator's lab; `real_video` alone looks for data from
//! outside.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, and in what helps tests, a panic is the failure"
)]

mod clock;
mod demo;
mod ending;
mod hover;
mod inputs;
mod joining;
mod outage;
mod processes;
mod real_video;
mod recordings;
mod relay;
mod station;
mod usage;
mod wire;

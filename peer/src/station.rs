//! Station-keeping: a vehicle's place behind another one or among many, held by sight alone.
//!
//! This is a loop of its own beside the estimator: images in, velocities out, at a fixed rate. It
//! knows no map, no network and no other part of this process, and nothing there can make it wait.

mod beat;
mod keeper;

pub use beat::{Outlet, StationLoop, StationWindow};
pub use keeper::{StationError, StationKeeper, StationMoment, StationRule, StationSettings};

#[cfg(test)]
mod tests;

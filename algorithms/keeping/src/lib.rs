//! Swarm-keeping: hold together by sight alone.
//!
//! A camera sees the two lights of each neighbour; what it sees becomes a small velocity correction.
//! No map, no network, no clock: images and measurements in, tracks and velocities out.

pub mod markers;

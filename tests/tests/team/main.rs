//! The team over real zenoh sessions, each vehicle a process of its own.
//!
//! Recordings are rendered once, from the simulator's lab; no test needs data from outside.

mod clock;
mod joining;
mod outage;
mod processes;
mod recordings;
mod usage;
mod wire;

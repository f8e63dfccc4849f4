//! Swarms flown by their rules in a simulated world, many times, and what came of it.
//!
//! The loop is closed here: `sim` moves drones and shows their lights, `keeping` answers with
//! velocities, and neither knows the other.

mod campaign;
mod flight;
mod graph;
mod metrics;
mod pilot;
mod scenario;

pub use campaign::{Summary, fly_all, summarise};
pub use flight::{FlightRecord, Moment, fly};
pub use scenario::{RuleName, Scenario, SensingName, SettingError};

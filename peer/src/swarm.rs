//! Swarms flown by their rules in a simulated world, many times, and what came of it.
//!
//! The loop is closed here: `sim` moves drones and shows their lights, `keeping` answers with
//! velocities, and neither knows the other.

mod campaign;
mod eyes;
pub mod figures;
mod flight;
mod following;
mod graph;
mod metrics;
mod pilot;
mod scenario;
mod trace;

pub use campaign::{Summary, fly_all, summarise};
pub use flight::{FlightRecord, Moment, fly};
pub use following::{FollowingMoment, FollowingSettings, follow};
pub use metrics::{COLLISION_M, Mean};
pub use scenario::{RuleName, Scenario, SensingName, SettingError};
pub use trace::Trace;

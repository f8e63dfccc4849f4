#![doc = include_str!("../README.md")]

mod conditioner;
mod scenario;
mod serve;
pub mod stream;

pub use conditioner::{Conditioner, Cut, Traffic};
pub use scenario::{ScenarioName, VehicleDescription};
pub use serve::{
    Ending, Listener, Pace, ServeError, ServeEvent, ServeReport, ServeSettings, VehicleReport,
    serve,
};

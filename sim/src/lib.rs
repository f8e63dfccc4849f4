#![doc = include_str!("../README.md")]

mod conditioner;
mod paint;
mod picture;
mod renderer;
mod scenario;
mod serve;
pub mod stream;
mod world;

pub use conditioner::{Conditioner, Cut, Traffic};
pub use renderer::{Renderer, Scene, SensorSettings, Shot, gain_at};
pub use scenario::{ScenarioName, VehicleDescription};
pub use serve::{
    Ending, Listener, Pace, ServeError, ServeEvent, ServeReport, ServeSettings, VehicleReport,
    serve,
};
pub use world::{Cuboid, FURNITURE_DEPTH_M, Finish, Panel, Surroundings, World};

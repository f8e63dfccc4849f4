#![doc = include_str!("../README.md")]

mod conditioner;
mod flight;
pub mod marker_light;
mod paint;
mod picture;
mod position_source;
mod recording;
mod renderer;
mod route;
mod scenario;
mod serve;
pub mod stream;
pub mod swarm;
mod visit;
mod world;

pub use conditioner::{Conditioner, Cut, Traffic};
pub use flight::Flight;
pub use marker_light::MarkerLights;
pub use position_source::PositionSourceSettings;
pub use recording::{Condition, RecordedFrame, Recording, RecordingSettings, RecordingWorld};
pub use renderer::{Neighbour, Renderer, Scene, SensorSettings, Shot, gain_at};
pub use route::{Motion, Route};
pub use scenario::{Scenario, ScenarioName, Vehicle, VehicleDescription};
pub use serve::{
    Ending, Listener, Pace, ServeError, ServeEvent, ServeReport, ServeSettings, VehicleReport,
    serve,
};
pub use visit::{Encounter, EncounterSettings, Standpoint, Visit};
pub use world::{Cuboid, FURNITURE_DEPTH_M, Finish, Likeness, Panel, Surroundings, World};

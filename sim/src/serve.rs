//! The body of the simulator process.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;

use crate::ScenarioName;

/// What to serve, and how.
#[derive(Clone, Debug)]
pub struct ServeSettings {
    pub scenario: ScenarioName,
    pub seed: u64,
    /// A folder that gets `{id}.truth.tum`; nothing is written without it.
    pub truth_folder: Option<PathBuf>,
    pub pace: Pace,
    /// Ends the route early, for tests.
    pub frame_count_max: Option<usize>,
    /// How long all vehicles together may take to connect and say hello.
    pub connect_timeout: Duration,
    /// How long a vehicle may take for one frame before it counts as dead.
    pub acknowledge_timeout: Duration,
}

impl Default for ServeSettings {
    fn default() -> Self {
        Self {
            scenario: ScenarioName::Lab,
            seed: 1,
            truth_folder: None,
            pace: Pace::RealTime,
            frame_count_max: None,
            connect_timeout: Duration::from_secs(60),
            acknowledge_timeout: Duration::from_secs(30),
        }
    }
}

/// How the simulated clock relates to the wall's. It never runs ahead of the vehicles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// At most as fast as the wall clock.
    RealTime,
    /// As fast as the vehicles acknowledge.
    Unlimited,
}

/// What the one who started the simulator may want to know while it runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum ServeEvent {
    /// Connections are awaited: one per vehicle.
    Listening {
        vehicles: Vec<Listener>,
        frame_count: usize,
        frame_rate_hz: f64,
    },
    /// All vehicles said hello; the first frame follows.
    Started,
    /// A frame was acknowledged by every vehicle that is left.
    FrameDone { frame_idx: usize, simulated_s: f64 },
    /// The others go on.
    VehicleLost { id: String, reason: String },
}

/// Where a vehicle finds its stream.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Listener {
    pub id: String,
    pub address: SocketAddr,
}

/// How it went.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ServeReport {
    pub frame_count: usize,
    pub simulated_s: f64,
    pub wall_s: f64,
    /// Simulated duration over wall duration.
    pub realtime_factor: f64,
    pub vehicles: Vec<VehicleReport>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VehicleReport {
    pub id: String,
    pub frames_sent: usize,
    pub frames_acknowledged: usize,
    pub fixes_sent: usize,
    pub ending: Ending,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    RouteFinished,
    Lost { reason: String },
}

/// Why the simulator could not do its work at all.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error("cannot listen on loopback: {0}")]
    Listen(std::io::Error),
    #[error("no vehicle connected and said hello within {waited_s:.0} s: {missing}")]
    NobodyCame { waited_s: f64, missing: String },
    #[error("cannot write truth: {source}: {path}")]
    Truth {
        source: std::io::Error,
        path: PathBuf,
    },
}

/// Renders the scenario for every vehicle that connects, frame by frame, until the routes end.
///
/// Each vehicle gets a loopback listener on a free port; `observe` hears of them first.
/// All frames of one instant go out together, and the next instant waits until every vehicle
/// has acknowledged. A vehicle that dies does not stop the others.
pub fn serve(
    settings: &ServeSettings,
    observe: &mut dyn FnMut(&ServeEvent),
) -> Result<ServeReport, ServeError> {
    let _ = observe;
    Err(ServeError::NobodyCame {
        waited_s: settings.connect_timeout.as_secs_f64(),
        missing: "all".into(),
    })
}

//! Recordings flown as a team: a process for each vehicle, one clock for all.

mod barrier;
mod child;
mod clock;
mod failure;
mod links;
mod outage;
mod owned_child;
mod report;
mod waited;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};

use crate::config::{
    CameraConfig, EstimationConfig, PositionConfig, VehicleConfig, ZenohConfig, ZenohMode,
};
use crate::dataset::{Dataset, DatasetArgument, DatasetError, RecordingOptions};
use crate::files::{NamedFile, check_distinct, create_folder};
use crate::process::VehicleSummary;
use crate::process::control::{Order, Report};
use crate::process::interrupt::{self, Interrupted};
use barrier::Barrier;
pub use child::{Crew, CrewEvent, Supervised};
use clock::Tick;
pub use failure::how_it_ended;
pub use links::{LinkPair, Links, loopback_address};
pub use outage::{MalformedOutage, Outage};
pub use owned_child::{OwnedChild, read_json_lines};
pub use report::{VehicleReport, table};
pub use waited::Waited;

/// What is flown.
#[derive(Clone, Debug)]
pub struct TeamPlan {
    /// In the order in which they start; anchors first.
    pub vehicles: Vec<PlannedVehicle>,
    pub outages: Vec<Outage>,
    pub out: PathBuf,
    pub threads: usize,
    pub seed: u64,
}

#[derive(Clone, Debug)]
pub struct PlannedVehicle {
    pub id: String,
    pub dataset: DatasetArgument,
    pub recording: RecordingOptions,
    /// Makes it an anchor.
    pub position: Option<PositionConfig>,
}

/// How it went.
#[derive(Debug)]
pub struct TeamReport {
    pub ending: Ending,
    /// Flown time over wall time; `None` if nothing was flown.
    pub realtime_factor: Option<f64>,
    /// Those that ended in order.
    pub vehicles: Vec<VehicleSummary>,
    /// Messages over links that were up did not arrive in time; runs may differ.
    pub stalled: bool,
}

/// Why a flight was over.
#[derive(Debug)]
pub enum Ending {
    /// There was nothing more to fly.
    Flown,
    /// Somebody wished so.
    Interrupted,
    /// Each of these would have been enough.
    Failed(Vec<anyhow::Error>),
}

impl Ending {
    /// - `flown`: how the flight itself ended.
    /// - `failures`: what went wrong while the vehicles ended.
    pub fn new(flown: anyhow::Result<()>, mut failures: Vec<anyhow::Error>) -> Self {
        match flown {
            Ok(()) if failures.is_empty() => Self::Flown,
            Err(error) if error.is::<Interrupted>() && failures.is_empty() => Self::Interrupted,
            Ok(()) => Self::Failed(failures),
            Err(error) => {
                failures.insert(0, error);
                Self::Failed(failures)
            }
        }
    }

    /// One line for each failure.
    pub fn diagnostics(&self) -> Vec<String> {
        match self {
            Self::Flown => Vec::new(),
            Self::Interrupted => {
                vec!["interrupted; what was flown until then is in the files".to_owned()]
            }
            Self::Failed(failures) => {
                let failures = failures.iter();
                failures.map(|error| format!("error: {error:#}")).collect()
            }
        }
    }
}

/// What happens on the way, for whoever looks on.
pub enum Progress<'a> {
    /// The first vehicle can be asked.
    Listening {
        endpoints: &'a [String],
    },
    Flying {
        tick_idx: usize,
        tick_count: usize,
    },
    /// A vehicle said this to people; told after the flight.
    Said {
        vehicle: &'a str,
        line: &'a str,
    },
}

/// Messages that should be there are waited for no longer than this.
const STALL_LIMIT: Duration = Duration::from_secs(10);
/// So long may a vehicle take to open its session, or to write its files.
const PATIENCE: Duration = Duration::from_secs(60);
/// So long may a tick take a vehicle. The dearest frame, a search for a lost place on a machine
/// with other work, takes a sixth of it.
const TICK_PATIENCE: Duration = Duration::from_secs(30);

/// Flies the plan, at most in real time.
pub fn fly(plan: &TeamPlan, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<TeamReport> {
    create_folder(&plan.out)?;
    let recordings = open_recordings(plan)?;
    check_inputs_are_kept(plan, &recordings)?;
    let recordings = recordings.iter().map(stamps).collect::<Vec<_>>();
    let ticks = clock::ticks(&recordings);
    interrupt::listen();
    let mut team = Team::new(plan);
    let mut flight = Flight {
        first_ns: recordings.iter().map(|stamps| stamps[0]).collect(),
        flown_s: 0.0,
        wall_s: 0.0,
    };
    let flown = team
        .start(plan, observe)
        .and_then(|()| team.greet(&flight.first_ns))
        .and_then(|()| flight.fly(&mut team, plan, &ticks, observe));
    let failures = team.finish(plan);
    for (vehicle, line) in team.crew.last_words() {
        observe(Progress::Said {
            vehicle: &vehicle,
            line: &line,
        });
    }
    Ok(TeamReport {
        ending: Ending::new(flown, failures),
        realtime_factor: flight.realtime_factor(),
        vehicles: team.crew.summaries().into_iter().flatten().collect(),
        stalled: team.barrier.stalled(),
    })
}

/// How far it has come.
struct Flight {
    /// On each vehicle's own clock.
    first_ns: Vec<i64>,
    flown_s: f64,
    wall_s: f64,
}

impl Flight {
    fn fly(
        &mut self,
        team: &mut Team,
        plan: &TeamPlan,
        ticks: &[Tick],
        observe: &mut dyn FnMut(Progress<'_>),
    ) -> anyhow::Result<()> {
        let began = Instant::now();
        let mut previous: Option<(Instant, i64)> = None;
        for (tick_idx, tick) in ticks.iter().enumerate() {
            if let Some((at, elapsed_ns)) = previous {
                let step_ns = u64::try_from(tick.elapsed_ns - elapsed_ns).unwrap_or(0);
                let due = at + Duration::from_nanos(step_ns);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
            previous = Some((Instant::now(), tick.elapsed_ns));
            team.cut_and_heal(&plan.outages, tick);
            let elapsed_s = tick.elapsed_ns as f64 * 1e-9;
            team.tick(tick_idx as u64, tick, &self.first_ns)
                .with_context(|| format!("in tick {tick_idx}, {elapsed_s:.1} s into the flight"))?;
            self.flown_s = elapsed_s;
            self.wall_s = began.elapsed().as_secs_f64();
            observe(Progress::Flying {
                tick_idx,
                tick_count: ticks.len(),
            });
        }
        Ok(())
    }

    fn realtime_factor(&self) -> Option<f64> {
        (self.flown_s > 0.0 && self.wall_s > 0.0).then(|| self.flown_s / self.wall_s)
    }
}

/// The time stamps of each vehicle's frames.
fn open_recordings(plan: &TeamPlan) -> Result<Vec<Dataset>, DatasetError> {
    let vehicles = plan.vehicles.iter();
    let datasets = vehicles.map(|one| Dataset::open_with(&one.dataset, &one.recording));
    datasets.collect()
}

fn stamps(dataset: &Dataset) -> Vec<i64> {
    let frames = dataset.frames().iter();
    frames
        .map(|frame| frame.captured_at.nanoseconds())
        .collect()
}

/// What each vehicle leaves behind its name in the folder.
const RESULTS: [&str; 11] = [
    "tum",
    "cov.csv",
    "mcap",
    "final.tum",
    "own.tum",
    "map.ply",
    "received.ply",
    "json",
    "keeping.csv",
    "vehicle.toml",
    "log",
];

/// Files of an earlier flight are replaced, unless this one reads them.
fn check_inputs_are_kept(plan: &TeamPlan, recordings: &[Dataset]) -> anyhow::Result<()> {
    let results = plan.vehicles.iter().flat_map(|vehicle| {
        let path = |suffix| plan.out.join(format!("{}.{suffix}", vehicle.id));
        RESULTS.map(|suffix| NamedFile::new("--out", path(suffix)))
    });
    let fixes = plan.vehicles.iter().filter_map(|vehicle| {
        let file = vehicle.position.as_ref()?.file.as_ref()?;
        Some(NamedFile::new("the fixes", file))
    });
    let inputs = recordings.iter().flat_map(Dataset::files).chain(fixes);
    check_distinct(&results.collect::<Vec<_>>(), inputs)?;
    Ok(())
}

/// The running vehicles and the links between them.
struct Team {
    crew: Crew,
    links: Links,
    barrier: Barrier,
}

impl Team {
    fn new(plan: &TeamPlan) -> Self {
        let ids = plan.vehicles.iter().map(|vehicle| vehicle.id.clone());
        Self {
            crew: Crew::new(),
            links: Links::new(!plan.outages.is_empty()),
            barrier: Barrier::new(ids.collect()),
        }
    }

    fn start(
        &mut self,
        plan: &TeamPlan,
        observe: &mut dyn FnMut(Progress<'_>),
    ) -> anyhow::Result<()> {
        for (vehicle_idx, vehicle) in plan.vehicles.iter().enumerate() {
            let connect = self.links.endpoints_for(vehicle_idx)?;
            let config = vehicle_config(plan, vehicle, connect)?;
            self.crew.spawn(&config, Supervised::Pace, &plan.out)?;
            let endpoints = self.crew.wait_until_listening(vehicle_idx, PATIENCE)?;
            if vehicle_idx == 0 {
                observe(Progress::Listening {
                    endpoints: &endpoints,
                });
            }
            self.links.add_vehicle(&endpoints)?;
        }
        Ok(())
    }

    /// Beacons until everybody has heard everybody: from then on, what is published arrives.
    fn greet(&mut self, first_ns: &[i64]) -> anyhow::Result<()> {
        let mut waited = Waited::from(Instant::now());
        while !self.barrier.everybody_heard_everybody() {
            if waited.until(Instant::now()) > PATIENCE {
                let pairs = self.barrier.silent_pairs();
                bail!("the vehicles do not hear each other: {pairs}");
            }
            for (vehicle_idx, now_ns) in first_ns.iter().enumerate() {
                let order = Order::Greet { now_ns: *now_ns };
                self.crew.order(vehicle_idx, &order)?;
            }
            let until = Instant::now() + Duration::from_millis(50);
            while let Some(event) = self.crew.next_event(until)? {
                self.note(event)?;
            }
        }
        Ok(())
    }

    fn cut_and_heal(&mut self, outages: &[Outage], tick: &Tick) {
        let elapsed_s = tick.elapsed_ns as f64 * 1e-9;
        for pair in self.links.pairs() {
            let ids = [
                self.barrier.id(pair.server_idx),
                self.barrier.id(pair.client_idx),
            ];
            let cut = outages
                .iter()
                .find(|outage| outage.applies(elapsed_s) && outage.concerns(ids));
            if self.links.set_cut(pair, cut.map(|outage| outage.cut)) {
                self.barrier.set_up(pair, cut.is_none());
            }
        }
    }

    fn tick(&mut self, tick_number: u64, tick: &Tick, first_ns: &[i64]) -> anyhow::Result<()> {
        let sent_before = self.barrier.sent_so_far();
        for (vehicle_idx, first_ns) in first_ns.iter().enumerate() {
            let order = Order::Tick {
                tick: tick_number,
                now_ns: first_ns + tick.elapsed_ns,
                sent_before: sent_before.clone(),
            };
            self.crew.order(vehicle_idx, &order)?;
        }
        self.barrier.begin(tick_number);
        let mut waited = Waited::from(Instant::now());
        let mut done_at: Option<Instant> = None;
        while !self.barrier.is_passed() {
            if let Some(vehicle_idx) = self.barrier.first_not_done() {
                if waited.until(Instant::now()) > TICK_PATIENCE {
                    let failure = self.crew.fail_by_silence(vehicle_idx, TICK_PATIENCE);
                    return Err(failure.into());
                }
            } else if done_at.is_none() {
                done_at = Some(Instant::now());
                self.ask()?;
            } else if done_at.is_some_and(|at| at.elapsed() > STALL_LIMIT) {
                self.barrier.give_up();
                break;
            }
            let until = Instant::now() + Duration::from_millis(200);
            if let Some(event) = self.crew.next_event(until)? {
                self.note(event)?;
            }
        }
        Ok(())
    }

    /// Now that everybody is done, lets those ask who want something.
    fn ask(&mut self) -> anyhow::Result<()> {
        for vehicle_idx in self.barrier.askers() {
            self.crew.order(vehicle_idx, &Order::Ask)?;
        }
        Ok(())
    }

    fn note(&mut self, event: CrewEvent) -> anyhow::Result<()> {
        match event.report {
            Report::TickDone {
                tick,
                sent,
                open_request_count,
            } => {
                self.barrier
                    .take_done(event.vehicle_idx, tick, sent, open_request_count);
            }
            Report::Heard {
                heard,
                open_request_count,
                neighbour_count,
            } => {
                self.barrier
                    .take_heard(event.vehicle_idx, &heard, open_request_count);
                self.barrier
                    .take_neighbours(event.vehicle_idx, neighbour_count);
            }
            Report::Listening { .. } | Report::Failed { .. } => {}
            Report::Finished { .. } => {
                let id = self.barrier.id(event.vehicle_idx);
                return Err(anyhow!("vehicle {id} ended early; somebody told it to"));
            }
        }
        Ok(())
    }

    /// Ends the peers first: anchors stay until they are done.
    fn finish(&mut self, plan: &TeamPlan) -> Vec<anyhow::Error> {
        let is_anchor = |idx: &usize| plan.vehicles[*idx].position.is_some();
        let started = 0..self.crew.started_count();
        let peers = started.clone().filter(|idx| !is_anchor(idx));
        let anchors = started.filter(is_anchor);
        self.crew.finish(peers.chain(anchors), PATIENCE)
    }
}

fn vehicle_config(
    plan: &TeamPlan,
    vehicle: &PlannedVehicle,
    connect: Vec<String>,
) -> anyhow::Result<VehicleConfig> {
    let absolute = |path: &Path| {
        std::path::absolute(path).with_context(|| format!("no such path: {}", path.display()))
    };
    let mut dataset = vehicle.dataset.clone();
    dataset.path = absolute(&dataset.path)?;
    let calibration = vehicle.recording.calibration.as_deref().map(absolute);
    let mut position = vehicle.position.clone();
    if let Some(file) = position
        .as_mut()
        .and_then(|position| position.file.as_mut())
    {
        *file = absolute(file)?;
    }
    Ok(VehicleConfig {
        id: vehicle.id.clone(),
        camera: CameraConfig {
            dataset: Some(dataset.to_string()),
            calibration: calibration.transpose()?,
            topic: vehicle.recording.topic.clone(),
            ..CameraConfig::default()
        },
        position,
        zenoh: loopback(connect),
        estimation: EstimationConfig {
            threads: plan.threads,
            seed: Some(plan.seed),
            ..EstimationConfig::default()
        },
        out: absolute(&plan.out)?,
        keeping: None,
        store: None,
    })
}

/// A session on a free port of this machine that finds nobody by itself.
pub fn loopback(connect: Vec<String>) -> ZenohConfig {
    ZenohConfig {
        mode: ZenohMode::Peer,
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        connect,
        scouting: false,
    }
}

//! Recordings flown as a team: a process for each vehicle, one clock for all.

mod barrier;
mod child;
mod clock;
mod links;
mod outage;
mod report;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use crate::config::{
    CameraConfig, EstimationConfig, PositionConfig, VehicleConfig, ZenohConfig, ZenohMode,
};
use crate::dataset::{Dataset, DatasetArgument};
use crate::process::VehicleSummary;
use crate::process::control::{Order, Report};
use barrier::Barrier;
pub use child::{Crew, CrewEvent, Supervised};
use clock::Tick;
pub use links::{LinkPair, Links, loopback_address};
pub use outage::{MalformedOutage, Outage};
pub use report::{VehicleReport, table};

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
    /// Makes it an anchor.
    pub position: Option<PositionConfig>,
}

/// How it went.
#[derive(Debug)]
pub struct TeamReport {
    /// Flown time over wall time.
    pub realtime_factor: f64,
    pub vehicles: Vec<VehicleSummary>,
    /// Messages over links that were up did not arrive in time; runs may differ.
    pub stalled: bool,
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
}

/// Messages that should be there are waited for no longer than this.
const STALL_LIMIT: Duration = Duration::from_secs(10);
/// So long may a vehicle take to open its session, or to write its files.
const PATIENCE: Duration = Duration::from_secs(60);

/// Flies the plan, at most in real time.
pub fn fly(plan: &TeamPlan, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<TeamReport> {
    std::fs::create_dir_all(&plan.out)
        .with_context(|| format!("cannot create {}", plan.out.display()))?;
    let recordings = open_recordings(plan)?;
    let ticks = clock::ticks(&recordings);
    let mut team = Team::start(plan, observe)?;
    let first_ns: Vec<i64> = recordings.iter().map(|stamps| stamps[0]).collect();
    team.greet(&first_ns)?;
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
        team.tick(tick_idx as u64, tick, &first_ns)?;
        observe(Progress::Flying {
            tick_idx,
            tick_count: ticks.len(),
        });
    }
    let wall_s = began.elapsed().as_secs_f64();
    let flown_s = ticks
        .last()
        .map_or(0.0, |tick| tick.elapsed_ns as f64 * 1e-9);
    let vehicles = team.finish(plan)?;
    Ok(TeamReport {
        realtime_factor: if wall_s > 0.0 { flown_s / wall_s } else { 0.0 },
        vehicles,
        stalled: team.barrier.stalled(),
    })
}

/// The time stamps of each vehicle's frames.
fn open_recordings(plan: &TeamPlan) -> anyhow::Result<Vec<Vec<i64>>> {
    let stamps = plan.vehicles.iter().map(|vehicle| {
        let dataset = Dataset::open(&vehicle.dataset)?;
        let frames = dataset.frames().iter();
        Ok(frames
            .map(|frame| frame.captured_at.nanoseconds())
            .collect())
    });
    stamps.collect()
}

/// The running vehicles and the links between them.
struct Team {
    crew: Crew,
    links: Links,
    barrier: Barrier,
}

impl Team {
    fn start(plan: &TeamPlan, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<Self> {
        let mut crew = Crew::new();
        let mut links = Links::new(!plan.outages.is_empty());
        for (vehicle_idx, vehicle) in plan.vehicles.iter().enumerate() {
            let connect = links.endpoints_for(vehicle_idx)?;
            let config = vehicle_config(plan, vehicle, connect)?;
            crew.spawn(&config, Supervised::Pace, &plan.out)?;
            let endpoints = crew.wait_until_listening(vehicle_idx, PATIENCE)?;
            if vehicle_idx == 0 {
                observe(Progress::Listening {
                    endpoints: &endpoints,
                });
            }
            links.add_vehicle(&endpoints)?;
        }
        let ids = plan.vehicles.iter().map(|vehicle| vehicle.id.clone());
        Ok(Self {
            crew,
            links,
            barrier: Barrier::new(ids.collect()),
        })
    }

    /// Beacons until everybody has heard everybody: from then on, what is published arrives.
    fn greet(&mut self, first_ns: &[i64]) -> anyhow::Result<()> {
        let deadline = Instant::now() + PATIENCE;
        while !self.barrier.everybody_heard_everybody() {
            if Instant::now() > deadline {
                bail!(
                    "the vehicles do not hear each other: {}",
                    self.barrier.silent_pairs()
                );
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
        let mut done_at: Option<Instant> = None;
        while !self.barrier.is_passed() {
            if self.barrier.all_done() {
                done_at.get_or_insert_with(Instant::now);
            }
            if done_at.is_some_and(|at| at.elapsed() > STALL_LIMIT) {
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

    fn note(&mut self, event: CrewEvent) -> anyhow::Result<()> {
        match event.report {
            Report::TickDone { tick, sent } => {
                self.barrier.take_done(event.vehicle_idx, tick, sent);
            }
            Report::Heard {
                heard,
                open_request_count,
            } => self
                .barrier
                .take_heard(event.vehicle_idx, &heard, open_request_count),
            Report::Listening { .. } => {}
            Report::Finished { .. } => {
                bail!("vehicle {} ended early", self.barrier.id(event.vehicle_idx));
            }
        }
        Ok(())
    }

    /// Ends the peers first: anchors stay until they are done.
    fn finish(&mut self, plan: &TeamPlan) -> anyhow::Result<Vec<VehicleSummary>> {
        let mut summaries: Vec<Option<VehicleSummary>> = vec![None; plan.vehicles.len()];
        let is_anchor = |idx: usize| plan.vehicles[idx].position.is_some();
        for anchors in [false, true] {
            let idxs = (0..plan.vehicles.len()).filter(|idx| is_anchor(*idx) == anchors);
            for vehicle_idx in idxs {
                self.crew.order(vehicle_idx, &Order::Finish)?;
                summaries[vehicle_idx] = Some(self.crew.wait_for_end(vehicle_idx, PATIENCE)?);
            }
        }
        Ok(summaries.into_iter().flatten().collect())
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
    dataset.folder = absolute(&dataset.folder)?;
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

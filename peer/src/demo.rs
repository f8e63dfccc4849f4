//! A rendered lab flown by a team: a simulator, three vehicles, and links that fail.

mod calibration;
mod score;
mod simulator;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use sim::{Cut, ScenarioName, VehicleDescription};

use crate::config::{CameraConfig, EstimationConfig, PositionConfig, VehicleConfig};
use crate::process::VehicleSummary;
use crate::process::control::Report;
use crate::team::{Crew, Links, Outage, Supervised, VehicleReport, loopback};
pub use calibration::sensor_yaml;
use simulator::{Simulator, SimulatorEvent};

/// What is flown.
#[derive(Clone, Debug)]
pub struct DemoPlan {
    pub scenario: ScenarioName,
    pub seed: u64,
    pub out: PathBuf,
}

/// How it went.
#[derive(Debug)]
pub struct DemoReport {
    /// Simulated time over wall time.
    pub realtime_factor: Option<f64>,
    pub vehicles: Vec<VehicleReport>,
    /// Before and after registration, in the manner of the paper's Fig. 10.
    pub plot: PathBuf,
}

/// What happens on the way, for whoever looks on.
pub enum Progress<'a> {
    /// The first vehicle can be asked.
    Listening {
        endpoints: &'a [String],
    },
    Flying {
        frame_idx: usize,
        frame_count: usize,
    },
    LinkCut {
        vehicle: &'a str,
        cut: Cut,
    },
    LinkHealed {
        vehicle: &'a str,
    },
}

/// So long may the simulator or a vehicle take to start, to take a frame, or to end.
const PATIENCE: Duration = Duration::from_secs(60);

/// Flies the demo, and judges it once everybody has ended.
pub fn fly(plan: &DemoPlan, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<DemoReport> {
    let out = std::path::absolute(&plan.out)?;
    std::fs::create_dir_all(&out).with_context(|| format!("cannot create {}", out.display()))?;
    let truth = TruthFolder::create()?;
    let simulator = Simulator::start(plan.scenario.name(), plan.seed, &truth.path)?;
    let mut flight = Flight::start(plan, &out, simulator, observe)?;
    flight.fly(observe)?;
    let summaries = flight.finish()?;
    let realtime_factor = flight.realtime_factor;
    // All vehicles have ended: now the truth may be looked at.
    drop(flight);
    truth.move_to(&out)?;
    judge(plan, &out, &summaries, realtime_factor)
}

/// When links fail: one breaks, another falls silent. The seed moves both.
fn outages(seed: u64) -> Vec<Outage> {
    let shift_s = (seed % 5) as f64;
    let outage = |vehicle: &str, start_s: f64, cut| Outage {
        vehicle: Some(vehicle.to_owned()),
        start_s,
        end_s: start_s + 8.0,
        cut,
    };
    vec![
        outage("drone1", 14.0 + shift_s, Cut::Reset),
        outage("drone2", 28.0 + shift_s, Cut::Blackhole),
    ]
}

/// The running processes.
struct Flight {
    // Declared first, so that vehicles end before the simulator that they listen to.
    crew: Crew,
    simulator: Simulator,
    links: Links,
    ids: Vec<String>,
    outages: Vec<Outage>,
    frame_count: usize,
    summaries: Vec<Option<VehicleSummary>>,
    realtime_factor: Option<f64>,
}

impl Flight {
    fn start(
        plan: &DemoPlan,
        out: &Path,
        mut simulator: Simulator,
        observe: &mut dyn FnMut(Progress<'_>),
    ) -> anyhow::Result<Self> {
        let (addresses, frame_count) = simulator.wait_until_listening(PATIENCE)?;
        let mut crew = Crew::new();
        let mut links = Links::new(true);
        let vehicles = plan.scenario.vehicles();
        for (vehicle_idx, vehicle) in vehicles.iter().enumerate() {
            let address = addresses.iter().find(|one| one.id == vehicle.id);
            let address = address.with_context(|| format!("no stream for {}", vehicle.id))?;
            let connect = links.endpoints_for(vehicle_idx)?;
            let config = vehicle_config(plan, vehicle, &address.address, connect, out)?;
            crew.spawn(&config, Supervised::Watch, out)?;
            let endpoints = crew.wait_until_listening(vehicle_idx, PATIENCE)?;
            if vehicle_idx == 0 {
                observe(Progress::Listening {
                    endpoints: &endpoints,
                });
            }
            links.add_vehicle(&endpoints)?;
        }
        Ok(Self {
            crew,
            simulator,
            links,
            outages: outages(plan.seed),
            frame_count,
            summaries: vec![None; vehicles.len()],
            ids: vehicles
                .iter()
                .map(|vehicle| vehicle.id.to_owned())
                .collect(),
            realtime_factor: None,
        })
    }

    fn fly(&mut self, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<()> {
        let mut heard_at = Instant::now();
        loop {
            self.take_reports(Instant::now())?;
            let event = self.simulator.next_event(Duration::from_millis(50))?;
            match event {
                None if heard_at.elapsed() > PATIENCE => bail!("the simulator has fallen silent"),
                None => continue,
                Some(SimulatorEvent::FrameDone {
                    frame_idx,
                    simulated_s,
                }) => {
                    observe(Progress::Flying {
                        frame_idx,
                        frame_count: self.frame_count,
                    });
                    self.cut_and_heal(simulated_s, observe);
                }
                Some(SimulatorEvent::VehicleLost { id, reason }) => {
                    bail!("the simulator has lost {id}: {reason}");
                }
                Some(SimulatorEvent::Finished { report }) => {
                    self.realtime_factor = report.realtime_factor;
                    return Ok(());
                }
                Some(SimulatorEvent::Listening { .. } | SimulatorEvent::Started) => {}
            }
            heard_at = Instant::now();
        }
    }

    fn cut_and_heal(&mut self, simulated_s: f64, observe: &mut dyn FnMut(Progress<'_>)) {
        for pair in self.links.pairs() {
            let ids = [
                self.ids[pair.server_idx].as_str(),
                self.ids[pair.client_idx].as_str(),
            ];
            let concerned = self.outages.iter().find(|outage| outage.concerns(ids));
            let Some(outage) = concerned else { continue };
            let active = self
                .outages
                .iter()
                .find(|outage| outage.applies(simulated_s) && outage.concerns(ids));
            if self.links.set_cut(pair, active.map(|outage| outage.cut)) {
                let name = |outage: &Outage| outage.vehicle.clone().unwrap_or_default();
                match active {
                    Some(active) => observe(Progress::LinkCut {
                        vehicle: &name(active),
                        cut: active.cut,
                    }),
                    None => observe(Progress::LinkHealed {
                        vehicle: &name(outage),
                    }),
                }
            }
        }
    }

    fn take_reports(&mut self, until: Instant) -> anyhow::Result<()> {
        while let Some(event) = self.crew.next_event(until)? {
            if let Report::Finished { summary } = event.report {
                self.summaries[event.vehicle_idx] = Some(*summary);
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> anyhow::Result<Vec<VehicleSummary>> {
        for vehicle_idx in 0..self.ids.len() {
            let summary = self.crew.wait_for_end(vehicle_idx, PATIENCE)?;
            self.summaries[vehicle_idx] = Some(summary);
        }
        Ok(self.summaries.iter().flatten().cloned().collect())
    }
}

fn vehicle_config(
    plan: &DemoPlan,
    vehicle: &VehicleDescription,
    stream: &str,
    connect: Vec<String>,
    out: &Path,
) -> anyhow::Result<VehicleConfig> {
    let calibration = out.join(format!("{}.camera.yaml", vehicle.id));
    std::fs::write(&calibration, sensor_yaml(vehicle))
        .with_context(|| format!("cannot write {}", calibration.display()))?;
    Ok(VehicleConfig {
        id: vehicle.id.to_owned(),
        camera: CameraConfig {
            stream: Some(stream.to_owned()),
            calibration: Some(calibration),
            ..CameraConfig::default()
        },
        position: vehicle.has_position_source.then(|| PositionConfig {
            stream: true,
            site: plan.scenario.name().to_owned(),
            ..PositionConfig::default()
        }),
        zenoh: loopback(connect),
        estimation: EstimationConfig {
            seed: Some(plan.seed),
            ..EstimationConfig::default()
        },
        out: out.to_owned(),
        store: None,
    })
}

fn judge(
    plan: &DemoPlan,
    out: &Path,
    summaries: &[VehicleSummary],
    realtime_factor: Option<f64>,
) -> anyhow::Result<DemoReport> {
    let vehicles = summaries.iter().map(|summary| {
        let score = score::score(out, summary, plan.seed)?;
        Ok(VehicleReport::new(summary, Some(&score)))
    });
    let vehicles: Vec<VehicleReport> = vehicles.collect::<anyhow::Result<_>>()?;
    let plot = out.join("realignment.svg");
    let named = |role: &str| summaries.iter().find(|summary| summary.role == role);
    if let (Some(anchor), Some(peer)) = (named("anchor"), named("peer")) {
        score::realignment(out, &anchor.id, &peer.id)?
            .plot(format!("{} before and after registration", peer.id))
            .write(&plot)?;
    }
    Ok(DemoReport {
        realtime_factor,
        vehicles,
        plot,
    })
}

/// A folder that no vehicle is told of. It is removed in the end, whatever happens.
struct TruthFolder {
    path: PathBuf,
}

impl TruthFolder {
    fn create() -> anyhow::Result<Self> {
        let name = format!("starling-truth-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path)
            .with_context(|| format!("cannot create {}", path.display()))?;
        Ok(Self { path })
    }

    fn move_to(&self, out: &Path) -> anyhow::Result<()> {
        for entry in std::fs::read_dir(&self.path)? {
            let from = entry?.path();
            if let Some(name) = from.file_name() {
                std::fs::copy(&from, out.join(name))?;
            }
        }
        Ok(())
    }
}

impl Drop for TruthFolder {
    fn drop(&mut self) {
        // What cannot be removed is a few kilobytes in the system's folder for such things.
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

//! A rendered lab flown by a team: a simulator, three vehicles, and links that fail.

mod calibration;
mod score;
mod simulator;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use sim::{Cut, ScenarioName, VehicleDescription};

use crate::config::{CameraConfig, EstimationConfig, KeepingConfig, PositionConfig, VehicleConfig};
use crate::evaluate::SwarmScore;
use crate::files::create_folder;
use crate::plot::Picture;
use crate::process::VehicleSummary;
use crate::process::control::Report;
use crate::process::interrupt::{self, Interrupted};
use crate::team::{Crew, Ending, Links, Outage, Supervised, VehicleReport, Waited, loopback};
pub use calibration::sensor_yaml;
use simulator::{Simulator, SimulatorEvent, SimulatorReport, VehicleTruth};

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
    pub ending: Ending,
    /// Simulated time over wall time.
    pub realtime_factor: Option<f64>,
    /// Those that ended in order.
    pub vehicles: Vec<VehicleReport>,
    /// How the drones held together, once their truth is known.
    pub swarm: Option<SwarmScore>,
    /// What those lost on the way, for a person.
    pub losses: Vec<String>,
    /// Before and after registration, in the manner of the paper's Fig. 10.
    pub plot: Option<PathBuf>,
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
    /// A vehicle said this to people; told after the flight.
    Said {
        vehicle: &'a str,
        line: &'a str,
    },
}

/// So long may the simulator or a vehicle take to start, to take a frame, or to end.
const PATIENCE: Duration = Duration::from_secs(60);

/// Flies the demo, and judges it once everybody has ended.
pub fn fly(plan: &DemoPlan, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<DemoReport> {
    let out = std::path::absolute(&plan.out)?;
    create_folder(&out)?;
    remove_judgements(plan, &out);
    interrupt::listen();
    let simulator = Simulator::start(plan.scenario.name(), plan.seed)?;
    let mut flight = Flight::new(plan, simulator);
    let flown = flight
        .start(plan, &out, observe)
        .and_then(|()| flight.fly(observe));
    let failures = flight.finish();
    for (vehicle, line) in flight.crew.last_words() {
        observe(Progress::Said {
            vehicle: &vehicle,
            line: &line,
        });
    }
    let summaries: Vec<VehicleSummary> = flight.crew.summaries().into_iter().flatten().collect();
    let report = flight.report.take();
    // All vehicles have ended: now the truth may be looked at.
    drop(flight);
    let ending = Ending::new(flown, failures);
    Ok(judge(plan, &out, &summaries, report, ending))
}

/// What an earlier flight into the same folder left: its truth is nothing for a vehicle, and its
/// picture would be taken for this flight's.
fn remove_judgements(plan: &DemoPlan, out: &Path) {
    let vehicles = plan.scenario.vehicles();
    let truths = vehicles.iter().map(|vehicle| truth_path(out, vehicle.id));
    for path in truths.chain([out.join(PLOT)]) {
        // Most often there is none.
        let _ = std::fs::remove_file(path);
    }
}

const PLOT: &str = "realignment.svg";

fn truth_path(out: &Path, id: &str) -> PathBuf {
    out.join(format!("{id}.truth.tum"))
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
    /// Whether there is a route that could be ended.
    has_begun: bool,
    /// Once the route is over.
    report: Option<SimulatorReport>,
}

impl Flight {
    fn new(plan: &DemoPlan, simulator: Simulator) -> Self {
        let vehicles = plan.scenario.vehicles();
        Self {
            crew: Crew::new(),
            simulator,
            links: Links::new(true),
            ids: vehicles
                .iter()
                .map(|vehicle| vehicle.id.to_owned())
                .collect(),
            outages: outages(plan.seed),
            frame_count: 0,
            has_begun: false,
            report: None,
        }
    }

    fn start(
        &mut self,
        plan: &DemoPlan,
        out: &Path,
        observe: &mut dyn FnMut(Progress<'_>),
    ) -> anyhow::Result<()> {
        let (addresses, frame_count) = self.simulator.wait_until_listening(PATIENCE)?;
        self.frame_count = frame_count;
        for (vehicle_idx, vehicle) in plan.scenario.vehicles().iter().enumerate() {
            let address = addresses.iter().find(|one| one.id == vehicle.id);
            let address = address.with_context(|| format!("no stream for {}", vehicle.id))?;
            let connect = self.links.endpoints_for(vehicle_idx)?;
            let config = vehicle_config(plan, vehicle, &address.address, connect, out)?;
            self.crew.spawn(&config, Supervised::Watch, out)?;
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

    fn fly(&mut self, observe: &mut dyn FnMut(Progress<'_>)) -> anyhow::Result<()> {
        let mut waited = Waited::from(Instant::now());
        let mut newest = (0, 0.0);
        loop {
            let context = || format!("in frame {}, {:.1} s into the flight", newest.0, newest.1);
            self.take_reports().with_context(context)?;
            let event = self.simulator.next_event(Duration::from_millis(50));
            match event.with_context(context)? {
                None if waited.until(Instant::now()) > PATIENCE => {
                    self.simulator.give_up();
                    let silence = anyhow!("the simulator has fallen silent; is it stopped?");
                    return Err(silence).with_context(context);
                }
                None => continue,
                Some(SimulatorEvent::FrameDone {
                    frame_idx,
                    simulated_s,
                }) => {
                    newest = (frame_idx, simulated_s);
                    observe(Progress::Flying {
                        frame_idx,
                        frame_count: self.frame_count,
                    });
                    self.cut_and_heal(simulated_s, observe);
                }
                Some(SimulatorEvent::VehicleLost { id, reason }) => {
                    // A vehicle that died says more about it than the simulator can.
                    self.await_reports(Duration::from_millis(500))
                        .with_context(context)?;
                    return Err(self.crew.fail(&id, &reason)).with_context(context);
                }
                Some(SimulatorEvent::Finished { report }) => {
                    let flown_count = report.frame_count;
                    self.report = Some(report);
                    return self.check_whole(flown_count);
                }
                Some(SimulatorEvent::Started) => self.has_begun = true,
                Some(SimulatorEvent::Listening { .. }) => {}
            }
            waited = Waited::from(Instant::now());
        }
    }

    /// A signal to all of a group ends the route before this process looks at its own.
    fn check_whole(&self, flown_count: usize) -> anyhow::Result<()> {
        if interrupt::wished() {
            return Err(Interrupted.into());
        }
        if flown_count < self.frame_count {
            let planned_count = self.frame_count;
            bail!("the simulator ended after {flown_count} of {planned_count} frames");
        }
        Ok(())
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

    fn take_reports(&mut self) -> anyhow::Result<()> {
        self.await_reports(Duration::ZERO)
    }

    /// Vehicles say nothing while they fly; that one fails is heard here.
    fn await_reports(&mut self, patience: Duration) -> anyhow::Result<()> {
        let until = Instant::now() + patience;
        while let Some(event) = self.crew.next_event(until)? {
            if matches!(event.report, Report::Finished { .. }) && self.report.is_none() {
                let id = &self.ids[event.vehicle_idx];
                // At the end of the route a vehicle may be faster than the simulator's report.
                tracing::debug!(id, "ended before the simulator");
            }
        }
        Ok(())
    }

    /// Ends the route where it is, which ends the vehicles; those that do not see it are told.
    fn finish(&mut self) -> Vec<anyhow::Error> {
        let started = 0..self.crew.started_count();
        if !self.has_begun {
            return self.crew.finish(started, PATIENCE);
        }
        self.simulator.end_early();
        let mut failures = Vec::new();
        if self.report.is_none() && !self.simulator.is_lost() {
            failures.extend(self.await_report().err());
        }
        failures.extend(self.crew.finish(started, PATIENCE));
        failures
    }

    /// The truth comes with it.
    fn await_report(&mut self) -> anyhow::Result<()> {
        let mut waited = Waited::from(Instant::now());
        while waited.until(Instant::now()) < PATIENCE {
            let event = self.simulator.next_event(Duration::from_millis(100))?;
            if let Some(SimulatorEvent::Finished { report }) = event {
                self.report = Some(report);
                return Ok(());
            }
        }
        bail!("the simulator does not end; is it stopped?")
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
    std::fs::write(
        &calibration,
        sensor_yaml(&vehicle.camera, &vehicle.body_from_camera),
    )
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
        keeping: keeping_config(vehicle),
        store: None,
    })
}

/// Who holds a place behind another knows how far apart the lights are that all carry.
fn keeping_config(vehicle: &VehicleDescription) -> Option<KeepingConfig> {
    let lights = vehicle.lights.filter(|_| vehicle.keeps_place)?;
    Some(KeepingConfig {
        light_distance_m: lights.length_m,
        ..KeepingConfig::default()
    })
}

fn judge(
    plan: &DemoPlan,
    out: &Path,
    summaries: &[VehicleSummary],
    report: Option<SimulatorReport>,
    ending: Ending,
) -> DemoReport {
    let mut losses: Vec<String> = summaries
        .iter()
        .filter_map(|summary| Some(format!("{}: {}", summary.id, summary.loss()?)))
        .collect();
    let mut vehicles = Vec::new();
    let (mut plot, mut swarm) = (None, None);
    // Without the simulator's report nobody knows the truth.
    if let Some(report) = &report {
        write_truth(out, &report.vehicles, &mut losses);
        plot = draw(out, summaries, &mut losses);
        swarm = score::swarm(plan.scenario, out, summaries)
            .map_err(|error| losses.push(format!("the swarm cannot be judged: {error:#}")))
            .ok();
    }
    for summary in summaries {
        let score = report
            .as_ref()
            .map(|_| score::score(out, summary, plan.seed))
            .transpose();
        if let Err(error) = &score {
            losses.push(format!("{}: cannot be judged: {error:#}", summary.id));
        }
        vehicles.push(VehicleReport::new(summary, score.ok().flatten()));
    }
    DemoReport {
        ending,
        realtime_factor: report.and_then(|report| report.realtime_factor),
        vehicles,
        swarm,
        plot,
        losses,
    }
}

fn write_truth(out: &Path, truths: &[VehicleTruth], losses: &mut Vec<String>) {
    for truth in truths {
        let path = truth_path(out, &truth.id);
        if let Err(error) = std::fs::write(&path, &truth.truth_tum) {
            // A part of the truth would be judged by; there may be none.
            let _ = std::fs::remove_file(&path);
            losses.push(format!(
                "{}: cannot write {}: {error}",
                truth.id,
                path.display()
            ));
        }
    }
}

fn draw(out: &Path, summaries: &[VehicleSummary], losses: &mut Vec<String>) -> Option<PathBuf> {
    let named = |role: &str| summaries.iter().find(|summary| summary.role == role);
    let (anchor, peer) = (named("anchor")?, named("peer")?);
    let plot = out.join(PLOT);
    let drawn = score::realignment(out, &anchor.id, &peer.id).and_then(|realignment| {
        let title = format!("{} before and after registration", peer.id);
        Ok(realignment.plot(title).write(&plot)?)
    });
    match drawn {
        Ok(()) => Some(plot),
        Err(error) => {
            losses.push(format!("no picture: {error:#}"));
            None
        }
    }
}

#[cfg(test)]
mod tests;

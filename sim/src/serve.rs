//! The body of the simulator process.

mod link;
mod pacer;
mod truth;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use camera::Image;
use serde::Serialize;

use crate::renderer::{Renderer, Scene};
use crate::scenario::{Scenario, ScenarioName};
use crate::stream::Fix;
use link::Link;
use pacer::Pacer;

/// What to serve, and how.
#[derive(Clone, Debug)]
pub struct ServeSettings {
    pub scenario: ScenarioName,
    pub seed: u64,
    pub pace: Pace,
    /// Ends the route early, for tests.
    pub frame_count_max: Option<usize>,
    /// Once somebody sets it, the route ends in order after the frame that is being flown.
    pub end_wished: Option<&'static AtomicBool>,
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
            pace: Pace::RealTime,
            frame_count_max: None,
            end_wished: None,
            connect_timeout: Duration::from_secs(60),
            acknowledge_timeout: Duration::from_secs(30),
        }
    }
}

impl ServeSettings {
    fn is_end_wished(&self) -> bool {
        self.end_wished
            .is_some_and(|wished| wished.load(Ordering::Relaxed))
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
    FrameDone {
        frame_idx: usize,
        simulated_s: f64,
        wall_s: f64,
    },
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
    /// Simulated duration over wall duration, from the first frame to the last acknowledgement.
    pub realtime_factor: Option<f64>,
    pub vehicles: Vec<VehicleReport>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VehicleReport {
    pub id: String,
    pub frames_sent: usize,
    pub frames_acknowledged: usize,
    pub fixes_sent: usize,
    pub ending: Ending,
    /// Where its camera truly was, a TUM line per frame that was sent. It is in no file while
    /// anybody flies.
    pub truth_tum: String,
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
}

/// Renders the scenario for every vehicle that connects, frame by frame, until the routes end.
///
/// Each vehicle gets a loopback listener on a free port; `observe` hears of them first.
/// All frames of one instant go out together, and the next instant waits until every vehicle
/// has acknowledged; meanwhile the next frames are rendered on one other thread.
/// A vehicle that dies, or never comes, does not stop the others.
pub fn serve(
    settings: &ServeSettings,
    observe: &mut dyn FnMut(&ServeEvent),
) -> Result<ServeReport, ServeError> {
    let scenario = Scenario::new(settings.scenario, settings.seed);
    serve_scenario(&scenario, settings, observe)
}

fn serve_scenario(
    scenario: &Scenario,
    settings: &ServeSettings,
    observe: &mut dyn FnMut(&ServeEvent),
) -> Result<ServeReport, ServeError> {
    let limit = settings.frame_count_max.unwrap_or(usize::MAX);
    let frame_count = scenario.frame_count.min(limit);
    let mut vehicles = Vec::new();
    for vehicle_idx in 0..scenario.vehicles.len() {
        vehicles.push(ServedVehicle::new(scenario, vehicle_idx));
    }
    let wanted: Vec<AtomicBool> = vehicles.iter().map(|_| AtomicBool::new(true)).collect();
    thread::scope(|scope| {
        // The scene is painted while the vehicles connect.
        let (sender, frames) = sync_channel(1);
        let renders = scope.spawn(|| render_all(scenario, frame_count, &wanted, sender));
        let mut service = Service {
            settings,
            scenario,
            wanted: &wanted,
            observe,
            vehicles,
        };
        service.connect(frame_count)?;
        let mut pacer = Pacer::new(settings.pace, 1.0 / scenario.frame_rate_hz);
        let mut frames_done = 0;
        let mut start = None;
        // Paused until the first images are there: painting is not part of the mission.
        while let Ok(images) = frames.recv() {
            let start = *start.get_or_insert_with(Instant::now);
            pacer.wait();
            if settings.is_end_wished() || !service.step(frames_done, &images) {
                break;
            }
            frames_done += 1;
            service.observe_frame(frames_done - 1, start.elapsed());
        }
        drop(frames);
        let wall_s = start.map_or(0.0, |start: Instant| start.elapsed().as_secs_f64());
        let report = service.finish(frames_done, wall_s);
        // The thread ends on its own once nobody takes its frames.
        let _ = renders.join();
        Ok(report)
    })
}

/// Renders every frame for every vehicle that still wants it.
fn render_all(
    scenario: &Scenario,
    frame_count: usize,
    wanted: &[AtomicBool],
    frames: SyncSender<Vec<Option<Image>>>,
) {
    let scene = Arc::new(Scene::paint(&scenario.world));
    let mut renderers: Vec<Renderer> = scenario
        .vehicles
        .iter()
        .map(|vehicle| {
            Renderer::new(
                Arc::clone(&scene),
                &vehicle.description.camera,
                vehicle.sensor,
            )
        })
        .collect();
    for frame_idx in 0..frame_count {
        let images = renderers
            .iter_mut()
            .zip(wanted)
            .enumerate()
            .map(|(vehicle_idx, (renderer, wanted))| {
                let shot = scenario.shot(vehicle_idx, frame_idx);
                let is_wanted = wanted.load(Ordering::Relaxed);
                is_wanted.then(|| renderer.render(&shot))
            })
            .collect();
        if frames.send(images).is_err() {
            return;
        }
    }
}

/// The simulator's side of one vehicle.
struct ServedVehicle {
    report: VehicleReport,
    /// Not yet sent, in the order of their stamps.
    fixes: Vec<Fix>,
    link: Option<Link>,
}

impl ServedVehicle {
    fn new(scenario: &Scenario, vehicle_idx: usize) -> Self {
        let id = scenario.vehicles[vehicle_idx].description.id;
        Self {
            report: VehicleReport {
                id: id.into(),
                frames_sent: 0,
                frames_acknowledged: 0,
                fixes_sent: 0,
                ending: Ending::RouteFinished,
                truth_tum: String::new(),
            },
            fixes: scenario.fixes(vehicle_idx),
            link: None,
        }
    }
}

struct Service<'a> {
    settings: &'a ServeSettings,
    scenario: &'a Scenario,
    /// Whether frames of a vehicle are still worth rendering.
    wanted: &'a [AtomicBool],
    observe: &'a mut dyn FnMut(&ServeEvent),
    vehicles: Vec<ServedVehicle>,
}

impl Service<'_> {
    fn connect(&mut self, frame_count: usize) -> Result<(), ServeError> {
        let listeners = link::listen(self.vehicles.len())?;
        let vehicles = self.vehicles.iter().zip(&listeners);
        let event = ServeEvent::Listening {
            vehicles: vehicles
                .map(|(vehicle, (_, address))| Listener {
                    id: vehicle.report.id.clone(),
                    address: *address,
                })
                .collect(),
            frame_count,
            frame_rate_hz: self.scenario.frame_rate_hz,
        };
        (self.observe)(&event);
        let timeout = self.settings.connect_timeout;
        let streams = link::await_hellos(listeners, timeout);
        if streams.iter().all(Option::is_none) {
            let ids: Vec<&str> = self.vehicles.iter().map(|v| v.report.id.as_str()).collect();
            return Err(ServeError::NobodyCame {
                waited_s: timeout.as_secs_f64(),
                missing: ids.join(", "),
            });
        }
        for (vehicle_idx, stream) in streams.into_iter().enumerate() {
            let link = stream
                .ok_or_else(|| "never connected and said hello".to_owned())
                .and_then(|stream| {
                    Link::new(stream, self.settings.acknowledge_timeout)
                        .map_err(|error| error.to_string())
                });
            match link {
                Ok(link) => self.vehicles[vehicle_idx].link = Some(link),
                Err(reason) => self.lose(vehicle_idx, reason),
            }
        }
        (self.observe)(&ServeEvent::Started);
        Ok(())
    }

    /// Sends one frame to everyone and waits for everyone; false once nobody is left.
    fn step(&mut self, frame_idx: usize, images: &[Option<Image>]) -> bool {
        let time_s = self.scenario.frame_time_s(frame_idx);
        let captured_at = self.scenario.timestamp(time_s);
        for (vehicle_idx, image) in images.iter().enumerate() {
            let vehicle = &mut self.vehicles[vehicle_idx];
            let (Some(link), Some(image)) = (&mut vehicle.link, image) else {
                continue;
            };
            let due = vehicle
                .fixes
                .iter()
                .take_while(|fix| fix.captured_at <= captured_at)
                .count();
            let fixes: Vec<Fix> = vehicle.fixes.drain(..due).collect();
            match link.send(&fixes, captured_at, image) {
                Ok(()) => {
                    vehicle.report.frames_sent += 1;
                    vehicle.report.fixes_sent += fixes.len();
                    let pose = self.scenario.site_from_camera(vehicle_idx, time_s);
                    let line = truth::tum_line(captured_at, &pose);
                    vehicle.report.truth_tum += &line;
                }
                Err(reason) => self.lose(vehicle_idx, reason),
            }
        }
        for vehicle_idx in 0..self.vehicles.len() {
            let vehicle = &mut self.vehicles[vehicle_idx];
            let Some(link) = &mut vehicle.link else {
                continue;
            };
            match link.await_acknowledgement(captured_at) {
                Ok(()) => vehicle.report.frames_acknowledged += 1,
                Err(reason) => self.lose(vehicle_idx, reason),
            }
        }
        self.vehicles.iter().any(|vehicle| vehicle.link.is_some())
    }

    fn observe_frame(&mut self, frame_idx: usize, wall: Duration) {
        (self.observe)(&ServeEvent::FrameDone {
            frame_idx,
            simulated_s: self.scenario.frame_time_s(frame_idx),
            wall_s: wall.as_secs_f64(),
        });
    }

    fn lose(&mut self, vehicle_idx: usize, reason: String) {
        let vehicle = &mut self.vehicles[vehicle_idx];
        vehicle.link = None;
        vehicle.report.ending = Ending::Lost {
            reason: reason.clone(),
        };
        self.wanted[vehicle_idx].store(false, Ordering::Relaxed);
        let id = vehicle.report.id.clone();
        (self.observe)(&ServeEvent::VehicleLost { id, reason });
    }

    fn finish(self, frames_done: usize, wall_s: f64) -> ServeReport {
        let mut reports = Vec::new();
        for vehicle in self.vehicles {
            if let Some(link) = vehicle.link {
                link.end();
            }
            reports.push(vehicle.report);
        }
        let simulated_s = self.scenario.frame_time_s(frames_done.saturating_sub(1));
        ServeReport {
            frame_count: frames_done,
            simulated_s,
            wall_s,
            realtime_factor: (wall_s > 0.0).then(|| simulated_s / wall_s),
            vehicles: reports,
        }
    }
}

#[cfg(test)]
mod tests;

//! The body of the simulator process.

mod link;
mod pacer;
mod render;
mod truth;

use std::any::Any;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use camera::Image;
use geometry::Timestamp;
use serde::Serialize;

use crate::flight::Flight;
use crate::route::Motion;
use crate::scenario::{Scenario, ScenarioName};
use crate::stream::Fix;
use link::Link;
use pacer::Pacer;
use render::Request;

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
    #[error(
        "rendering stopped at a bug of the simulator, so the vehicles get no more frames: run it \
         again with RUST_BACKTRACE=1 and report what it prints with the seed {seed}: {panicked}"
    )]
    RendererPanicked { seed: u64, panicked: String },
}

/// Renders the scenario for every vehicle that connects, frame by frame, until the routes end.
///
/// Each vehicle gets a loopback listener on a free port; `observe` hears of them first.
/// All frames of one instant go out together, and the next instant waits until every vehicle
/// has acknowledged; meanwhile the next one is flown and rendered, on one other thread. So what
/// a vehicle commands before it acknowledges a frame acts from the next frame on, and is seen in
/// the one after that.
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
    thread::scope(|scope| {
        let (requests, requested) = sync_channel(1);
        let (sender, frames) = sync_channel(1);
        let renders = scope.spawn(|| render::render_all(scenario, requested, sender));
        let mut service = Service {
            settings,
            scenario,
            observe,
            vehicles,
            flight: Flight::new(scenario),
            frame_count,
            requests,
        };
        let flown = service.fly_route(&frames);
        let Service {
            vehicles, requests, ..
        } = service;
        // The thread ends once nobody can ask it for frames.
        drop(requests);
        // Then nobody hears of an orderly end.
        renders
            .join()
            .map_err(|panicked| ServeError::RendererPanicked {
                seed: scenario.seed,
                panicked: words_of(&*panicked).into(),
            })?;
        Ok(finish(scenario, vehicles, &flown?))
    })
}

/// What a thread said when it panicked.
fn words_of(panicked: &(dyn Any + Send)) -> &str {
    let text = panicked.downcast_ref::<&str>().copied();
    text.or_else(|| panicked.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("it panicked without words")
}

/// How far the routes were flown.
struct Flown {
    frame_count: usize,
    wall_s: f64,
}

/// Ends the routes of those who are left.
fn finish(scenario: &Scenario, vehicles: Vec<ServedVehicle>, flown: &Flown) -> ServeReport {
    let mut reports = Vec::new();
    for vehicle in vehicles {
        if let Some(link) = vehicle.link {
            link.end();
        }
        reports.push(vehicle.report);
    }
    let Flown {
        frame_count,
        wall_s,
    } = *flown;
    let simulated_s = scenario.frame_time_s(frame_count.saturating_sub(1));
    ServeReport {
        frame_count,
        simulated_s,
        wall_s,
        realtime_factor: (wall_s > 0.0).then(|| simulated_s / wall_s),
        vehicles: reports,
    }
}

/// The simulator's side of one vehicle.
struct ServedVehicle {
    report: VehicleReport,
    /// Not yet sent, in the order of their stamps.
    fixes: Vec<Fix>,
    /// It may still connect.
    is_awaited: bool,
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
            is_awaited: true,
            link: None,
        }
    }
}

struct Service<'a> {
    settings: &'a ServeSettings,
    scenario: &'a Scenario,
    observe: &'a mut dyn FnMut(&ServeEvent),
    vehicles: Vec<ServedVehicle>,
    flight: Flight<'a>,
    frame_count: usize,
    requests: SyncSender<Request>,
}

impl Service<'_> {
    /// Until the routes end, or as long as anybody is left, and images come.
    fn fly_route(&mut self, frames: &Receiver<Vec<Option<Image>>>) -> Result<Flown, ServeError> {
        // The scene is painted while the vehicles connect.
        let mut motions = self.fly_to(0);
        self.connect()?;
        let mut pacer = Pacer::new(self.settings.pace, 1.0 / self.scenario.frame_rate_hz);
        let mut frames_done = 0;
        let mut start = None;
        while frames_done < self.frame_count {
            // Paused until the first images are there: painting is not part of the mission.
            let Ok(images) = frames.recv() else { break };
            let start = *start.get_or_insert_with(Instant::now);
            pacer.wait();
            if self.settings.is_end_wished() {
                break;
            }
            self.send(frames_done, &images, &motions);
            motions = self.fly_to(frames_done + 1);
            if !self.await_acknowledgements(frames_done) {
                break;
            }
            frames_done += 1;
            self.observe_frame(frames_done - 1, start.elapsed());
        }
        Ok(Flown {
            frame_count: frames_done,
            wall_s: start.map_or(0.0, |start: Instant| start.elapsed().as_secs_f64()),
        })
    }

    fn connect(&mut self) -> Result<(), ServeError> {
        let listeners = link::listen(self.vehicles.len())?;
        let vehicles = self.vehicles.iter().zip(&listeners);
        let event = ServeEvent::Listening {
            vehicles: vehicles
                .map(|(vehicle, (_, address))| Listener {
                    id: vehicle.report.id.clone(),
                    address: *address,
                })
                .collect(),
            frame_count: self.frame_count,
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
                Ok(link) => {
                    let vehicle = &mut self.vehicles[vehicle_idx];
                    vehicle.link = Some(link);
                    vehicle.is_awaited = false;
                }
                Err(reason) => self.lose(vehicle_idx, reason),
            }
        }
        (self.observe)(&ServeEvent::Started);
        Ok(())
    }

    /// Flies on with the commands that are known by now, and has the frame there rendered.
    fn fly_to(&mut self, frame_idx: usize) -> Vec<Motion> {
        let motions = self.flight.advance();
        if frame_idx < self.frame_count {
            let is_served = |vehicle: &ServedVehicle| vehicle.is_awaited || vehicle.link.is_some();
            // A thread that has panicked sends no images, which ends the route.
            let _ = self.requests.send(Request {
                frame_idx,
                motions: motions.clone(),
                wanted: self.vehicles.iter().map(is_served).collect(),
            });
        }
        motions
    }

    /// Sends one frame to everyone.
    fn send(&mut self, frame_idx: usize, images: &[Option<Image>], motions: &[Motion]) {
        let captured_at = self.captured_at(frame_idx);
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
                    let description = &self.scenario.vehicles[vehicle_idx].description;
                    let pose = motions[vehicle_idx].site_from_body * description.body_from_camera;
                    vehicle.report.truth_tum += &truth::tum_line(captured_at, &pose);
                }
                Err(reason) => self.lose(vehicle_idx, reason),
            }
        }
    }

    /// Waits for everyone and takes what they command; false once nobody is left.
    fn await_acknowledgements(&mut self, frame_idx: usize) -> bool {
        let captured_at = self.captured_at(frame_idx);
        for vehicle_idx in 0..self.vehicles.len() {
            let vehicle = &mut self.vehicles[vehicle_idx];
            let Some(link) = &mut vehicle.link else {
                continue;
            };
            match link.await_acknowledgement(captured_at) {
                Ok(velocity) => {
                    vehicle.report.frames_acknowledged += 1;
                    if let Some(velocity) = velocity {
                        self.flight.command(vehicle_idx, &velocity, frame_idx);
                    }
                }
                Err(reason) => self.lose(vehicle_idx, reason),
            }
        }
        self.vehicles.iter().any(|vehicle| vehicle.link.is_some())
    }

    fn captured_at(&self, frame_idx: usize) -> Timestamp {
        let time_s = self.scenario.frame_time_s(frame_idx);
        self.scenario.timestamp(time_s)
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
        vehicle.is_awaited = false;
        vehicle.report.ending = Ending::Lost {
            reason: reason.clone(),
        };
        let id = vehicle.report.id.clone();
        (self.observe)(&ServeEvent::VehicleLost { id, reason });
    }
}

#[cfg(test)]
mod tests;

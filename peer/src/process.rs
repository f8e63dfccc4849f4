//! A vehicle's process: drivers and link in, node in the middle, files and link out.

mod autopilot;
pub mod control;
mod input;
pub mod interrupt;
mod loss;
mod outputs;
mod paced;
mod summary;
mod vehicle;

use std::sync::mpsc::{Receiver, Sender, sync_channel};
use std::time::{Duration, Instant};

use camera::Calibration;
use geodesy::Datum;
use geometry::Timestamp;
use nalgebra::Vector3;
use protocol::VehicleId;
use protocol::keys::Key;

use crate::config::VehicleConfig;
use crate::files::create_folder;
use crate::link::{Inbox, LinkEvent, inbox};
use crate::node::{EpochStart, Event, Node, NodeSettings, PositionSource};
use crate::station::{StationLoop, StationWindow};
use crate::store::{Reloaded, Store};
use control::{Order, Report};
use input::Input;
use vehicle::Vehicle;

pub use autopilot::KeepingSummary;
pub use summary::VehicleSummary;

/// Who decides when the next frame comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supervision {
    /// Nobody: the camera does. A person reads along.
    None,
    /// The camera does; a parent reads reports, and its end is the vehicle's end.
    Watched,
    /// A parent's clock, tick by tick.
    Paced,
}

/// What the vehicle's loop wakes up for.
enum Arrival {
    Link(LinkEvent),
    Order(Order),
    /// The parent is gone.
    OrdersEnded,
    Input(Input),
}

/// Events that wait for the loop; the link drops and counts more, inputs wait for room.
const QUEUE_LIMIT: usize = 16_384;

/// Runs a vehicle until its input ends, and writes what it leaves behind.
pub fn fly(
    config: &VehicleConfig,
    supervision: Supervision,
    report: &mut dyn FnMut(&Report),
) -> anyhow::Result<VehicleSummary> {
    // At once: a parent's Ctrl-C comes when it comes.
    if supervision != Supervision::None {
        interrupt::leave_to_parent();
    }
    create_folder(&config.out)?;
    let mut source = input::open(config)?;
    let held = open_store(config)?;
    let node = open_node(config, source.calibration(), &held.1)?;
    if supervision == Supervision::None {
        interrupt::listen();
    }
    let station = autopilot::start(config, source.as_ref())?;
    let (sender, arrivals) = sync_channel(QUEUE_LIMIT);
    let link_inbox: Inbox = inbox(sender.clone(), Arrival::Link);
    let mut vehicle = Vehicle::open(config, node, held, link_inbox)?;
    report(&Report::Listening {
        endpoints: vehicle.endpoints(),
        first_captured_at_ns: source.first_captured_at().map(Timestamp::nanoseconds),
    });
    if supervision != Supervision::None {
        let sender = sender.clone();
        std::thread::spawn(move || control::read_orders(&sender));
    }
    if supervision == Supervision::Paced {
        // On a parent's clock only recordings are flown, and they take no velocities.
        paced::run(&mut vehicle, source.as_mut(), &arrivals, report);
    } else {
        let window = station.as_ref().map(StationLoop::window);
        let acknowledgements = input::start(source, sender, window.clone());
        run_free(&mut vehicle, &arrivals, &acknowledgements, window.as_ref());
    }
    if let Some(station) = station {
        vehicle.end_station(station.finish());
    }
    let summary = vehicle.finish();
    report(&Report::Finished {
        summary: Box::new(summary.clone()),
    });
    Ok(summary)
}

/// How often timers are looked at while no frame comes.
const TICK: Duration = Duration::from_millis(100);

fn run_free(
    vehicle: &mut Vehicle,
    arrivals: &Receiver<Arrival>,
    acknowledgements: &Sender<Timestamp>,
    station: Option<&StationWindow>,
) {
    let mut newest = (Timestamp::default(), Instant::now());
    loop {
        let arrival = arrivals.recv_timeout(TICK).ok();
        if interrupt::wished() {
            return;
        }
        // The vehicle's clock is the camera's, carried on by the wall between frames.
        let now = newest.0.after(newest.1.elapsed());
        match arrival {
            None => vehicle.take(Event::Tick, now),
            Some(Arrival::Link(event)) => vehicle.take_link(event, now),
            Some(Arrival::Input(Input::End)) | Some(Arrival::OrdersEnded) => return,
            Some(Arrival::Order(Order::Finish)) => return,
            Some(Arrival::Order(_)) => {}
            Some(Arrival::Input(input)) => {
                let captured_at = input.captured_at();
                let is_frame = input.is_frame();
                let is_readable = matches!(input, Input::Frame { .. });
                if is_frame {
                    newest = (captured_at, Instant::now());
                }
                vehicle.take_input(input, captured_at);
                if let (Some(station), true) = (station, is_readable) {
                    station.tell(captured_at, vehicle.obstacles());
                }
                // A driver that has gone needs no acknowledgement.
                if is_frame {
                    let _ = acknowledgements.send(captured_at);
                }
            }
        }
    }
}

fn open_store(config: &VehicleConfig) -> anyhow::Result<(Store, Vec<Reloaded>)> {
    let id = VehicleId::new(&config.id)?;
    Ok(match &config.store {
        Some(folder) => Store::open(id, folder)?,
        None => (Store::new(id), Vec::new()),
    })
}

fn open_node(
    config: &VehicleConfig,
    calibration: &Calibration,
    reloaded: &[Reloaded],
) -> anyhow::Result<Node> {
    let estimation = &config.estimation;
    let id = VehicleId::new(&config.id)?;
    // A restart begins a new epoch: its map shares no frame with the one before.
    let own_epochs = reloaded.iter().filter_map(|one| match &one.key {
        Key::Chunk(chunk) if chunk.map.anchor == id => Some(chunk.map.epoch.counter),
        Key::Placement(map) if map.anchor == id => Some(map.epoch.counter),
        _ => None,
    });
    let epoch_start = EpochStart {
        counter: own_epochs
            .max()
            .map_or(1, |highest| highest.saturating_add(1)),
        seed: estimation
            .seed
            .map_or_else(random_seed, |seed| seeded_by_name(seed, &config.id)),
    };
    let settings = NodeSettings {
        id,
        stale_after_s: estimation.stale_after_s,
        global_sigma_m: estimation.global_sigma_m,
        seed: estimation.seed.unwrap_or(1),
        epoch_start,
        background: Some(crate::background::spawn),
    };
    let Some(position) = &config.position else {
        return Ok(Node::peer(settings, calibration.clone()));
    };
    let geodetic = match &position.file {
        Some(path) => crate::position::read_fixes(position, path)?
            .fixes
            .iter()
            .any(|fix| matches!(fix.position, anchor::FixPosition::Geodetic(_))),
        None => false,
    };
    let source = PositionSource {
        datum: if geodetic {
            None
        } else {
            Some(Datum::site(&position.site)?)
        },
        antenna_in_body: Vector3::from(position.lever_arm_m),
    };
    Ok(Node::anchor(settings, calibration.clone(), &source))
}

fn seeded_by_name(seed: u64, id: &str) -> u64 {
    let fold = |sum: u64, byte: u8| sum.wrapping_mul(31).wrapping_add(u64::from(byte));
    id.bytes().fold(seed, fold)
}

/// A number that no other start of this vehicle has: the standard hasher is keyed at random.
fn random_seed() -> u64 {
    use std::hash::BuildHasher;
    std::hash::RandomState::new().hash_one(0)
}

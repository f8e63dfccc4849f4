//! The simulator as a child process: the only one that knows the truth.

use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde::Deserialize;

use crate::process::interrupt::{self, GLANCE, Interrupted};
use crate::team::{OwnedChild, Waited, how_it_ended, read_json_lines};

/// What the simulator says.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum SimulatorEvent {
    Listening {
        vehicles: Vec<VehicleAddress>,
        frame_count: usize,
    },
    Started,
    FrameDone {
        frame_idx: usize,
        simulated_s: f64,
    },
    VehicleLost {
        id: String,
        reason: String,
    },
    Finished {
        report: SimulatorReport,
    },
}

/// Where a vehicle finds its stream.
#[derive(Clone, Debug, Deserialize)]
pub struct VehicleAddress {
    pub id: String,
    pub address: String,
}

#[derive(Clone, Debug, Deserialize)]
pub struct SimulatorReport {
    pub frame_count: usize,
    pub realtime_factor: Option<f64>,
    pub vehicles: Vec<VehicleTruth>,
}

/// Where a vehicle's camera truly was, as the text of a TUM file.
#[derive(Clone, Debug, Deserialize)]
pub struct VehicleTruth {
    pub id: String,
    pub truth_tum: String,
}

/// The running simulator. It ends when this is dropped, or when the parent dies.
pub struct Simulator {
    child: OwnedChild,
    events: Receiver<SimulatorEvent>,
    is_lost: bool,
}

const QUEUE_LIMIT: usize = 4096;

impl Simulator {
    pub fn start(scenario: &str, seed: u64) -> anyhow::Result<Self> {
        let mut child = Command::new(std::env::current_exe()?)
            .args(["sim", "--scenario", scenario, "--seed", &seed.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start the simulator")?;
        let said = child.stdout.take().context("the simulator has no stdout")?;
        let (sender, events) = sync_channel(QUEUE_LIMIT);
        std::thread::spawn(move || {
            read_json_lines(said, |event| sender.send(event).is_ok());
        });
        Ok(Self {
            child: OwnedChild(child),
            events,
            is_lost: false,
        })
    }

    /// Asks it to end the route after the frame that is being flown.
    pub fn end_early(&mut self) {
        drop(self.child.stdin.take());
    }

    /// Nothing is waited for from it any more.
    pub fn give_up(&mut self) {
        self.is_lost = true;
    }

    /// Whether it has failed or was given up.
    pub fn is_lost(&self) -> bool {
        self.is_lost
    }

    /// The next event, waited for; `None` if none came in time.
    pub fn next_event(&mut self, patience: Duration) -> anyhow::Result<Option<SimulatorEvent>> {
        match self.events.recv_timeout(patience) {
            Ok(event) => Ok(Some(event)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => {
                self.is_lost = true;
                let how = how_it_ended(self.child.wait()?);
                bail!("the simulator (process {}) {how}", self.child.id())
            }
        }
    }

    /// Where the vehicles find their streams, and how many frames there will be.
    pub fn wait_until_listening(
        &mut self,
        patience: Duration,
    ) -> anyhow::Result<(Vec<VehicleAddress>, usize)> {
        let mut waited = Waited::from(Instant::now());
        while waited.until(Instant::now()) < patience {
            let event = self.next_event(GLANCE)?;
            if interrupt::wished() {
                return Err(Interrupted.into());
            }
            if let Some(SimulatorEvent::Listening {
                vehicles,
                frame_count,
            }) = event
            {
                return Ok((vehicles, frame_count));
            }
        }
        bail!(
            "the simulator (process {}) does not listen",
            self.child.id()
        )
    }
}

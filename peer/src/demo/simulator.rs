//! The simulator as a child process: the only one that knows the truth.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde::Deserialize;

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
    pub realtime_factor: Option<f64>,
}

/// The running simulator. It ends when this is dropped, or when the parent dies.
pub struct Simulator {
    child: Child,
    events: Receiver<SimulatorEvent>,
}

const QUEUE_LIMIT: usize = 4096;

impl Simulator {
    /// Starts it; the truth goes to `truth`.
    pub fn start(scenario: &str, seed: u64, truth: &Path) -> anyhow::Result<Self> {
        let mut child = Command::new(std::env::current_exe()?)
            .args(["sim", "--scenario", scenario, "--seed", &seed.to_string()])
            .arg("--truth")
            .arg(truth)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start the simulator")?;
        let lines = child.stdout.take().context("the simulator has no stdout")?;
        let (sender, events) = sync_channel(QUEUE_LIMIT);
        std::thread::spawn(move || {
            for line in BufReader::new(lines).lines().map_while(Result::ok) {
                match serde_json::from_str(&line) {
                    Ok(event) => {
                        if sender.send(event).is_err() {
                            return;
                        }
                    }
                    Err(error) => tracing::warn!(%error, line, "simulator's line ignored"),
                }
            }
        });
        Ok(Self { child, events })
    }

    /// The next event, waited for; `None` if none came in time.
    pub fn next_event(&mut self, patience: Duration) -> anyhow::Result<Option<SimulatorEvent>> {
        match self.events.recv_timeout(patience) {
            Ok(event) => Ok(Some(event)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => {
                let status = self.child.wait()?;
                bail!("the simulator failed ({status}); its message is above")
            }
        }
    }

    /// Where the vehicles find their streams, and how many frames there will be.
    pub fn wait_until_listening(
        &mut self,
        patience: Duration,
    ) -> anyhow::Result<(Vec<VehicleAddress>, usize)> {
        let deadline = Instant::now() + patience;
        while let Some(event) =
            self.next_event(deadline.saturating_duration_since(Instant::now()))?
        {
            if let SimulatorEvent::Listening {
                vehicles,
                frame_count,
            } = event
            {
                return Ok((vehicles, frame_count));
            }
        }
        bail!("the simulator does not listen")
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        if !matches!(self.child.try_wait(), Ok(Some(_))) {
            // It may have ended in this moment.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

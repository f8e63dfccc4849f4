//! Vehicles as child processes: orders down a pipe, reports up, nobody left behind.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use crate::config::VehicleConfig;
use crate::process::VehicleSummary;
use crate::process::control::{Order, Report};

/// What the parent decides for a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supervised {
    /// When time passes.
    Pace,
    /// Nothing but its end.
    Watch,
}

/// A report and whose it is.
pub struct CrewEvent {
    pub vehicle_idx: usize,
    pub report: Report,
}

/// All vehicles' processes. They end when this is dropped, and also when the parent dies, because
/// their pipes close.
pub struct Crew {
    members: Vec<Member>,
    sender: SyncSender<Incoming>,
    incoming: Receiver<Incoming>,
}

struct Member {
    id: String,
    child: Child,
    orders: Option<ChildStdin>,
    summary: Option<VehicleSummary>,
}

struct Incoming {
    vehicle_idx: usize,
    /// `None` when the vehicle has closed its pipe.
    report: Option<Report>,
}

const QUEUE_LIMIT: usize = 4096;

impl Crew {
    pub fn new() -> Self {
        let (sender, incoming) = sync_channel(QUEUE_LIMIT);
        Self {
            members: Vec::new(),
            sender,
            incoming,
        }
    }

    /// Starts a vehicle; its configuration is left in `folder` so that it can be run again.
    pub fn spawn(
        &mut self,
        config: &VehicleConfig,
        supervised: Supervised,
        folder: &Path,
    ) -> anyhow::Result<()> {
        let path = folder.join(format!("{}.vehicle.toml", config.id));
        std::fs::write(&path, toml::to_string(config)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
        let mode = match supervised {
            Supervised::Pace => "pace",
            Supervised::Watch => "watch",
        };
        let mut child = Command::new(std::env::current_exe()?)
            .args(["run", "--supervised", mode, "--config"])
            .arg(&path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start vehicle {}", config.id))?;
        let vehicle_idx = self.members.len();
        let reports = child.stdout.take().context("the vehicle has no stdout")?;
        let sender = self.sender.clone();
        std::thread::spawn(move || {
            for line in BufReader::new(reports).lines().map_while(Result::ok) {
                match serde_json::from_str(&line) {
                    Ok(report) => {
                        let incoming = Incoming {
                            vehicle_idx,
                            report: Some(report),
                        };
                        if sender.send(incoming).is_err() {
                            return;
                        }
                    }
                    Err(error) => tracing::warn!(%error, line, "report ignored"),
                }
            }
            let _ = sender.send(Incoming {
                vehicle_idx,
                report: None,
            });
        });
        self.members.push(Member {
            id: config.id.clone(),
            orders: child.stdin.take(),
            child,
            summary: None,
        });
        Ok(())
    }

    pub fn order(&mut self, vehicle_idx: usize, order: &Order) -> anyhow::Result<()> {
        let member = &mut self.members[vehicle_idx];
        let line = serde_json::to_string(order)? + "\n";
        let Some(orders) = &mut member.orders else {
            bail!("vehicle {} takes no orders any more", member.id);
        };
        orders
            .write_all(line.as_bytes())
            .with_context(|| format!("vehicle {} has ended", member.id))
    }

    /// The next report, waited for; `None` if none came in time. A vehicle that ends without
    /// having finished is an error.
    pub fn next_event(&mut self, until: Instant) -> anyhow::Result<Option<CrewEvent>> {
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let incoming = match self.incoming.recv_timeout(left) {
                Ok(incoming) => incoming,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return Ok(None),
            };
            let member = &mut self.members[incoming.vehicle_idx];
            match incoming.report {
                Some(report) => {
                    if let Report::Finished { summary } = &report {
                        member.summary = Some((**summary).clone());
                    }
                    return Ok(Some(CrewEvent {
                        vehicle_idx: incoming.vehicle_idx,
                        report,
                    }));
                }
                None if member.summary.is_some() => {}
                None => {
                    let status = member.child.wait()?;
                    bail!(
                        "vehicle {} failed ({status}); its message is above",
                        member.id
                    );
                }
            }
        }
    }

    pub fn wait_until_listening(
        &mut self,
        vehicle_idx: usize,
        patience: Duration,
    ) -> anyhow::Result<Vec<String>> {
        let until = Instant::now() + patience;
        while let Some(event) = self.next_event(until)? {
            if let Report::Listening { endpoints, .. } = event.report
                && event.vehicle_idx == vehicle_idx
            {
                return Ok(endpoints);
            }
        }
        bail!(
            "vehicle {} does not open its session",
            self.members[vehicle_idx].id
        )
    }

    pub fn wait_for_end(
        &mut self,
        vehicle_idx: usize,
        patience: Duration,
    ) -> anyhow::Result<VehicleSummary> {
        let until = Instant::now() + patience;
        while self.members[vehicle_idx].summary.is_none() {
            if self.next_event(until)?.is_none() {
                bail!("vehicle {} does not end", self.members[vehicle_idx].id);
            }
        }
        let member = &mut self.members[vehicle_idx];
        // The files are written before the report; what is left is leaving the network.
        member.orders = None;
        member.child.wait()?;
        member.summary.clone().context("the summary was waited for")
    }
}

impl Default for Crew {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        if !matches!(self.child.try_wait(), Ok(Some(_))) {
            // It may have ended in this moment.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

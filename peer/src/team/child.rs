//! Vehicles as child processes: orders down a pipe, reports up, nobody left behind.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use anyhow::Context;

use super::failure::{Trouble, VehicleFailure, how_it_ended};
use super::owned_child::{OwnedChild, read_json_lines};
use super::waited::Waited;
use crate::config::VehicleConfig;
use crate::process::VehicleSummary;
use crate::process::control::{Order, Report};
use crate::process::interrupt::{self, GLANCE, Interrupted};

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
    is_ending: bool,
}

struct Member {
    id: String,
    child: OwnedChild,
    orders: Option<ChildStdin>,
    /// What it says to people.
    log: PathBuf,
    summary: Option<VehicleSummary>,
    /// Why it says that it ends.
    error: Option<String>,
    has_failed: bool,
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
            is_ending: false,
        }
    }

    /// Starts a vehicle; its configuration is left in `folder` so that it can be run again, and
    /// so is what it says.
    pub fn spawn(
        &mut self,
        config: &VehicleConfig,
        supervised: Supervised,
        folder: &Path,
    ) -> anyhow::Result<()> {
        let path = folder.join(format!("{}.vehicle.toml", config.id));
        std::fs::write(&path, toml::to_string(config)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
        let log = folder.join(format!("{}.log", config.id));
        let said = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        let mode = match supervised {
            Supervised::Pace => "pace",
            Supervised::Watch => "watch",
        };
        let mut child = Command::new(std::env::current_exe()?)
            .args(["run", "--supervised", mode, "--config"])
            .arg(&path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(said)
            .spawn()
            .with_context(|| format!("cannot start vehicle {}", config.id))?;
        let vehicle_idx = self.members.len();
        let reports = child.stdout.take().context("the vehicle has no stdout")?;
        let sender = self.sender.clone();
        std::thread::spawn(move || {
            let incoming = |report| Incoming {
                vehicle_idx,
                report,
            };
            read_json_lines(reports, |report| {
                sender.send(incoming(Some(report))).is_ok()
            });
            // The crew may be gone already.
            let _ = sender.send(incoming(None));
        });
        self.members.push(Member {
            id: config.id.clone(),
            orders: child.stdin.take(),
            child: OwnedChild(child),
            log,
            summary: None,
            error: None,
            has_failed: false,
        });
        Ok(())
    }

    pub fn order(&mut self, vehicle_idx: usize, order: &Order) -> anyhow::Result<()> {
        let line = serde_json::to_string(order)? + "\n";
        let member = &mut self.members[vehicle_idx];
        let written = member
            .orders
            .as_mut()
            .is_some_and(|orders| orders.write_all(line.as_bytes()).is_ok());
        // Whoever does not read any more has ended, and the next event says how.
        if !written {
            member.orders = None;
        }
        Ok(())
    }

    /// The next report, waited for; `None` if none came in time. A vehicle that ends without
    /// having finished is an error, and so is somebody's wish for the end.
    pub fn next_event(&mut self, until: Instant) -> anyhow::Result<Option<CrewEvent>> {
        loop {
            // Before anything is taken from the queue, which would be lost.
            if !self.is_ending && interrupt::wished() {
                return Err(Interrupted.into());
            }
            let left = until.saturating_duration_since(Instant::now());
            // This end keeps a sender, so that only time runs out.
            let incoming = self.incoming.recv_timeout(left.min(GLANCE)).ok();
            let Some(incoming) = incoming else {
                if Instant::now() >= until {
                    return Ok(None);
                }
                continue;
            };
            let member = &mut self.members[incoming.vehicle_idx];
            match incoming.report {
                Some(report) => {
                    match &report {
                        Report::Finished { summary } => {
                            member.summary = Some((**summary).clone());
                        }
                        Report::Failed { error } => member.error = Some(error.clone()),
                        _ => {}
                    }
                    return Ok(Some(CrewEvent {
                        vehicle_idx: incoming.vehicle_idx,
                        report,
                    }));
                }
                None if member.summary.is_some() || member.has_failed => {}
                None => return Err(member.fail_by_ending().into()),
            }
        }
    }

    pub fn wait_until_listening(
        &mut self,
        vehicle_idx: usize,
        patience: Duration,
    ) -> anyhow::Result<Vec<String>> {
        let mut waited = Waited::from(Instant::now());
        while waited.until(Instant::now()) < patience {
            let event = self.next_event(Instant::now() + GLANCE)?;
            if let Some(event) = event
                && let Report::Listening { endpoints, .. } = event.report
                && event.vehicle_idx == vehicle_idx
            {
                return Ok(endpoints);
            }
        }
        Err(self.fail_by_silence(vehicle_idx, patience).into())
    }

    /// The vehicle has left the parent waiting for so long. It is given up.
    pub fn fail_by_silence(&mut self, vehicle_idx: usize, waited: Duration) -> VehicleFailure {
        let trouble = Trouble::Silent {
            waited_s: waited.as_secs_f64(),
        };
        self.members[vehicle_idx].fail(trouble)
    }

    /// A vehicle that somebody else gave up.
    pub fn fail(&mut self, id: &str, reason: &str) -> anyhow::Error {
        let member = self.members.iter_mut().find(|member| member.id == id);
        let trouble = Trouble::Lost {
            reason: reason.to_owned(),
        };
        match member {
            Some(member) => member.fail(trouble).into(),
            None => anyhow::anyhow!("vehicle {id} {reason}"),
        }
    }

    /// Ends these vehicles one after the other, so that they write their files. Those that have
    /// failed, or fail now, are left out; failures that are new are returned.
    pub fn finish(
        &mut self,
        vehicle_idxs: impl IntoIterator<Item = usize>,
        patience: Duration,
    ) -> Vec<anyhow::Error> {
        self.is_ending = true;
        let mut failures = Vec::new();
        for vehicle_idx in vehicle_idxs {
            if !self.members[vehicle_idx].has_failed {
                self.finish_one(vehicle_idx, patience, &mut failures);
            }
        }
        failures
    }

    fn finish_one(
        &mut self,
        vehicle_idx: usize,
        patience: Duration,
        failures: &mut Vec<anyhow::Error>,
    ) {
        // One that ends by itself needs no order, and may not read it any more.
        if self.members[vehicle_idx].summary.is_none() {
            let _ = self.order(vehicle_idx, &Order::Finish);
        }
        let mut waited = Waited::from(Instant::now());
        while self.members[vehicle_idx].summary.is_none() {
            if waited.until(Instant::now()) >= patience {
                failures.push(self.fail_by_silence(vehicle_idx, patience).into());
                return;
            }
            // It may be another one that has failed; that one is not asked any more.
            if let Err(failure) = self.next_event(Instant::now() + GLANCE) {
                failures.push(failure);
            }
            if self.members[vehicle_idx].has_failed {
                return;
            }
        }
        let member = &mut self.members[vehicle_idx];
        // The files are written before the report; what is left is leaving the network.
        member.orders = None;
        let _ = member.child.wait();
    }

    pub fn started_count(&self) -> usize {
        self.members.len()
    }

    /// What each vehicle said of itself at its end; `None` for those that failed.
    pub fn summaries(&self) -> Vec<Option<VehicleSummary>> {
        let members = self.members.iter();
        members.map(|member| member.summary.clone()).collect()
    }

    /// What each vehicle said to people, line by line, and where the rest is. Files of those that
    /// said nothing are removed.
    pub fn last_words(&self) -> Vec<(String, String)> {
        const LINE_COUNT_MAX: usize = 10;
        let mut said = Vec::new();
        for member in &self.members {
            let text = std::fs::read(&member.log).unwrap_or_default();
            let text = String::from_utf8_lossy(&text);
            if text.is_empty() {
                // An empty file that stays does no harm.
                let _ = std::fs::remove_file(&member.log);
            }
            let line_count = text.lines().count();
            let lines = text.lines().take(LINE_COUNT_MAX);
            said.extend(lines.map(|line| (member.id.clone(), line.to_owned())));
            if line_count > LINE_COUNT_MAX {
                let rest = line_count - LINE_COUNT_MAX;
                let line = format!("and {rest} lines more: {}", member.log.display());
                said.push((member.id.clone(), line));
            }
        }
        said
    }
}

impl Default for Crew {
    fn default() -> Self {
        Self::new()
    }
}

impl Member {
    /// It has ended, or is about to, without having finished.
    fn fail_by_ending(&mut self) -> VehicleFailure {
        self.orders = None;
        let how = match self.child.wait() {
            Ok(status) => how_it_ended(status),
            Err(error) => format!("cannot be waited for: {error}"),
        };
        self.fail(Trouble::Ended { how })
    }

    fn fail(&mut self, trouble: Trouble) -> VehicleFailure {
        self.has_failed = true;
        VehicleFailure {
            id: self.id.clone(),
            process: self.child.id(),
            trouble,
            last_line: last_line(&self.log),
            error: self.error.clone(),
            log: self.log.clone(),
        }
    }
}

fn last_line(log: &Path) -> Option<String> {
    let text = std::fs::read(log).ok()?;
    let text = String::from_utf8_lossy(&text);
    let line = text.lines().rfind(|line| !line.trim().is_empty())?;
    Some(line.to_owned())
}

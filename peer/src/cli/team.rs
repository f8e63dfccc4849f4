//! `starling team`.

use std::ffi::OsStr;
use std::path::PathBuf;

use anyhow::Context;
use clap::ArgMatches;

use super::flight::{FlightBar, FlightSummary};
use super::run::client_line;
use super::{Exit, UsageError, output};
use crate::config::{PositionConfig, SIGMA_MAX_M};
use crate::dataset::{DatasetArgument, RecordingOptions};
use crate::team::{
    Ending, Outage, PlannedVehicle, Progress, TeamPlan, TeamReport, VehicleReport, fly,
};

#[derive(clap::Args)]
pub struct TeamArguments {
    /// A recording flown as an anchor; may be repeated.
    #[arg(long, value_name = "DATASET[@A..B]", required = true)]
    pub anchor: Vec<DatasetArgument>,
    /// Position fixes of the anchor before it: TUM (site frame) or CSV (WGS84).
    #[arg(long, value_name = "FILE", required = true)]
    pub fixes: Vec<PathBuf>,
    /// Noise added to each fix, one sigma per axis, 0 to 1000 m; drawn from the seed and the fix's
    /// stamp.
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true,
          value_parser = parse_noise)]
    pub fix_noise_m: f64,
    /// A recording flown as a peer; may be repeated.
    #[arg(long, value_name = "DATASET[@A..B]")]
    pub peer: Vec<DatasetArgument>,
    /// Instead of the calibration that lies beside the images of the anchor or peer before it, or
    /// in its MCAP file; may be repeated.
    #[arg(long, value_name = "FILE")]
    pub calibration: Vec<PathBuf>,
    /// The images of the MCAP file of the anchor or peer before it; may be repeated.
    #[arg(long)]
    pub topic: Vec<String>,
    /// Where trajectories, covariances and maps go.
    #[arg(long)]
    pub out: PathBuf,
    /// Cuts all links, or those of one vehicle, in seconds since the start; may be repeated.
    #[arg(long, value_name = "[VEHICLE:]A..B")]
    pub outage: Vec<Outage>,
    /// Threads per vehicle for decoding and estimation. The estimator uses one: with more, the
    /// next images are decoded meanwhile, and the trajectories are the same. Without an outage
    /// two runs agree bit for bit.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: u16,
    /// Seeds the fix noise and the estimators.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON object. Its `ok` is true if every vehicle flew to the end and nothing was
    /// lost on the way: no image unreadable, no fix skipped, no message dropped. Otherwise the
    /// exit code is 3. A vehicle that does not become Global is no loss; its `state` and `reason`
    /// say so.
    #[arg(long)]
    pub json: bool,
}

pub fn run(arguments: &TeamArguments, order: &ArgMatches) -> anyhow::Result<Exit> {
    let plan = plan(arguments, order)?;
    let mut bar = FlightBar::default();
    let report = fly(&plan, &mut |progress| match progress {
        Progress::Listening { endpoints } => output::diagnose(&client_line(endpoints)),
        Progress::Flying { tick_count, .. } => bar.advance(tick_count),
        Progress::Said { vehicle, line } => bar.say(vehicle, line),
    })?;
    bar.finish();
    let losses = losses(&report);
    for line in report.ending.diagnostics().iter().chain(&losses) {
        output::diagnose(line);
    }
    let exit = match &report.ending {
        Ending::Failed(_) => Exit::Refused,
        Ending::Interrupted => Exit::Interrupted,
        Ending::Flown if !losses.is_empty() => Exit::DoneWithLoss,
        Ending::Flown => Exit::Done,
    };
    let vehicles = report.vehicles.iter();
    let summary = FlightSummary {
        ok: exit == Exit::Done,
        realtime_factor: report.realtime_factor,
        vehicles: vehicles
            .map(|summary| VehicleReport::new(summary, None))
            .collect(),
        swarm: None,
    };
    summary.print(arguments.json)?;
    Ok(exit)
}

/// What was lost on the way, a line each.
fn losses(report: &TeamReport) -> Vec<String> {
    let losses = report.vehicles.iter().filter_map(|summary| {
        let loss = summary.loss()?;
        Some(format!("warning: {}: {loss}", summary.id))
    });
    let stall = "warning: messages over links that were up did not arrive in time; runs may differ";
    losses
        .chain(report.stalled.then(|| stall.to_owned()))
        .collect()
}

fn plan(arguments: &TeamArguments, order: &ArgMatches) -> anyhow::Result<TeamPlan> {
    let fixes = fixes_of_anchors(arguments, order)?;
    let mut recordings = recordings(arguments, order)?.into_iter();
    let mut recording = || recordings.next().unwrap_or_default();
    let anchors = arguments.anchor.iter().zip(&fixes).enumerate();
    let mut vehicles: Vec<PlannedVehicle> = Vec::new();
    vehicles.extend(anchors.map(|(idx, (dataset, fixes))| PlannedVehicle {
        id: format!("anchor{}", idx + 1),
        dataset: dataset.clone(),
        recording: recording(),
        position: Some(PositionConfig {
            file: Some(fixes.clone()),
            noise_m: arguments.fix_noise_m,
            noise_seed: arguments.seed,
            ..PositionConfig::default()
        }),
    }));
    let peers = arguments.peer.iter().enumerate();
    vehicles.extend(peers.map(|(idx, dataset)| PlannedVehicle {
        id: format!("peer{}", idx + 1),
        dataset: dataset.clone(),
        recording: recording(),
        position: None,
    }));
    for outage in &arguments.outage {
        let known = |name: &String| vehicles.iter().any(|vehicle| vehicle.id == *name);
        if let Some(stranger) = outage.vehicle.as_ref().filter(|name| !known(name)) {
            let message = format!("--outage names {stranger:?}, which is not in the team");
            return Err(UsageError(message).into());
        }
    }
    Ok(TeamPlan {
        vehicles,
        outages: arguments.outage.clone(),
        out: arguments.out.clone(),
        threads: usize::from(arguments.threads),
        seed: arguments.seed,
    })
}

fn parse_noise(text: &str) -> Result<f64, String> {
    let noise_m = text.parse().ok();
    noise_m
        .filter(|noise_m| (0.0..=SIGMA_MAX_M).contains(noise_m))
        .ok_or_else(|| format!("expected 0 to {SIGMA_MAX_M} metres"))
}

/// Each `--fixes` belongs to the `--anchor` before it.
fn fixes_of_anchors(arguments: &TeamArguments, order: &ArgMatches) -> anyhow::Result<Vec<PathBuf>> {
    let anchors = positions(order, "anchor");
    let fixes = assign("fixes", &arguments.fixes, &anchors, order)?;
    let complete: Option<Vec<PathBuf>> = fixes.into_iter().collect();
    complete.context(UsageError(
        "each --anchor needs --fixes after it".to_owned(),
    ))
}

/// Each `--calibration` and `--topic` belongs to the `--anchor` or `--peer` before it. Anchors
/// come first.
fn recordings(
    arguments: &TeamArguments,
    order: &ArgMatches,
) -> anyhow::Result<Vec<RecordingOptions>> {
    let vehicles = [positions(order, "anchor"), positions(order, "peer")].concat();
    let calibrations = assign("calibration", &arguments.calibration, &vehicles, order)?;
    let topics = assign("topic", &arguments.topic, &vehicles, order)?;
    let both = calibrations.into_iter().zip(topics);
    Ok(both
        .map(|(calibration, topic)| RecordingOptions {
            calibration,
            topic,
            ..RecordingOptions::default()
        })
        .collect())
}

/// Where on the command line the values of an argument stand.
fn positions(order: &ArgMatches, name: &str) -> Vec<usize> {
    let indices = order.indices_of(name);
    indices.map(Iterator::collect).unwrap_or_default()
}

/// Gives each value to the vehicle that stands nearest before it.
///
/// - `vehicles`: where these stand.
fn assign<Value: Clone + AsRef<OsStr>>(
    name: &str,
    values: &[Value],
    vehicles: &[usize],
    order: &ArgMatches,
) -> Result<Vec<Option<Value>>, UsageError> {
    let mut assigned: Vec<Option<Value>> = vec![None; vehicles.len()];
    for (value, position) in values.iter().zip(positions(order, name)) {
        let before = vehicles.iter().enumerate();
        let before = before.filter(|(_, vehicle)| **vehicle < position);
        let nearest = before.max_by_key(|(_, vehicle)| **vehicle);
        let slot = nearest.map(|(idx, _)| &mut assigned[idx]);
        match slot.filter(|slot| slot.is_none()) {
            Some(slot) => *slot = Some(value.clone()),
            None => {
                let value = value.as_ref().display();
                let vehicle = match name {
                    "fixes" => "--anchor",
                    _ => "--anchor or --peer",
                };
                return Err(UsageError(format!("--{name} {value} follows no {vehicle}")));
            }
        }
    }
    Ok(assigned)
}

#[cfg(test)]
mod tests;

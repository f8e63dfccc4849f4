//! `starling team`.

use std::path::PathBuf;

use anyhow::Context;
use clap::ArgMatches;

use super::flight::{FlightBar, FlightSummary};
use super::run::client_line;
use super::{Exit, UsageError, output};
use crate::config::{PositionConfig, SIGMA_MAX_M};
use crate::dataset::DatasetArgument;
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
    let anchors = arguments.anchor.iter().zip(&fixes).enumerate();
    let anchors = anchors.map(|(idx, (dataset, fixes))| PlannedVehicle {
        id: format!("anchor{}", idx + 1),
        dataset: dataset.clone(),
        position: Some(PositionConfig {
            file: Some(fixes.clone()),
            noise_m: arguments.fix_noise_m,
            noise_seed: arguments.seed,
            ..PositionConfig::default()
        }),
    });
    let peers = arguments.peer.iter().enumerate();
    let peers = peers.map(|(idx, dataset)| PlannedVehicle {
        id: format!("peer{}", idx + 1),
        dataset: dataset.clone(),
        position: None,
    });
    let vehicles: Vec<PlannedVehicle> = anchors.chain(peers).collect();
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
    let positions = |name: &str| -> Vec<usize> {
        order
            .indices_of(name)
            .map(Iterator::collect)
            .unwrap_or_default()
    };
    let (anchors, files) = (positions("anchor"), positions("fixes"));
    let mut fixes: Vec<Option<PathBuf>> = vec![None; anchors.len()];
    for (file, position) in arguments.fixes.iter().zip(files) {
        let anchor_idx = anchors.iter().rposition(|anchor| *anchor < position);
        let slot = anchor_idx
            .map(|idx| &mut fixes[idx])
            .filter(|slot| slot.is_none());
        match slot {
            Some(slot) => *slot = Some(file.clone()),
            None => {
                let message = format!("--fixes {} follows no --anchor", file.display());
                return Err(UsageError(message).into());
            }
        }
    }
    let complete: Option<Vec<PathBuf>> = fixes.into_iter().collect();
    complete.context(UsageError(
        "each --anchor needs --fixes after it".to_owned(),
    ))
}

//! `starling demo`.

use std::path::PathBuf;

use serde::Serialize;
use sim::{Cut, ScenarioName};

use super::run::client_line;
use super::{Exit, output};
use crate::demo::{DemoPlan, DemoReport, Progress, fly};
use crate::team::{Ending, VehicleReport, table};

#[derive(clap::Args)]
pub struct DemoArguments {
    /// The world to fly in.
    #[arg(long, default_value = "lab", value_parser = ["lab"])]
    pub scenario: String,
    /// Do not serve the live page, which is not built yet.
    #[arg(long)]
    pub headless: bool,
    /// Seeds the world, its noise and its outages.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Where trajectories, maps, the recordings and the plot go.
    #[arg(long, default_value = "starling-demo")]
    pub out: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct DemoJson {
    /// Every vehicle has flown to the end and is global, and nothing was lost: the exit code is 0.
    ok: bool,
    realtime_factor: Option<f64>,
    vehicles: Vec<VehicleReport>,
}

pub fn run(arguments: &DemoArguments) -> anyhow::Result<Exit> {
    let plan = DemoPlan {
        scenario: ScenarioName::Lab,
        seed: arguments.seed,
        out: arguments.out.clone(),
    };
    let mut bar: Option<output::Progress> = None;
    let report = fly(&plan, &mut |progress| match progress {
        Progress::Listening { endpoints } => output::diagnose(&client_line(endpoints)),
        Progress::Flying { frame_count, .. } => bar
            .get_or_insert_with(|| output::Progress::start("flying", frame_count as u64))
            .advance(1),
        Progress::LinkCut { vehicle, cut } => {
            output::diagnose(&format!("{vehicle}: a link {}", describe(cut)));
        }
        Progress::LinkHealed { vehicle } => {
            output::diagnose(&format!("{vehicle}: a link is healed"));
        }
        Progress::Said { vehicle, line } => {
            if let Some(bar) = bar.take() {
                bar.finish();
            }
            output::diagnose(&format!("{vehicle}: {line}"));
        }
    })?;
    if let Some(bar) = bar {
        bar.finish();
    }
    let losses = report.losses.iter();
    let losses = losses.map(|loss| format!("warning: {loss}"));
    for line in report.ending.diagnostics().into_iter().chain(losses) {
        output::diagnose(&line);
    }
    let is_global = |vehicle: &VehicleReport| vehicle.state == "Global";
    let exit = match report.ending {
        Ending::Interrupted => Exit::Interrupted,
        Ending::Failed(_) => Exit::Refused,
        Ending::Flown if !report.vehicles.iter().all(is_global) => Exit::Refused,
        Ending::Flown if !report.losses.is_empty() => Exit::DoneWithLoss,
        Ending::Flown => Exit::Done,
    };
    print(report, exit == Exit::Done, arguments)?;
    Ok(exit)
}

fn print(report: DemoReport, ok: bool, arguments: &DemoArguments) -> anyhow::Result<()> {
    if arguments.json {
        return output::print_json(&DemoJson {
            ok,
            realtime_factor: report.realtime_factor,
            vehicles: report.vehicles,
        });
    }
    for line in table(&report.vehicles) {
        output::print_line(&line);
    }
    if let Some(realtime_factor) = report.realtime_factor {
        output::print_line(&format!("{realtime_factor:.2} times real time"));
    }
    if let Some(plot) = report.plot {
        output::print_line(&format!("the picture: {}", plot.display()));
    }
    Ok(())
}

fn describe(cut: Cut) -> &'static str {
    match cut {
        Cut::Reset => "breaks",
        Cut::Blackhole | Cut::BlackholeToServer | Cut::BlackholeToClient => "falls silent",
    }
}

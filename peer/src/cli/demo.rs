//! `starling demo`.

use std::path::PathBuf;

use sim::{Cut, ScenarioName};

use super::flight::{FlightBar, FlightSummary};
use super::run::client_line;
use super::{Exit, output};
use crate::demo::{DemoPlan, Progress, fly};
use crate::team::{Ending, VehicleReport};

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

pub fn run(arguments: &DemoArguments) -> anyhow::Result<Exit> {
    let plan = DemoPlan {
        scenario: ScenarioName::Lab,
        seed: arguments.seed,
        out: arguments.out.clone(),
    };
    let mut bar = FlightBar::default();
    let report = fly(&plan, &mut |progress| match progress {
        Progress::Listening { endpoints } => output::diagnose(&client_line(endpoints)),
        Progress::Flying { frame_count, .. } => bar.advance(frame_count),
        Progress::LinkCut { vehicle, cut } => {
            output::diagnose(&format!("{vehicle}: a link {}", describe(cut)));
        }
        Progress::LinkHealed { vehicle } => {
            output::diagnose(&format!("{vehicle}: a link is healed"));
        }
        Progress::Said { vehicle, line } => bar.say(vehicle, line),
    })?;
    bar.finish();
    let losses = report.losses.iter();
    let losses = losses.map(|loss| format!("warning: {loss}"));
    for line in report.ending.diagnostics().into_iter().chain(losses) {
        output::diagnose(&line);
    }
    // The demo is there to show that everybody becomes global, and that drones hold together.
    let is_global = |vehicle: &VehicleReport| vehicle.state == "Global";
    let holds = report.swarm.is_none_or(|swarm| swarm.holds());
    let is_shown = holds && report.vehicles.iter().all(is_global);
    let exit = match report.ending {
        Ending::Interrupted => Exit::Interrupted,
        Ending::Failed(_) => Exit::Refused,
        Ending::Flown if !is_shown => Exit::Refused,
        Ending::Flown if !report.losses.is_empty() => Exit::DoneWithLoss,
        Ending::Flown => Exit::Done,
    };
    let summary = FlightSummary {
        ok: exit == Exit::Done,
        realtime_factor: report.realtime_factor,
        vehicles: report.vehicles,
        swarm: report.swarm,
    };
    summary.print(arguments.json)?;
    if let Some(plot) = report.plot.filter(|_| !arguments.json) {
        output::print_line(&format!("the picture: {}", plot.display()));
    }
    Ok(exit)
}

fn describe(cut: Cut) -> &'static str {
    match cut {
        Cut::Reset => "breaks",
        Cut::Blackhole | Cut::BlackholeToServer | Cut::BlackholeToClient => "falls silent",
    }
}

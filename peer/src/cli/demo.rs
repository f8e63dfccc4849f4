//! `starling demo`.

use std::path::PathBuf;

use serde::Serialize;
use sim::{Cut, ScenarioName};

use super::run::client_line;
use super::{Exit, output};
use crate::demo::{DemoPlan, DemoReport, Progress, fly};
use crate::team::{VehicleReport, table};

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
    /// Every vehicle has flown to the end and is global.
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
    })?;
    if let Some(bar) = bar {
        bar.finish();
    }
    let ok = report
        .vehicles
        .iter()
        .all(|vehicle| vehicle.state == "Global");
    print(report, ok, arguments)?;
    Ok(if ok { Exit::Done } else { Exit::Refused })
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
    output::print_line(&format!("the picture: {}", report.plot.display()));
    Ok(())
}

fn describe(cut: Cut) -> &'static str {
    match cut {
        Cut::Reset => "breaks",
        Cut::Blackhole | Cut::BlackholeToServer | Cut::BlackholeToClient => "falls silent",
    }
}

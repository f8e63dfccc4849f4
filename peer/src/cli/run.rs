//! `starling run`.

use std::path::PathBuf;

use clap::ValueEnum;

use super::{Exit, output};
use crate::config::VehicleConfig;
use crate::process::control::Report;
use crate::process::{Supervision, VehicleSummary, fly};

#[derive(clap::Args)]
pub struct RunArguments {
    /// The vehicle's configuration, see `deploy/`.
    #[arg(long)]
    pub config: PathBuf,
    /// For a parent process: orders on stdin, reports on stdout.
    #[arg(long, hide = true)]
    pub supervised: Option<Supervisor>,
}

/// What a parent wants to decide.
#[derive(Clone, Copy, ValueEnum)]
pub enum Supervisor {
    /// Nothing; it reads reports, and its end is the vehicle's end.
    Watch,
    /// When time passes.
    Pace,
}

pub fn run(arguments: &RunArguments) -> anyhow::Result<Exit> {
    let config = VehicleConfig::load(&arguments.config)?;
    let supervision = match arguments.supervised {
        None => Supervision::None,
        Some(Supervisor::Watch) => Supervision::Watched,
        Some(Supervisor::Pace) => Supervision::Paced,
    };
    let supervised = supervision != Supervision::None;
    let summary = fly(&config, supervision, &mut |report| match report {
        report if supervised => print_report(report),
        Report::Listening { endpoints, .. } => output::diagnose(&client_line(endpoints)),
        _ => {}
    });
    let summary = summary.inspect_err(|error| {
        if supervised {
            let error = format!("{error:#}");
            print_report(&Report::Failed { error });
        }
    })?;
    if !supervised {
        output::print_line(&format!(
            "{}: {} ({}), global in {} of {} frames",
            summary.id,
            summary.state,
            summary.reason,
            summary.global_frame_count,
            summary.frame_count
        ));
    }
    if supervised {
        // The parent knows the summary, and decides.
        return Ok(Exit::Done);
    }
    Ok(exit_of(&summary))
}

fn exit_of(summary: &VehicleSummary) -> Exit {
    let Some(loss) = summary.loss() else {
        return Exit::Done;
    };
    output::diagnose(&format!("warning: {}: {loss}", summary.id));
    if summary.frame_count == 0 && summary.input_error.is_some() {
        Exit::Refused
    } else {
        Exit::DoneWithLoss
    }
}

fn print_report(report: &Report) {
    let line = serde_json::to_string(report).expect("reports have no maps with odd keys");
    output::print_line(&line);
}

/// The line that a Python client needs to look on.
pub fn client_line(endpoints: &[String]) -> String {
    let loopback = endpoints.iter().find(|one| one.contains("127.0.0.1"));
    let endpoint = loopback.or(endpoints.first()).map_or("", String::as_str);
    format!(
        "python client: zenoh.open(zenoh.Config.from_json5('{{mode: \"client\", connect: \
         {{endpoints: [\"{endpoint}\"]}}}}'))"
    )
}

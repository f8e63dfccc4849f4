//! `starling sim`, hidden: the process that renders the world of `demo` and knows the truth, and
//! below it `record`, which renders recordings to measure by.

mod record;

use std::io::Read;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde::Serialize;
use sim::{Pace, ScenarioName, ServeEvent, ServeReport, ServeSettings, serve};

use super::{Exit, output};
use crate::process::interrupt;

#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct SimArguments {
    #[command(subcommand)]
    command: Option<SimCommand>,
    #[arg(long, default_value = "lab", value_parser = ["lab"])]
    pub scenario: String,
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// End early.
    #[arg(long)]
    pub frame_count_max: Option<usize>,
    /// As fast as the vehicles acknowledge, not at most in real time.
    #[arg(long)]
    pub unlimited: bool,
}

#[derive(clap::Subcommand)]
enum SimCommand {
    /// Render a recording as a folder in TUM RGB-D layout, with the truth.
    Record(record::RecordArguments),
}

/// The last line, with the truth in it; the ones before are the simulator's events.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Last {
    Finished { report: ServeReport },
}

/// Longer than the simulator waits for a vehicle.
const LAST_FRAME_PATIENCE: Duration = Duration::from_secs(35);

/// Whether there is a route that could be ended in order.
static STARTED: AtomicBool = AtomicBool::new(false);

pub fn run(arguments: &SimArguments) -> anyhow::Result<Exit> {
    match &arguments.command {
        Some(SimCommand::Record(arguments)) => record::run(arguments),
        None => fly(arguments),
    }
}

/// One JSON object a line on stdout. The end of stdin ends the route, so that it never outlives
/// its parent.
fn fly(arguments: &SimArguments) -> anyhow::Result<Exit> {
    interrupt::leave_to_parent();
    std::thread::spawn(|| {
        // An error ends it as well as the end of the file.
        let _ = std::io::stdin().lock().read_to_end(&mut Vec::new());
        interrupt::wish();
        if STARTED.load(Ordering::Relaxed) {
            std::thread::sleep(LAST_FRAME_PATIENCE);
        }
        std::process::exit(1);
    });
    let settings = ServeSettings {
        scenario: ScenarioName::Lab,
        seed: arguments.seed,
        pace: if arguments.unlimited {
            Pace::Unlimited
        } else {
            Pace::RealTime
        },
        frame_count_max: arguments.frame_count_max,
        end_wished: Some(interrupt::flag()),
        ..ServeSettings::default()
    };
    let report = serve(&settings, &mut |event| {
        if matches!(event, ServeEvent::Started) {
            STARTED.store(true, Ordering::Relaxed);
        }
        print_json_line(event);
    })?;
    print_json_line(&Last::Finished { report });
    Ok(Exit::Done)
}

fn print_json_line(value: &impl Serialize) {
    let line = serde_json::to_string(value).expect("events have no maps with odd keys");
    output::print_line(&line);
}

//! `starling sim`, hidden: the process that renders the world of `demo` and knows the truth.

use std::io::Read;
use std::path::PathBuf;

use serde::Serialize;
use sim::{Pace, ScenarioName, ServeReport, ServeSettings, serve};

use super::{Exit, output};

#[derive(clap::Args)]
pub struct SimArguments {
    #[arg(long, default_value = "lab", value_parser = ["lab"])]
    pub scenario: String,
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Where the truth is written; only the parent reads it, after all vehicles have ended.
    #[arg(long)]
    pub truth: PathBuf,
    /// End early.
    #[arg(long)]
    pub frame_count_max: Option<usize>,
    /// As fast as the vehicles acknowledge, not at most in real time.
    #[arg(long)]
    pub unlimited: bool,
}

/// The last line; the ones before are the simulator's events.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Last {
    Finished { report: ServeReport },
}

/// One JSON object a line on stdout; ends when stdin does, so that it never outlives its parent.
pub fn run(arguments: &SimArguments) -> anyhow::Result<Exit> {
    std::thread::spawn(|| {
        // An error ends it as well as the end of the file.
        let _ = std::io::stdin().lock().read_to_end(&mut Vec::new());
        std::process::exit(1);
    });
    let settings = ServeSettings {
        scenario: ScenarioName::Lab,
        seed: arguments.seed,
        truth_folder: Some(arguments.truth.clone()),
        pace: if arguments.unlimited {
            Pace::Unlimited
        } else {
            Pace::RealTime
        },
        frame_count_max: arguments.frame_count_max,
        ..ServeSettings::default()
    };
    let report = serve(&settings, &mut |event| print_json_line(event))?;
    print_json_line(&Last::Finished { report });
    Ok(Exit::Done)
}

fn print_json_line(value: &impl Serialize) {
    let line = serde_json::to_string(value).expect("events have no maps with odd keys");
    output::print_line(&line);
}

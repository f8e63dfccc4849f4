//! The command line: what each command takes, and which exit code it ends with.

mod demo;
mod flight;
mod later;
mod map;
mod markers;
pub mod output;
mod register;
mod run;
mod sim;
mod slam;
mod swarm;
mod team;

use std::process::ExitCode;

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::files::Clash;

/// How a command ended, when it did not end with an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Exit code 0.
    Done,
    /// Exit code 1: the result on stdout says why, for example a refused registration.
    Refused,
    /// Exit code 3: something was lost on the way, and the diagnostics name it.
    DoneWithLoss,
    /// Exit code 130, as shells have it for Ctrl-C: ended in order before the work was done.
    Interrupted,
}

/// Arguments that parse one by one but make no sense together; exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

impl UsageError {
    fn because(error: impl std::error::Error) -> Self {
        Self(error.to_string())
    }
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done with loss, \
    130 demo or team interrupted (run ends with 0 or 3). An interrupt, a termination or a hang-up \
    ends demo, team and run in order, with all files written; one more ends them at once.";

/// A global pose for every vehicle of a team, when only some of them can see the sky.
#[derive(Parser)]
#[command(name = "starling", version, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fly a rendered lab: a localised ground vehicle and two drones that are not.
    Demo(demo::DemoArguments),
    /// Run one vehicle's process.
    Run(run::RunArguments),
    /// Monocular vSLAM over a recording.
    Slam(slam::SlamArguments),
    /// Fly recordings as a team over zenoh.
    Team(team::TeamArguments),
    /// Register one point cloud to another.
    Register(register::RegisterArguments),
    /// Ask the network for maps.
    #[command(subcommand)]
    Map(map::MapCommand),
    /// Swarm-keeping by sight, simulated many times over.
    Swarm(swarm::SwarmArguments),
    /// Find the pairs of marker lights in images.
    Markers(markers::MarkersArguments),
    /// The simulator's process, started by `demo`.
    #[command(hide = true)]
    Sim(sim::SimArguments),
    #[command(flatten)]
    Later(later::LaterCommand),
}

/// Parses the process's arguments, runs the command, and reports errors on stderr.
pub fn main() -> ExitCode {
    let matches = Cli::command().get_matches();
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    output::start_log();
    match dispatch(cli.command, &matches) {
        Ok(Exit::Done) => ExitCode::SUCCESS,
        Ok(Exit::Refused) => ExitCode::from(1),
        Ok(Exit::DoneWithLoss) => ExitCode::from(3),
        Ok(Exit::Interrupted) => ExitCode::from(130),
        Err(error) => {
            output::diagnose(&format!("error: {error:#}"));
            ExitCode::from(if is_wrong_usage(&error) { 2 } else { 1 })
        }
    }
}

fn is_wrong_usage(error: &anyhow::Error) -> bool {
    error.is::<UsageError>() || error.is::<Clash>()
}

fn dispatch(command: Command, matches: &ArgMatches) -> anyhow::Result<Exit> {
    match command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Slam(arguments) => slam::run(&arguments),
        Command::Team(arguments) => {
            let order = matches
                .subcommand_matches("team")
                .expect("clap matched the team command");
            team::run(&arguments, order)
        }
        Command::Register(arguments) => register::run(&arguments),
        Command::Map(command) => map::run(&command),
        Command::Swarm(arguments) => swarm::run(&arguments),
        Command::Markers(arguments) => markers::run(&arguments),
        Command::Sim(arguments) => sim::run(&arguments),
        Command::Later(command) => later::run(&command),
    }
}

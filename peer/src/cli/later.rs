//! Commands that are named in the contract and not built yet: each says so and exits 1.

use std::ffi::OsString;

use clap::Subcommand;

use super::Exit;

#[derive(Subcommand)]
pub enum LaterCommand {
    /// Look at a recording as a vehicle would (not built yet).
    Replay(Anything),
    /// Summarise a recording (not built yet).
    Inspect(Anything),
    /// Convert a recording (not built yet).
    Export(Anything),
    /// Align a trajectory to position fixes (not built yet).
    Georeference(Anything),
    /// Make keys for a team (not built yet).
    Keys(Anything),
    /// Calibrate a camera (not built yet).
    Calibrate(Anything),
    /// Check a configuration (not built yet).
    Config(Anything),
    /// Find out what is wrong (not built yet).
    Doctor(Anything),
    /// Repeat the paper's experiments (not built yet).
    Reproduce(Anything),
}

/// Whatever follows; it is not looked at.
#[derive(clap::Args)]
pub struct Anything {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    pub arguments: Vec<OsString>,
}

pub fn run(command: &LaterCommand) -> anyhow::Result<Exit> {
    let name = match command {
        LaterCommand::Replay(_) => "replay",
        LaterCommand::Inspect(_) => "inspect",
        LaterCommand::Export(_) => "export",
        LaterCommand::Georeference(_) => "georeference",
        LaterCommand::Keys(_) => "keys",
        LaterCommand::Calibrate(_) => "calibrate",
        LaterCommand::Config(_) => "config check",
        LaterCommand::Doctor(_) => "doctor",
        LaterCommand::Reproduce(_) => "reproduce",
    };
    not_built(name)
}

/// What a command answers until it is built.
pub fn not_built(name: &str) -> anyhow::Result<Exit> {
    anyhow::bail!("`starling {name}` is not built yet")
}

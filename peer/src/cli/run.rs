//! `starling run`.

use std::path::PathBuf;

use super::Exit;

#[derive(clap::Args)]
pub struct RunArguments {
    /// The vehicle's configuration, see `deploy/`.
    #[arg(long)]
    pub config: PathBuf,
}

pub fn run(_arguments: &RunArguments) -> anyhow::Result<Exit> {
    super::later::not_built("run")
}

//! `starling demo`.

use std::path::PathBuf;

use super::Exit;

#[derive(clap::Args)]
pub struct DemoArguments {
    /// The world to fly in.
    #[arg(long, default_value = "lab", value_parser = ["lab"])]
    pub scenario: String,
    /// Do not serve the live page.
    #[arg(long)]
    pub headless: bool,
    /// Seeds the world, its noise and its outages.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Where trajectories, maps, the recording and the plot go.
    #[arg(long, default_value = "starling-demo")]
    pub out: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

pub fn run(_arguments: &DemoArguments) -> anyhow::Result<Exit> {
    super::later::not_built("demo")
}

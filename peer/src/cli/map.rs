//! `starling map`.

use std::path::PathBuf;

use clap::Subcommand;

use super::Exit;

#[derive(Subcommand)]
pub enum MapCommand {
    /// Ask the network for maps and export them.
    Get(GetArguments),
}

#[derive(clap::Args)]
pub struct GetArguments {
    /// A key expression: 'anchor/*/map' lists maps, 'anchor/*/map/*/*' brings chunks.
    pub selector: String,
    /// Where to ask; may be repeated.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
    pub connect: Vec<String>,
    /// Export the points; the extension chooses the format.
    #[arg(long, value_name = "FILE.ply|pcd|las|geojson|mcap")]
    pub out: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

pub fn run(command: &MapCommand) -> anyhow::Result<Exit> {
    let MapCommand::Get(_arguments) = command;
    super::later::not_built("map get")
}

//! `starling slam`.

use std::path::PathBuf;

use super::Exit;

#[derive(clap::Args)]
pub struct SlamArguments {
    /// A recording in TUM RGB-D layout, with `camera.yaml` beside it.
    pub dataset: String,
    /// The trajectory after all corrections.
    #[arg(long)]
    pub out: PathBuf,
    /// The map's points.
    #[arg(long)]
    pub map: Option<PathBuf>,
    /// Half-open range of frame numbers.
    #[arg(long, value_name = "A..B")]
    pub frames: Option<String>,
    /// Pace by the stamps and drop late frames.
    #[arg(long)]
    pub realtime: bool,
    /// With one thread the result is deterministic.
    #[arg(long, default_value_t = 1)]
    pub threads: usize,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

pub fn run(_arguments: &SlamArguments) -> anyhow::Result<Exit> {
    super::later::not_built("slam")
}

//! `starling team`.

use std::path::PathBuf;

use clap::ArgMatches;

use super::Exit;

#[derive(clap::Args)]
pub struct TeamArguments {
    /// A recording flown as an anchor; may be repeated.
    #[arg(long, value_name = "DATASET[@A..B]", required = true)]
    pub anchor: Vec<String>,
    /// Position fixes of the anchor before it: TUM (site frame) or CSV (WGS84).
    #[arg(long, value_name = "FILE", required = true)]
    pub fixes: Vec<PathBuf>,
    /// Noise added to each fix, one sigma per axis, drawn from the seed and the fix's stamp.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    pub fix_noise_m: f64,
    /// A recording flown as a peer; may be repeated.
    #[arg(long, value_name = "DATASET[@A..B]")]
    pub peer: Vec<String>,
    /// Where trajectories, covariances and maps go.
    #[arg(long)]
    pub out: PathBuf,
    /// Cuts all links, or those of one vehicle, in seconds since the start; may be repeated.
    #[arg(long, value_name = "[VEHICLE:]A..B")]
    pub outage: Vec<String>,
    /// Threads per vehicle; with one and without an outage two runs agree bit for bit.
    #[arg(long, default_value_t = 1)]
    pub threads: usize,
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

pub fn run(_arguments: &TeamArguments, _order: &ArgMatches) -> anyhow::Result<Exit> {
    super::later::not_built("team")
}

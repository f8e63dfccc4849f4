//! `starling register`.

use std::path::PathBuf;

use super::Exit;

#[derive(clap::Args)]
pub struct RegisterArguments {
    /// The cloud that is moved: PLY, PCD, XYZ or CSV.
    pub source: PathBuf,
    /// The cloud that it is moved onto.
    pub target: PathBuf,
    #[arg(long, default_value = "gicp", value_parser = ["point", "plane", "gicp"])]
    pub metric: String,
    /// Estimate the scale too.
    #[arg(long)]
    pub with_scale: bool,
    /// Where to start: `identity`, `search`, or a file with a 4×4 matrix.
    #[arg(long, default_value = "identity", value_name = "identity|FILE|search")]
    pub init: String,
    /// Thin both clouds to one point per cube of this edge.
    #[arg(long, value_name = "M")]
    pub voxel: Option<f64>,
    #[arg(long, value_name = "M")]
    pub max_distance: Option<f64>,
    #[arg(long, default_value_t = 1)]
    pub threads: usize,
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

pub fn run(_arguments: &RegisterArguments) -> anyhow::Result<Exit> {
    super::later::not_built("register")
}

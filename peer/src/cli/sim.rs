//! `starling sim`, hidden: the process that renders the world of `demo` and knows the truth.

use std::path::PathBuf;

use super::Exit;

#[derive(clap::Args)]
pub struct SimArguments {
    #[arg(long, default_value = "lab")]
    pub scenario: String,
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Where the truth is written; only the parent reads it, after all vehicles have ended.
    #[arg(long)]
    pub truth: PathBuf,
}

pub fn run(_arguments: &SimArguments) -> anyhow::Result<Exit> {
    super::later::not_built("sim")
}

//! Registration beside the Python package `small_gicp`, in one run.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};

use crate::check::workspace_root;
use crate::python;

#[derive(clap::Args)]
pub struct Arguments {
    /// Compare the release build.
    #[arg(long)]
    release: bool,
    /// A binary that is there already.
    #[arg(long, value_name = "FILE")]
    binary: Option<PathBuf>,
    /// How often each side aligns; the figures are medians.
    #[arg(long, default_value_t = 21)]
    turns: u32,
}

const PROGRAM: &str = include_str!("compare_icp.py");

pub fn run(arguments: &Arguments) -> Result<()> {
    let data =
        env::var_os("STARLING_DATA").context("STARLING_DATA names no folder of recordings")?;
    let folder = Path::new(&data).join("cloud/lidar_pair");
    ensure!(folder.is_dir(), "no such folder: {}", folder.display());
    let interpreter = python::install_peers().context("the other package is not there")?;
    let binary = match &arguments.binary {
        Some(binary) => binary.clone(),
        None => build(arguments.release)?,
    };
    let status = Command::new(interpreter)
        .args(["-c", PROGRAM])
        .arg(binary)
        .arg(folder)
        .arg(arguments.turns.to_string())
        .status()
        .context("cannot start Python")?;
    if !status.success() {
        bail!("the comparison failed");
    }
    Ok(())
}

/// The binary `starling`, built where cargo puts it.
fn build(release: bool) -> Result<PathBuf> {
    let status = Command::new(env!("CARGO"))
        .args(["build", "--quiet", "--package", "peer", "--bin", "starling"])
        .args(release.then_some("--release"))
        .current_dir(workspace_root())
        .status()
        .context("cannot start cargo")?;
    ensure!(status.success(), "starling does not build");
    let target = env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| workspace_root().join("target"), PathBuf::from);
    let profile = if release { "release" } else { "debug" };
    Ok(target.join(profile).join("starling"))
}

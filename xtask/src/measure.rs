//! The measuring of vSLAM and registration, a program of its own: it links what is measured.

use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::check::workspace_root;

#[derive(clap::Args)]
pub struct Arguments {
    /// Measure the release build.
    #[arg(long)]
    release: bool,
    /// Passed on; `-- --help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<String>,
}

/// Builds the program that measures and the command line that it starts, and runs it.
pub fn run(what: &str, arguments: &Arguments) -> Result<()> {
    let profile = arguments.release.then_some("--release");
    let build = ["build", "--quiet", "--package", "tests", "--bins"];
    cargo(build.into_iter().chain(profile))?;
    let measure = ["run", "--quiet", "--package", "tests", "--bin", "measure"];
    let measured = measure.into_iter().chain(profile).chain(["--", what]);
    cargo(measured.chain(arguments.rest.iter().map(String::as_str)))
}

fn cargo<'a>(arguments: impl Iterator<Item = &'a str>) -> Result<()> {
    let arguments: Vec<&str> = arguments.collect();
    let status = Command::new(env!("CARGO"))
        .args(&arguments)
        .current_dir(workspace_root())
        .status()
        .context("cannot start cargo")?;
    if !status.success() {
        bail!("failed: cargo {}", arguments.join(" "));
    }
    Ok(())
}

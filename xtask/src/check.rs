//! Everything that a change must pass, in the order in which it fails fastest.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{python, tidy};

/// Private items are documented too, so links to them lead somewhere.
const DOC_FLAGS: &str = "-D warnings -A rustdoc::private-intra-doc-links";

/// Runs every step; stops at the first that fails.
pub fn run() -> Result<()> {
    cargo("format", &["fmt", "--all", "--check"], None)?;
    step("tidy");
    tidy::run()?;
    let clippy = [
        "clippy",
        "--workspace",
        "--all-targets",
        "--",
        "-D",
        "warnings",
    ];
    cargo("clippy", &clippy, None)?;
    let docs = [
        "doc",
        "--workspace",
        "--no-deps",
        "--document-private-items",
    ];
    cargo("docs", &docs, Some(("RUSTDOCFLAGS", DOC_FLAGS.into())))?;
    step("python client");
    let interpreter = python::install();
    let environment = interpreter.map(|path| ("STARLING_PYTHON", path.into_os_string()));
    cargo("tests", &["test", "--workspace"], environment)
}

fn step(name: &str) {
    eprintln!("== {name}");
}

fn cargo(
    name: &str,
    arguments: &[&str],
    environment: Option<(&str, std::ffi::OsString)>,
) -> Result<()> {
    step(name);
    let status = Command::new(env!("CARGO"))
        .args(arguments)
        .envs(environment)
        .current_dir(workspace_root())
        .status()
        .with_context(|| format!("cannot start cargo for the step {name}"))?;
    if !status.success() {
        bail!("{name} failed: cargo {}", arguments.join(" "));
    }
    Ok(())
}

/// The folder of the root manifest.
pub fn workspace_root() -> PathBuf {
    let manifest_dir = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    manifest_dir
        .parent()
        .expect("xtask lies one folder below the root")
        .to_owned()
}

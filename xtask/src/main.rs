//! The project's own chores: `cargo xtask --help`.

mod check;
mod python;
mod tidy;

use anyhow::Result;
use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(about = "The project's own chores")]
struct Arguments {
    #[command(subcommand)]
    chore: Chore,
}

#[derive(Subcommand)]
enum Chore {
    /// Format, clippy with warnings denied, tidy, docs, and last the tests.
    Check,
    /// The rules that neither the compiler nor clippy knows.
    Tidy,
}

fn main() -> Result<()> {
    match Arguments::parse().chore {
        Chore::Check => check::run(),
        Chore::Tidy => tidy::run(),
    }
}

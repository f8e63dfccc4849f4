//! The project's own chores: `cargo xtask --help`.

mod check;
mod compare_icp;
mod measure;
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
    /// Run every recording of $STARLING_DATA/video and rendered worlds: RMSE, share of frames,
    /// drift, time and memory as a table.
    Accuracy(measure::Arguments),
    /// Align two scans of $STARLING_DATA beside the Python package small_gicp: errors, times, and
    /// the ratio of the times.
    CompareIcp(compare_icp::Arguments),
    /// Track many short rendered recordings under random conditions: no panic, and no wrong pose
    /// called good.
    Robustness(measure::Arguments),
    /// Find disturbed maps in each other from nothing: how often right, how often wrong.
    Registration(measure::Arguments),
}

fn main() -> Result<()> {
    match Arguments::parse().chore {
        Chore::Check => check::run(),
        Chore::Tidy => tidy::run(),
        Chore::Accuracy(arguments) => measure::run("accuracy", &arguments),
        Chore::CompareIcp(arguments) => compare_icp::run(&arguments),
        Chore::Robustness(arguments) => measure::run("robustness", &arguments),
        Chore::Registration(arguments) => measure::run("registration", &arguments),
    }
}

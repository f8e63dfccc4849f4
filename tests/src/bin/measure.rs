//! `cargo xtask accuracy`, `robustness` and `registration`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use tests::measure::Verdict;
use tests::measure::accuracy::{AccuracySettings, measure, place_table};
use tests::measure::registration::{self, RegistrationSettings};
use tests::measure::robustness::{Trial, draw, run_guarded};

#[derive(Parser)]
#[command(
    name = "cargo xtask",
    about = "How good vSLAM and registration are, as numbers"
)]
struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    Accuracy(AccuracyArguments),
    Robustness(RobustnessArguments),
    Registration(RegistrationArguments),
}

#[derive(clap::Args)]
struct AccuracyArguments {
    /// Runs of each recording at its own speed; the table has the median.
    #[arg(long, default_value_t = 5)]
    runs: usize,
    /// Seeds of each rendered world.
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// Only rows whose name has this in it; may be given again.
    #[arg(long)]
    only: Vec<String>,
    /// Where accuracy.json, trajectories and rendered recordings go.
    #[arg(long, default_value = "target/accuracy")]
    out: PathBuf,
    /// The program; by default the one built with this.
    #[arg(long)]
    starling: Option<PathBuf>,
    /// No recording at its own speed: for busy machines, on which frames would be late.
    #[arg(long)]
    unpaced: bool,
    /// Put the table into its place in BENCHMARKS.md.
    #[arg(long)]
    write: bool,
}

#[derive(clap::Args)]
struct RobustnessArguments {
    #[arg(long, default_value_t = 200)]
    runs: u64,
    /// Of the campaign; it chooses everything.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only this run of the campaign.
    #[arg(long)]
    run: Option<u64>,
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

#[derive(clap::Args)]
struct RegistrationArguments {
    /// Seeds of each row; by default 50 of generated correspondences and 100 of maps.
    #[arg(long)]
    seeds: Option<u64>,
    /// Only these seeds of the maps of two vehicles, separated by commas.
    #[arg(long, value_delimiter = ',')]
    vehicle_seeds: Vec<u64>,
    /// Keep those maps in this folder, and use those that are there: they do not depend on
    /// registration.
    #[arg(long)]
    maps: Option<PathBuf>,
    /// Say what came of each pair of those maps.
    #[arg(long)]
    verbose: bool,
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Only rows whose name has this in it; may be given again.
    #[arg(long)]
    only: Vec<String>,
}

fn main() -> Result<ExitCode> {
    match Arguments::parse().what {
        What::Accuracy(arguments) => accuracy(arguments),
        What::Robustness(arguments) => robustness(&arguments),
        What::Registration(arguments) => register(arguments),
    }
}

fn say(line: &str) {
    // A reader who has gone is no error.
    let _ = writeln!(std::io::stdout().lock(), "{line}");
}

fn accuracy(arguments: AccuracyArguments) -> Result<ExitCode> {
    let beside = std::env::current_exe()?.with_file_name("starling-tested");
    let video = std::env::var_os("STARLING_DATA").map(|data| Path::new(&data).join("video"));
    let settings = AccuracySettings {
        starling: arguments.starling.unwrap_or(beside),
        video: video.filter(|folder| folder.is_dir()),
        run_count: arguments.runs.max(1),
        seed_count: arguments.seeds.max(1),
        only: arguments.only,
        unpaced: arguments.unpaced,
        out: arguments.out,
    };
    let table = measure(&settings, say)?;
    if arguments.write {
        let path = Path::new("BENCHMARKS.md");
        place_table(path, &table).context("the table is printed above, but not written")?;
    }
    Ok(ExitCode::SUCCESS)
}

fn register(arguments: RegistrationArguments) -> Result<ExitCode> {
    let data = std::env::var_os("STARLING_DATA").map(PathBuf::from);
    let settings = RegistrationSettings {
        correspondence_seed_count: arguments.seeds.unwrap_or(50),
        map_seed_count: arguments.seeds.unwrap_or(100),
        vehicle_seeds: if arguments.vehicle_seeds.is_empty() {
            (1..=arguments.seeds.unwrap_or(100)).collect()
        } else {
            arguments.vehicle_seeds
        },
        thread_count: arguments.threads,
        maps: arguments.maps,
        verbose: arguments.verbose,
        only: arguments.only,
    };
    let is_clean = registration::measure(&settings, data.as_deref(), say)?;
    Ok(if is_clean {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Runs are independent, so they come in any order and are the same on any number of threads.
fn robustness(arguments: &RobustnessArguments) -> Result<ExitCode> {
    let run_idxs: Vec<u64> = match arguments.run {
        Some(run_idx) => vec![run_idx],
        None => (0..arguments.runs).collect(),
    };
    let next = AtomicU64::new(0);
    let trials = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads.max(1) {
            scope.spawn(|| {
                while let Some(run_idx) =
                    run_idxs.get(next.fetch_add(1, Ordering::Relaxed) as usize)
                {
                    let trial = run_guarded(&draw(arguments.seed, *run_idx));
                    say(&described(arguments.seed, *run_idx, &trial));
                    let mut trials = trials.lock().expect("no thread panics with the lock");
                    trials.push((*run_idx, trial));
                }
            });
        }
    });
    let mut trials = trials.into_inner().expect("no thread panics with the lock");
    trials.sort_by_key(|(run_idx, _)| *run_idx);
    let failed: Vec<_> = trials
        .iter()
        .filter(|(_, trial)| is_failed(trial))
        .collect();
    say(&format!(
        "\n{} of {} runs failed",
        failed.len(),
        trials.len()
    ));
    for (run_idx, trial) in &failed {
        say(&described(arguments.seed, *run_idx, trial));
        let seed = arguments.seed;
        say(&format!(
            "  again: cargo xtask robustness --seed {seed} --run {run_idx}"
        ));
    }
    Ok(if failed.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn is_failed(trial: &Result<Trial, String>) -> bool {
    trial.as_ref().map_or(true, |trial| trial.fault().is_some())
}

fn described(campaign_seed: u64, run_idx: u64, trial: &Result<Trial, String>) -> String {
    let settings = draw(campaign_seed, run_idx);
    let conditions: Vec<&str> = settings.conditions.iter().map(|it| it.name()).collect();
    let what = format!(
        "run {run_idx}: {} --seed {} --frames {} --conditions {}",
        settings.world.name(),
        settings.seed,
        settings.frame_count_max.unwrap_or_default(),
        conditions.join(",")
    );
    match trial {
        Err(panic) => format!("{what}: PANIC {panic}"),
        Ok(trial) => {
            let fault = trial.fault().map(|fault| format!(" {fault}"));
            format!(
                "{what}: {} of {} frames live, {}; {} in the end, {}{}",
                trial.live_count,
                trial.frame_count,
                judged(&trial.verdict),
                trial.final_count,
                judged(&trial.final_verdict),
                fault.unwrap_or_default()
            )
        }
    }
}

fn judged(verdict: &Verdict) -> String {
    format!(
        "{} maps, worst {:.1} % of {:.2} m (frame {}, map {})",
        verdict.map_count,
        100.0 * verdict.worst_share,
        verdict.distance_m,
        verdict.worst_frame_idx,
        verdict.worst_map_id
    )
}

//! `starling swarm`: swarm-keeping, many times over.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;

use super::{Exit, UsageError, output};
use crate::plot::Picture;
use crate::swarm::figures::{self, LateralSetpoint};
use crate::swarm::{
    FlightRecord, RuleName, Scenario, SensingName, Summary, Trace, fly_all, summarise,
};

#[derive(clap::Args)]
pub struct SwarmArguments {
    /// How many drones fly together.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=2000))]
    pub drones: u16,
    #[arg(long, value_enum, default_value = "gabriel")]
    pub rule: RuleArgument,
    /// How many flights, each from another start.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    pub runs: u32,
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[arg(long, value_enum, default_value = "realistic")]
    pub sensing: SensingArgument,
    /// Common to all, metres per second; zero hovers.
    #[arg(long, default_value_t = 0.0, value_parser = parse_speed)]
    pub speed: f64,
    /// Cylinders across the way.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=100))]
    pub obstacles: u16,
    /// Set one number, such as `latency_s=0.5`; may be repeated. An unknown name lists all.
    #[arg(long, value_name = "NAME=VALUE")]
    pub set: Vec<String>,
    /// Let the follower of the flight test hold the lights in the middle of the image (162 px), as
    /// the paper does, instead of on the optical axis.
    #[arg(long)]
    pub paper: bool,
    /// Where pictures, the recording and the numbers of every run go.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RuleArgument {
    /// The paper's rule, as written.
    Paper,
    /// The first shell of neighbours, with the safety filter.
    Gabriel,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SensingArgument {
    /// No error, no delay.
    Ideal,
    /// Lag 0.3 s, latency 0.2 s, 0.3 px, 10 % missed.
    Realistic,
    /// Pictures of seven cameras, in which marker vision finds the lights; up to 20 drones.
    Rendered,
}

pub fn run(arguments: &SwarmArguments) -> anyhow::Result<Exit> {
    let scenario = scenario_of(arguments)?;
    fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot create the folder: {}", arguments.out.display()))?;
    let progress = output::Progress::start("swarm", u64::from(arguments.runs));
    let mut trace = Trace::default();
    let records = fly_all(
        &scenario,
        arguments.runs as usize,
        arguments.seed,
        |moment| trace.add(moment),
        || progress.advance(1),
    );
    progress.finish();
    let summary = summarise(&records);
    write_pictures(arguments, &trace, &records)?;
    trace.record(&arguments.out.join("flight.mcap"))?;
    write_table(&arguments.out.join("runs.csv"), &table_of(&records))?;
    let settling = figures::settling_table(&records);
    write_table(&arguments.out.join("fig3_settling.csv"), &settling)?;
    if arguments.json {
        output::print_json(&summary)?;
    } else {
        print_summary(arguments, &summary);
    }
    Ok(Exit::Done)
}

fn scenario_of(arguments: &SwarmArguments) -> Result<Scenario, UsageError> {
    let rule = match arguments.rule {
        RuleArgument::Paper => RuleName::Paper,
        RuleArgument::Gabriel => RuleName::Gabriel,
    };
    let sensing = match arguments.sensing {
        SensingArgument::Ideal => SensingName::Ideal,
        SensingArgument::Realistic => SensingName::Realistic,
        SensingArgument::Rendered => SensingName::Rendered,
    };
    let mut scenario = Scenario::new(rule, sensing);
    scenario.swarm.drone_count = usize::from(arguments.drones);
    scenario.swarm.speed_mps = arguments.speed;
    scenario.swarm.obstacle_count = usize::from(arguments.obstacles);
    for text in &arguments.set {
        scenario
            .set(text)
            .map_err(|error| UsageError(format!("--set {text}: {error}")))?;
    }
    scenario
        .check()
        .map_err(|error| UsageError(error.to_string()))?;
    Ok(scenario)
}

fn parse_speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|speed: &f64| (0.0..=20.0).contains(speed))
        .ok_or_else(|| "expected a speed from 0 to 20 m/s".to_owned())
}

fn write_pictures(
    arguments: &SwarmArguments,
    trace: &Trace,
    records: &[FlightRecord],
) -> anyhow::Result<()> {
    let out = &arguments.out;
    if let Some(first) = records.first() {
        figures::trajectories(trace).write(&out.join("fig2_trajectories.png"))?;
        figures::corrections(trace, first).write(&out.join("fig2_corrections.png"))?;
    }
    figures::settling(records).write(&out.join("fig3_settling.png"))?;
    let setpoint = if arguments.paper {
        LateralSetpoint::Paper
    } else {
        LateralSetpoint::Calibrated
    };
    let following = figures::following(setpoint, arguments.seed);
    Ok(following.write(&out.join("fig5_following.png"))?)
}

fn write_table(path: &Path, table: &str) -> anyhow::Result<()> {
    fs::write(path, table).with_context(|| format!("cannot write the table: {}", path.display()))
}

/// One line for each run; what is not known is left empty.
fn table_of(records: &[FlightRecord]) -> String {
    let mut table = String::from(
        "seed,settle_s,min_distance_m,seen_collisions,unseen_collisions,hits,clearance_m_min,\
         order,order_of_neighbours,union,safety,connectivity,nn_mean_m,nn_sd_m,residual_mps_rms,\
         switches_per_s,command_step_mps_max\n",
    );
    for record in records {
        let totals = &record.totals;
        let known = |value: Option<f64>| {
            let finite = value.filter(|value| value.is_finite());
            finite.map_or(String::new(), |value| format!("{value:.6}"))
        };
        let line = [
            record.seed.to_string(),
            known(record.settle_s),
            known(Some(totals.min_distance_m)),
            totals.seen_collisions.to_string(),
            totals.unseen_collisions.to_string(),
            totals.hits.to_string(),
            known(Some(totals.clearance_m_min)),
            known(totals.order.mean()),
            known(totals.order_of_neighbours.mean()),
            known(totals.union.mean()),
            known(totals.safety.mean()),
            known(Some(record.connectivity)),
            known(totals.nearest_m.mean()),
            known(totals.nearest_m.standard_deviation()),
            known(totals.residual_squared.mean().map(f64::sqrt)),
            known(Some(totals.switches as f64 / record.drone_seconds)),
            known(Some(totals.command_step_mps_max)),
        ];
        writeln!(table, "{}", line.join(",")).expect("writing to a string does not fail");
    }
    table
}

fn print_summary(arguments: &SwarmArguments, summary: &Summary) {
    let known = |value: Option<f64>, digits: usize| {
        value.map_or("unknown".to_owned(), |value| format!("{value:.digits$}"))
    };
    let Summary {
        collisions,
        unseen,
        hits,
        ..
    } = summary;
    output::print_line(&format!(
        "{} runs of {} drones: {:.0} % settled, after {} s (median; 95 %: {} s)",
        arguments.runs,
        arguments.drones,
        100.0 * summary.converged,
        known(summary.settle_s_p50, 1),
        known(summary.settle_s_p95, 1),
    ));
    output::print_line(&format!(
        "spacing {} m (median); nearest neighbour {} ± {} m; never nearer than {} m",
        known(summary.spacing_m_p50, 2),
        known(summary.nn_mean_m, 2),
        known(summary.nn_sd_m, 2),
        known(summary.min_distance_m, 2),
    ));
    output::print_line(&format!(
        "{collisions} runs with a collision, {unseen} of them unseen; {hits} obstacles hit"
    ));
    output::print_line(&format!(
        "order {}, union {}, safety {}",
        known(summary.order, 3),
        known(summary.union, 3),
        known(summary.safety, 5),
    ));
    output::print_line(&format!(
        "seen {} of the others in view; {} of what was seen was nobody",
        known(summary.seen_share, 3),
        known(summary.false_share, 4),
    ));
    output::print_line(&format!(
        "pictures and recording: {}",
        arguments.out.display()
    ));
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: SwarmArguments,
    }

    fn parse(words: &[&str]) -> SwarmArguments {
        let words = ["swarm"].iter().chain(words);
        Line::try_parse_from(words).unwrap().arguments
    }

    #[test]
    fn a_small_campaign_leaves_its_files() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new");
        let out_text = out.to_str().unwrap();
        let arguments = parse(&["--runs", "2", "--set", "duration_s=10", "--out", out_text]);
        assert_eq!(run(&arguments).unwrap(), Exit::Done);
        for name in [
            "fig2_trajectories.png",
            "fig2_corrections.png",
            "fig3_settling.png",
            "fig3_settling.csv",
            "fig5_following.png",
            "flight.mcap",
            "runs.csv",
        ] {
            assert!(out.join(name).metadata().unwrap().len() > 0, "{name}");
        }
        let table = fs::read_to_string(out.join("runs.csv")).unwrap();
        assert_eq!(table.lines().count(), 3);
    }

    #[test]
    fn an_unknown_setting_is_a_usage_error() {
        let arguments = parse(&["--set", "colour=1", "--out", "/nowhere"]);
        let error = run(&arguments).unwrap_err();
        assert!(error.is::<UsageError>());
        assert!(error.to_string().contains("latency_s"), "{error}");
    }

    #[test]
    fn the_json_has_the_names_of_the_contract() {
        let json = serde_json::to_value(summarise(&[])).unwrap();
        let mut names: Vec<&String> = json.as_object().unwrap().keys().collect();
        names.sort();
        assert_eq!(
            names,
            [
                "collisions",
                "converged",
                "false_share",
                "hits",
                "min_distance_m",
                "nn_mean_m",
                "nn_sd_m",
                "order",
                "pair_distance_m_p50",
                "safety",
                "seen_share",
                "settle_s_p50",
                "settle_s_p95",
                "spacing_m_p50",
                "union",
                "unseen",
            ]
        );
    }
}

//! `starling sim record`: a rendered recording as files.

use std::path::PathBuf;

use sim::{Condition, Recording, RecordingSettings, RecordingWorld};

use super::super::output::Progress;
use super::super::{Exit, output};
use crate::rendered;

#[derive(clap::Args)]
pub struct RecordArguments {
    /// What is seen, and how the camera moves: lab, round, handheld, office, board, corridor,
    /// hover or still.
    #[arg(long, value_parser = parse_world)]
    world: RecordingWorld,
    /// Chooses the building, its finishes, the route and when each condition strikes.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The recording's folder; files of an earlier recording there are overwritten.
    #[arg(long)]
    out: PathBuf,
    /// End early.
    #[arg(long)]
    frames: Option<usize>,
    /// What makes it hard, several separated by commas: blur, noise, radio, exposure, cover,
    /// occlusion, low-texture, drops.
    #[arg(long, value_delimiter = ',', value_parser = parse_condition)]
    conditions: Vec<Condition>,
}

fn parse_world(name: &str) -> Result<RecordingWorld, String> {
    let names = RecordingWorld::ALL.map(RecordingWorld::name).join(", ");
    RecordingWorld::from_name(name).ok_or_else(|| format!("expected one of {names}"))
}

fn parse_condition(name: &str) -> Result<Condition, String> {
    let names = Condition::ALL.map(Condition::name).join(", ");
    Condition::from_name(name).ok_or_else(|| format!("expected one of {names}"))
}

pub fn run(arguments: &RecordArguments) -> anyhow::Result<Exit> {
    let recording = Recording::new(RecordingSettings {
        world: arguments.world,
        seed: arguments.seed,
        conditions: arguments.conditions.clone(),
        frame_count_max: arguments.frames,
    });
    let progress = Progress::start("record", recording.frame_count() as u64);
    let written = rendered::write_folder(&recording, &arguments.out, || progress.advance(1))?;
    progress.finish();
    output::print_line(&format!(
        "{written} of {} frames at {} Hz in {}",
        recording.frame_count(),
        recording.frame_rate_hz(),
        arguments.out.display()
    ));
    Ok(Exit::Done)
}

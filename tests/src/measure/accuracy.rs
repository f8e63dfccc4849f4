//! Every recording through `starling slam`, as a user would run it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use geometry::{Enu, Map};
use peer::dataset::{Dataset, DatasetArgument};
use peer::files::{StampedPose, read_tum};
use peer::rendered;
use serde::{Deserialize, Serialize};
use sim::{Condition, Recording, RecordingSettings, RecordingWorld};

use super::catalogue::{Entry, Source, entries};
use super::{Score, score, table, variant};

/// How much is measured.
#[derive(Clone, Debug)]
pub struct AccuracySettings {
    /// The program.
    pub starling: PathBuf,
    /// The folder `video` of the recordings, if it is there.
    pub video: Option<PathBuf>,
    /// Runs of each recording that is played at its own speed; others give the same every time.
    pub run_count: usize,
    /// Of each rendered world.
    pub seed_count: u64,
    /// Only rows whose name has one of these in it; all if there is none.
    pub only: Vec<String>,
    /// No recording at its own speed: for busy machines, on which frames would be late.
    pub unpaced: bool,
    /// Where trajectories and rendered recordings go.
    pub out: PathBuf,
}

/// What a run of `starling slam --json` says, and what its trajectory is worth.
#[derive(Clone, Debug, Serialize)]
pub struct Run {
    pub summary: Summary,
    pub score: Score,
    /// Frame numbers without a pose, as ranges.
    pub gaps: Vec<String>,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Summary {
    pub frames: usize,
    pub tracked: usize,
    pub tracked_live: usize,
    pub dropped: usize,
    pub lost: usize,
    pub keyframes: usize,
    pub ms_per_frame_p50: Option<f64>,
    pub ms_per_frame_p99: Option<f64>,
    pub peak_rss_bytes: Option<u64>,
}

/// A row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub name: String,
    pub outcome: Outcome,
}

#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    Runs(Vec<Run>),
    /// With the reason.
    Skipped(String),
    Failed(String),
}

/// Measures every row in turn; `report` sees each line of the table as soon as it is known.
/// Returns the whole table.
pub fn measure(settings: &AccuracySettings, mut report: impl FnMut(&str)) -> Result<String> {
    fs::create_dir_all(&settings.out)?;
    let is_wanted = |entry: &Entry| {
        settings.only.is_empty() || settings.only.iter().any(|part| entry.name.contains(part))
    };
    let mut rows = Vec::new();
    for line in table::HEADER {
        report(line);
    }
    for entry in entries().into_iter().filter(is_wanted) {
        let outcome = settings
            .run_all(&entry)
            .unwrap_or_else(|error| Outcome::Failed(format!("{error:#}")));
        let row = Row {
            name: entry.name,
            outcome,
        };
        report(&table::line(&row));
        rows.push(row);
        let json = serde_json::to_string_pretty(&rows)?;
        fs::write(settings.out.join("accuracy.json"), json)?;
    }
    Ok(table::whole(&rows))
}

/// Replaces the table in a document.
pub fn place_table(document: &Path, whole: &str) -> Result<()> {
    let text = fs::read_to_string(document)
        .with_context(|| format!("cannot read {}", document.display()))?;
    fs::write(document, table::placed(&text, whole)?)
        .with_context(|| format!("cannot write {}", document.display()))
}

impl AccuracySettings {
    fn run_all(&self, entry: &Entry) -> Result<Outcome> {
        match &entry.source {
            Source::Rendered { world, conditions } => {
                let seeds = 1..=self.seed_count;
                let runs = seeds.map(|seed| self.run_rendered(*world, conditions, seed));
                Ok(Outcome::Runs(runs.collect::<Result<_>>()?))
            }
            Source::Recorded { folder, range } => {
                let Some(folder) = self.folder(folder) else {
                    return Ok(Outcome::Skipped("no data".to_owned()));
                };
                let realtime = entry.realtime && !self.unpaced;
                let run_count = if realtime { self.run_count } else { 1 };
                let truth = folder.join("groundtruth.txt");
                let runs =
                    (0..run_count).map(|_| self.run(&argument(&folder, *range)?, &truth, realtime));
                Ok(Outcome::Runs(runs.collect::<Result<_>>()?))
            }
            Source::Variant { folder, selection } => {
                let Some(folder) = self.folder(folder) else {
                    return Ok(Outcome::Skipped("no data".to_owned()));
                };
                let variant = self.out.join("variant");
                variant::write(&folder, *selection, &variant)?;
                let truth = variant.join("groundtruth.txt");
                let run = self.run(&argument(&variant, None)?, &truth, entry.realtime)?;
                Ok(Outcome::Runs(vec![run]))
            }
        }
    }

    fn folder(&self, name: &str) -> Option<PathBuf> {
        let folder = self.video.as_ref()?.join(name);
        folder.is_dir().then_some(folder)
    }

    fn run_rendered(
        &self,
        world: RecordingWorld,
        conditions: &[Condition],
        seed: u64,
    ) -> Result<Run> {
        let recording = Recording::new(RecordingSettings {
            world,
            seed,
            conditions: conditions.to_vec(),
            frame_count_max: None,
        });
        let folder = self.out.join("rendered");
        if folder.exists() {
            fs::remove_dir_all(&folder)?;
        }
        rendered::write_folder(&recording, &folder, || ())?;
        let truth = folder.join("groundtruth.txt");
        let run = self.run(&argument(&folder, None)?, &truth, false)?;
        fs::remove_dir_all(&folder)?;
        Ok(run)
    }

    fn run(&self, dataset: &DatasetArgument, truth: &Path, realtime: bool) -> Result<Run> {
        let trajectory = self.out.join("trajectory.tum");
        let mut command = Command::new(&self.starling);
        command.arg("slam").arg(dataset.to_string());
        command.arg("--out").arg(&trajectory).arg("--json");
        if realtime {
            command.args(["--realtime", "--threads", "2"]);
        }
        let output = command
            .output()
            .with_context(|| format!("cannot start {}", self.starling.display()))?;
        // Without a single pose the exit code is 1, and the summary says so.
        let summary: Summary = match serde_json::from_slice(&output.stdout) {
            Ok(summary) => summary,
            Err(_) => bail!("{}", String::from_utf8_lossy(&output.stderr).trim()),
        };
        let estimate: Vec<StampedPose<Map>> = if summary.tracked > 0 {
            read_tum(&trajectory)?
        } else {
            Vec::new()
        };
        let truth: Vec<StampedPose<Enu>> = if truth.is_file() {
            read_tum(truth)?
        } else {
            Vec::new()
        };
        Ok(Run {
            score: score(&truth, &estimate),
            gaps: gaps(&Dataset::open(dataset)?, &estimate),
            summary,
        })
    }
}

fn argument(folder: &Path, range: Option<&str>) -> Result<DatasetArgument> {
    let range = range.map(str::parse).transpose();
    Ok(DatasetArgument {
        path: folder.to_owned(),
        range: range.context("the range in the catalogue is malformed")?,
    })
}

/// Ranges of frames without a pose.
fn gaps(dataset: &Dataset, estimate: &[StampedPose<Map>]) -> Vec<String> {
    let mut gaps: Vec<(usize, usize)> = Vec::new();
    for frame in dataset.frames() {
        let has_pose = estimate
            .binary_search_by_key(&frame.captured_at, |pose| pose.captured_at)
            .is_ok();
        match gaps.last_mut() {
            _ if has_pose => {}
            Some((_, last)) if *last + 1 == frame.frame_idx => *last = frame.frame_idx,
            _ => gaps.push((frame.frame_idx, frame.frame_idx)),
        }
    }
    gaps.iter()
        .map(|(from, to)| format!("{from}-{to}"))
        .collect()
}

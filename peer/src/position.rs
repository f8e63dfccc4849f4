//! Position fixes from files: a trajectory of a site, or a table of geodetic positions.

mod line;

use std::path::{Path, PathBuf};

use anchor::{FixPosition, PositionFix};
use geodesy::Geodetic;
use geometry::Timestamp;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::config::PositionConfig;
use line::parse_line;

/// Why a file brings no fixes.
#[derive(Debug, thiserror::Error)]
pub enum PositionError {
    #[error("cannot read the fixes: {error}: {path}")]
    Unreadable {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error(
        "no usable line of {line_count}; expected TUM (`timestamp tx ty tz …`) or CSV \
         (`timestamp,latitude_deg,longitude_deg,altitude_m[,sigma_m]`): {path}"
    )]
    NoFixes { line_count: usize, path: PathBuf },
    #[error(
        "no fix falls into the recording: the fixes span {}..{} s, the recording {}..{} s; \
         are both stamped by one clock? {path}",
        fixes.0, fixes.1, recording.0, recording.1
    )]
    NoOverlap {
        fixes: (Timestamp, Timestamp),
        recording: (Timestamp, Timestamp),
        path: PathBuf,
    },
}

/// The fixes of a file in the order of time, and what was left out.
#[derive(Debug, Default)]
pub struct FixFile {
    pub fixes: Vec<PositionFix>,
    /// In the order of the file.
    pub skipped: Vec<SkippedLine>,
    path: PathBuf,
}

/// A line that is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SkippedLine {
    /// Counted from one.
    pub line: usize,
    pub reason: SkipReason,
}

/// Why a line is left out, in words that a line number follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SkipReason {
    /// Not a fix, for example with NaN in it.
    Malformed,
    /// Its stamp does not fit between those of the lines around it.
    OutOfOrder,
    /// Geodetic among positions of a site, or the other way round.
    OtherFrame,
}

/// Reads fixes. Of a trajectory only the positions are read, never the orientations.
///
/// Of lines whose stamps do not increase as few as possible are left out, so that one wrong stamp
/// costs one fix, wherever it is. The first line may name the columns; `#` starts a comment.
pub fn read_fixes(config: &PositionConfig, path: &Path) -> Result<FixFile, PositionError> {
    let text = std::fs::read_to_string(path).map_err(|error| PositionError::Unreadable {
        error,
        path: path.to_owned(),
    })?;
    let mut skipped = Vec::new();
    let mut parsed: Vec<(usize, PositionFix)> = Vec::new();
    for (line, text) in lines_with_content(&text) {
        let skip = |reason| SkippedLine { line, reason };
        match (parse_line(text, config), parsed.first()) {
            (None, _) => skipped.push(skip(SkipReason::Malformed)),
            (Some(fix), Some((_, first))) if is_geodetic(&fix) != is_geodetic(first) => {
                skipped.push(skip(SkipReason::OtherFrame));
            }
            (Some(fix), _) => parsed.push((line, fix)),
        }
    }
    let line_count = skipped.len() + parsed.len();
    let stamps: Vec<Timestamp> = parsed.iter().map(|(_, fix)| fix.captured_at).collect();
    let in_order = longest_increasing(&stamps);
    let mut fixes = Vec::with_capacity(parsed.len());
    for ((line, fix), is_in_order) in parsed.into_iter().zip(in_order) {
        if is_in_order {
            fixes.push(disturbed(fix, config));
        } else {
            let reason = SkipReason::OutOfOrder;
            skipped.push(SkippedLine { line, reason });
        }
    }
    skipped.sort_by_key(|skipped| skipped.line);
    if fixes.is_empty() {
        return Err(PositionError::NoFixes {
            line_count,
            path: path.to_owned(),
        });
    }
    Ok(FixFile {
        fixes,
        skipped,
        path: path.to_owned(),
    })
}

impl FixFile {
    /// The fixes between two moments; there must be one.
    pub fn within(
        &self,
        first: Timestamp,
        last: Timestamp,
    ) -> Result<Vec<PositionFix>, PositionError> {
        let fixes = self.fixes.iter();
        let within = fixes.filter(|fix| (first..=last).contains(&fix.captured_at));
        let within: Vec<PositionFix> = within.cloned().collect();
        match (within.is_empty(), self.fixes.first(), self.fixes.last()) {
            (true, Some(oldest), Some(newest)) => Err(PositionError::NoOverlap {
                fixes: (oldest.captured_at, newest.captured_at),
                recording: (first, last),
                path: self.path.clone(),
            }),
            _ => Ok(within),
        }
    }

    /// What was left out, for a person: how many lines, the first of each kind, and the file.
    pub fn warning(&self) -> Option<String> {
        let kinds = [
            (SkipReason::Malformed, "no fix"),
            (SkipReason::OutOfOrder, "out of order"),
            (SkipReason::OtherFrame, "of another kind of frame"),
        ];
        let described = kinds.iter().filter_map(|(reason, words)| {
            let lines = self.skipped.iter().filter(|one| one.reason == *reason);
            let lines: Vec<usize> = lines.map(|one| one.line).collect();
            (!lines.is_empty()).then(|| format!("{words}: {}", name_lines(&lines)))
        });
        let described: Vec<String> = described.collect();
        (!described.is_empty()).then(|| {
            format!(
                "skipped {} of {} fixes ({}): {}",
                self.skipped.len(),
                self.skipped.len() + self.fixes.len(),
                described.join("; "),
                self.path.display()
            )
        })
    }
}

/// How many line numbers a person is told.
const NAMED_LINE_COUNT: usize = 5;

fn name_lines(lines: &[usize]) -> String {
    let named: Vec<String> = lines
        .iter()
        .take(NAMED_LINE_COUNT)
        .map(usize::to_string)
        .collect();
    let noun = if lines.len() == 1 { "line" } else { "lines" };
    let more = match lines.len().saturating_sub(NAMED_LINE_COUNT) {
        0 => String::new(),
        more_count => format!(" and {more_count} more"),
    };
    format!("{noun} {}{more}", named.join(", "))
}

/// Lines with their numbers from one, without comments and a line of names at the top.
fn lines_with_content(text: &str) -> impl Iterator<Item = (usize, &str)> {
    // Spreadsheets begin their files with a byte order mark.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = text.lines().map(str::trim).enumerate();
    let lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    lines
        .enumerate()
        .filter(|(idx, (_, line))| *idx > 0 || !names_columns(line))
        .map(|(_, (line_idx, line))| (line_idx + 1, line))
}

/// Whether no field is a number. `nan` is one, and no name of a column.
fn names_columns(line: &str) -> bool {
    line.split([',', ' ', '\t'])
        .filter(|field| !field.is_empty())
        .all(|field| field.parse::<f64>().is_err())
}

/// Which stamps belong to the longest strictly increasing run through all of them; of equally
/// long ones the run with the earlier lines.
fn longest_increasing(stamps: &[Timestamp]) -> Vec<bool> {
    // From the back: `tails[length - 1]` is the line with the largest stamp that begins a run of
    // that length, so the stamps of the tails fall and can be searched.
    let mut tails: Vec<usize> = Vec::new();
    let mut next = vec![None; stamps.len()];
    for (idx, stamp) in stamps.iter().enumerate().rev() {
        let length = tails.partition_point(|tail| stamps[*tail] > *stamp);
        next[idx] = length.checked_sub(1).map(|shorter| tails[shorter]);
        if length == tails.len() {
            tails.push(idx);
        } else {
            tails[length] = idx;
        }
    }
    let mut in_run = vec![false; stamps.len()];
    let mut idx = tails.last().copied();
    while let Some(current) = idx {
        in_run[current] = true;
        idx = next[current];
    }
    in_run
}

fn is_geodetic(fix: &PositionFix) -> bool {
    matches!(fix.position, FixPosition::Geodetic(_))
}

/// The fix with noise that depends on nothing but the seed and its own stamp, so that fixes that
/// are removed change nothing else.
fn disturbed(fix: PositionFix, config: &PositionConfig) -> PositionFix {
    if config.noise_m == 0.0 {
        return fix;
    }
    let mut seed = [0; 32];
    seed[..8].copy_from_slice(&config.noise_seed.to_le_bytes());
    seed[8..16].copy_from_slice(&fix.captured_at.nanoseconds().to_le_bytes());
    let mut rng = ChaCha8Rng::from_seed(seed);
    let noise = Vector3::from_fn(|_, _| {
        let normal: f64 = StandardNormal.sample(&mut rng);
        normal * config.noise_m
    });
    let position = match fix.position {
        FixPosition::Local(point) => FixPosition::Local(point + noise),
        FixPosition::Geodetic(position) => {
            let moved = position.ecef_from_enu() * noise;
            FixPosition::Geodetic(Geodetic::from_ecef(&moved).unwrap_or(position))
        }
    };
    PositionFix { position, ..fix }
}

#[cfg(test)]
mod tests;

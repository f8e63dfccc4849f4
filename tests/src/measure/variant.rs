//! Recordings that nobody made: frames of others, left out or in another order.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use geometry::Timestamp;
use peer::files::parse_seconds;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Which frames of a recording, and in which order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Selection {
    /// One of so many.
    Every(usize),
    /// From here on.
    From(usize),
    /// The last frame first; time runs on all the same.
    Reversed,
    /// Each frame is missing with this probability.
    Dropped { share: f64, seed: u64 },
}

/// Writes a folder in TUM RGB-D layout whose `rgb.txt` names images of another.
pub fn write(source: &Path, selection: Selection, folder: &Path) -> Result<()> {
    let source = source
        .canonicalize()
        .context("the recording is not there")?;
    fs::create_dir_all(folder)?;
    fs::copy(source.join("camera.yaml"), folder.join("camera.yaml"))?;
    let frames = read(&source.join("rgb.txt"))?;
    let truth = read(&source.join("groundtruth.txt"))?;
    let (first, last) = match (frames.first(), frames.last()) {
        (Some(first), Some(last)) => (first.0, last.0),
        _ => anyhow::bail!("no images in {}", source.display()),
    };
    let turned = |at: Timestamp| first.after(last.since(at));
    let mut list = String::new();
    for (at, name) in selected(&frames, selection) {
        let at = if selection == Selection::Reversed {
            turned(at)
        } else {
            at
        };
        let image: PathBuf = source.join(name);
        list.push_str(&format!("{at} {}\n", image.display()));
    }
    fs::write(folder.join("rgb.txt"), list)?;
    let mut poses: Vec<(Timestamp, &str)> = truth
        .iter()
        .filter(|(at, _)| (first..=last).contains(at))
        .map(|(at, pose)| (*at, pose.as_str()))
        .collect();
    if selection == Selection::Reversed {
        poses.reverse();
        for (at, _) in &mut poses {
            *at = turned(*at);
        }
    }
    let lines: String = poses
        .iter()
        .map(|(at, pose)| format!("{at} {pose}\n"))
        .collect();
    fs::write(folder.join("groundtruth.txt"), lines)?;
    Ok(())
}

/// The lines of a list, each parted into its stamp and the rest.
fn read(path: &Path) -> Result<Vec<(Timestamp, String)>> {
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let lines = text.lines().map(str::trim);
    lines
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(|line| {
            let parted = line.split_once(char::is_whitespace);
            let (stamp, rest) = parted.with_context(|| format!("no stamp in {line:?}"))?;
            let at = parse_seconds(stamp).with_context(|| format!("no stamp in {line:?}"))?;
            Ok((at, rest.trim().to_owned()))
        })
        .collect()
}

fn selected(frames: &[(Timestamp, String)], selection: Selection) -> Vec<(Timestamp, &str)> {
    let all = frames.iter().map(|(at, name)| (*at, name.as_str()));
    match selection {
        Selection::Every(stride) => all.step_by(stride).collect(),
        Selection::From(start) => all.skip(start).collect(),
        Selection::Reversed => all.rev().collect(),
        Selection::Dropped { share, seed } => {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            all.filter(|_| !rng.random_bool(share)).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(selection: Selection) -> (Vec<String>, Vec<String>) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let source = folder.path().join("source");
        fs::create_dir(&source).unwrap();
        fs::write(source.join("camera.yaml"), "").unwrap();
        fs::write(
            source.join("rgb.txt"),
            "# t name\n1.0 a\n1.5 b\n2.5 c\n4.0 d\n",
        )
        .unwrap();
        fs::write(
            source.join("groundtruth.txt"),
            "1.0 p\n2.5 q\n4.0 r\n9.0 s\n",
        )
        .unwrap();
        let out = folder.path().join("out");
        write(&source, selection, &out).unwrap();
        let lines = |name: &str| {
            let text = fs::read_to_string(out.join(name)).unwrap();
            let last = |line: &str| {
                let (at, rest) = line.split_once(' ').unwrap();
                let seconds: f64 = at.parse().unwrap();
                format!("{seconds} {}", rest.rsplit('/').next().unwrap())
            };
            text.lines().map(last).collect()
        };
        (lines("rgb.txt"), lines("groundtruth.txt"))
    }

    #[test]
    fn frames_are_left_out_or_turned_with_their_truth() {
        let (frames, truth) = written(Selection::Reversed);
        assert_eq!(frames, ["1 d", "2.5 c", "3.5 b", "4 a"]);
        assert_eq!(truth, ["1 r", "2.5 q", "4 p"]);
        assert_eq!(written(Selection::Every(2)).0, ["1 a", "2.5 c"]);
        let (frames, truth) = written(Selection::From(1));
        assert_eq!(frames, ["1.5 b", "2.5 c", "4 d"]);
        assert_eq!(truth.len(), 3);
        let dropped = Selection::Dropped {
            share: 1.0,
            seed: 1,
        };
        assert!(written(dropped).0.is_empty());
    }
}

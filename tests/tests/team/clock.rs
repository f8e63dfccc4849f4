//! Goal: what a team estimates follows from its inputs alone. Method: fly twice on one thread
//! without an outage, the second time without anything that a peer must not see.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::processes::{succeed, team_of};
use crate::recordings::RECORDINGS;

fn fly(ground: &str, drone: &Path, fixes: &Path, out: &Path) {
    succeed(
        team_of(ground, fixes, out)
            .args(["--threads", "1", "--seed", "4"])
            .args(["--fix-noise-m", "0.02"])
            .arg("--peer")
            .arg(
                drone
                    .to_str()
                    .map(|drone| format!("{drone}@0..120"))
                    .unwrap(),
            ),
    );
}

/// The fixes up to the last frame that the anchor flies, and no others.
fn fixes_of_flown_frames(folder: &Path) -> PathBuf {
    let text = fs::read_to_string(&RECORDINGS.fixes).unwrap();
    let list = fs::read_to_string(RECORDINGS.ground.join("rgb.txt")).unwrap();
    let last = list.lines().nth(120).unwrap().split(' ').next().unwrap();
    let last: f64 = last.parse().unwrap();
    let stamp = |line: &str| line.split(' ').next().unwrap().parse::<f64>().ok();
    let kept = text
        .lines()
        .filter(|line| stamp(line).is_some_and(|stamp| stamp <= last));
    let path = folder.join("fewer.tum");
    fs::write(&path, kept.collect::<Vec<_>>().join("\n")).unwrap();
    path
}

#[test]
fn two_runs_agree_and_truth_cannot_leak() {
    let folder = TempDir::new().unwrap();
    let ground = format!("{}@0..120", RECORDINGS.ground.display());
    // A copy of the drone's folder with a false truth in it, and the folder without one.
    let with_truth = folder.path().join("drone");
    fs::create_dir(&with_truth).unwrap();
    for name in ["rgb", "rgb.txt", "camera.yaml"] {
        std::os::unix::fs::symlink(RECORDINGS.drone.join(name), with_truth.join(name)).unwrap();
    }
    fs::write(with_truth.join("groundtruth.txt"), "10.0 9 9 9 0 0 0 1\n").unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    fly(&ground, &with_truth, &RECORDINGS.fixes, &first);
    let fewer = fixes_of_flown_frames(folder.path());
    fly(&ground, &RECORDINGS.drone, &fewer, &second);
    for name in [
        "anchor1.tum",
        "peer1.tum",
        "peer1.final.tum",
        "peer1.cov.csv",
    ] {
        let read = |folder: &Path| fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(read(&first), read(&second), "{name}");
    }
    let global = fs::read_to_string(first.join("peer1.tum")).unwrap();
    assert!(
        global.lines().count() > 10,
        "the peer became global, so there was something to leak"
    );
}

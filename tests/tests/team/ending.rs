//! Goal: a flight that goes wrong leaves behind what was flown until then, and says what went
//! wrong. Method: full disks, interrupts and killed vehicles, at whatever moment.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use crate::processes::{Vehicle, succeed, summary, team_of};
use crate::recordings::RECORDINGS;

const PATIENCE: Duration = Duration::from_secs(120);

#[test]
fn a_full_disk_costs_files_and_not_the_flight() {
    let folder = TempDir::new().unwrap();
    for suffix in ["mcap", "tum", "map.ply"] {
        let path = folder.path().join(format!("peer1.{suffix}"));
        symlink("/dev/full", path).unwrap();
    }
    let dataset = RECORDINGS.drone.display();
    let tables = format!("[camera]\ndataset = \"{dataset}@0..30\"\n");
    let vehicle = Vehicle::start(folder.path(), "peer1", &[], &tables);
    assert_eq!(vehicle.wait(PATIENCE), 3);
    let peer = summary(folder.path(), "peer1");
    assert_eq!(peer["frame_count"], 30, "{peer}");
    assert!(peer["unwritten_count"].as_u64() >= Some(2), "{peer}");
    let cause = peer["write_error"].as_str().unwrap();
    assert!(cause.contains("No space left"), "{cause}");
    assert!(folder.path().join("peer1.own.tum").exists());
}

/// A team that has begun to fly.
fn team(out: &Path) -> Child {
    let child = team_of(&RECORDINGS.ground, &RECORDINGS.fixes, out)
        .arg("--peer")
        .arg(&RECORDINGS.drone)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let deadline = Instant::now() + PATIENCE;
    // The first frame brings a state, which is recorded at once.
    let recorded = |id: &str| {
        let path = out.join(format!("{id}.mcap"));
        path.metadata().map_or(0, |metadata| metadata.len())
    };
    while recorded("anchor1") == 0 || recorded("peer1") == 0 {
        assert!(Instant::now() < deadline, "the team does not fly");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

fn send(signal: &str, process: u32) {
    succeed(Command::new("kill").args([signal, &process.to_string()]));
}

/// The process that flies a vehicle of this team.
fn process_of(team: &Child, id: &str) -> u32 {
    let children = format!("/proc/{0}/task/{0}/children", team.id());
    let children = fs::read_to_string(children).unwrap();
    let configuration = format!("{id}.vehicle.toml");
    let child = children.split_whitespace().find(|child| {
        let arguments = fs::read(format!("/proc/{child}/cmdline")).unwrap();
        String::from_utf8_lossy(&arguments).contains(&configuration)
    });
    child.unwrap().parse().unwrap()
}

/// The exit code, what it says, and its JSON.
fn end(team: Child) -> (Option<i32>, String, Value) {
    let Output {
        status,
        stdout,
        stderr,
    } = team.wait_with_output().unwrap();
    let diagnostics = String::from_utf8(stderr).unwrap();
    let json = serde_json::from_slice(&stdout).unwrap_or_default();
    (status.code(), diagnostics, json)
}

fn check_ended_in_order(folder: &Path, id: &str) {
    for suffix in ["final.tum", "own.tum", "map.ply", "json"] {
        let path = folder.join(format!("{id}.{suffix}"));
        assert!(path.exists(), "{} is missing", path.display());
    }
    let recording = fs::read(folder.join(format!("{id}.mcap"))).unwrap();
    assert!(
        recording.ends_with(b"\x89MCAP0\r\n"),
        "{id}'s recording has no end"
    );
}

#[test]
fn an_interrupted_team_ends_in_order_and_says_so() {
    let folder = TempDir::new().unwrap();
    let team = team(folder.path());
    // A terminal interrupts them all, and others who end a group of processes say it twice.
    for id in ["anchor1", "peer1"] {
        send("-INT", process_of(&team, id));
    }
    send("-TERM", team.id());
    send("-INT", team.id());
    send("-INT", team.id());
    let (code, diagnostics, json) = end(team);
    assert_eq!(code, Some(130), "{diagnostics}");
    assert!(diagnostics.contains("interrupted"), "{diagnostics}");
    assert_eq!(json["ok"], false);
    assert_eq!(json["vehicles"].as_array().map(Vec::len), Some(2), "{json}");
    check_ended_in_order(folder.path(), "anchor1");
    check_ended_in_order(folder.path(), "peer1");
}

#[test]
fn a_killed_vehicle_is_named_and_the_others_end_in_order() {
    let folder = TempDir::new().unwrap();
    let team = team(folder.path());
    let peer = process_of(&team, "peer1");
    send("-KILL", peer);
    let (code, diagnostics, json) = end(team);
    assert_eq!(code, Some(1), "{diagnostics}");
    let expected = format!("vehicle peer1 (process {peer}) was killed by signal 9");
    assert!(diagnostics.contains(&expected), "{diagnostics}");
    assert_eq!(json["ok"], false);
    assert_eq!(json["vehicles"][0]["id"], "anchor1");
    check_ended_in_order(folder.path(), "anchor1");
}

#[test]
fn vehicles_end_in_order_when_their_parent_is_killed() {
    let folder = TempDir::new().unwrap();
    let team = team(folder.path());
    let processes = ["anchor1", "peer1"].map(|id| process_of(&team, id));
    send("-KILL", team.id());
    end(team);
    let deadline = Instant::now() + PATIENCE;
    let lives = |process: &u32| Path::new(&format!("/proc/{process}/fd/0")).exists();
    while processes.iter().any(lives) {
        assert!(Instant::now() < deadline, "they fly without a parent");
        std::thread::sleep(Duration::from_millis(50));
    }
    check_ended_in_order(folder.path(), "anchor1");
    check_ended_in_order(folder.path(), "peer1");
}

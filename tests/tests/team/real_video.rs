//! Goal: what the product claims on real video holds. Method: the commands of the benchmarks on
//! recordings that are not part of the product; without them the tests say so and pass.

use std::path::{Path, PathBuf};

use peer::evaluate::{Alignment, trajectory_error};
use peer::files::read_tum;
use serde_json::Value;
use tempfile::TempDir;

use crate::processes::{starling, succeed, team_of};

/// A recording below `$STARLING_DATA/video`.
fn recording(name: &str) -> Option<PathBuf> {
    let folder = PathBuf::from(std::env::var_os("STARLING_DATA")?)
        .join("video")
        .join(name);
    folder.is_dir().then_some(folder)
}

/// The frames of the truth and of the estimate are never mixed up.
struct Truth;
struct Estimate;

fn rmse_m(truth: &Path, estimate: &Path, alignment: Alignment) -> f64 {
    let truth = read_tum::<Truth>(truth).unwrap();
    let estimate = read_tum::<Estimate>(estimate).unwrap();
    trajectory_error(&truth, &estimate, alignment)
        .unwrap()
        .rmse_m
}

fn json(output: &std::process::Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_handheld_kitchen_is_tracked() {
    let Some(kitchen) = recording("sevenscenes_kitchen") else {
        println!("skipped: no data");
        return;
    };
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("k.tum");
    let output = succeed(
        starling()
            .args(["slam", "--threads", "1", "--json"])
            .arg(&kitchen)
            .arg("--out")
            .arg(&out),
    );
    assert!(json(&output)["tracked"].as_u64().unwrap() >= 900);
    let truth = kitchen.join("groundtruth.txt");
    assert!(rmse_m(&truth, &out, Alignment::Similarity) <= 0.02);
}

fn fly(anchor: &str, fixes: &Path, peer: &str, truth: &Path) {
    let folder = TempDir::new().unwrap();
    let output = succeed(
        team_of(anchor, fixes, folder.path())
            .args(["--threads", "1", "--fix-noise-m", "0.02"])
            .args(["--peer", peer]),
    );
    let report = json(&output);
    let peer = &report["vehicles"][1];
    assert_eq!(peer["state"], "Global", "{peer}");
    assert!(peer["global_share"].as_f64().unwrap() >= 0.5, "{peer}");
    let error_m = rmse_m(truth, &folder.path().join("peer1.tum"), Alignment::None);
    assert!(error_m <= 0.08, "{error_m}");
}

#[test]
fn a_peer_finds_itself_in_the_other_half_of_a_real_kitchen() {
    let Some(kitchen) = recording("sevenscenes_kitchen") else {
        println!("skipped: no data");
        return;
    };
    let truth = kitchen.join("groundtruth.txt");
    let part = |frames: &str| format!("{}@{frames}", kitchen.display());
    fly(&part("0..400"), &truth, &part("400..1000"), &truth);
}

/// The paper's second configuration.
#[test]
fn a_drone_finds_itself_in_the_map_of_a_ground_vehicle() {
    let Some(pair) = recording("kitchen_pair") else {
        println!("skipped: no data");
        return;
    };
    let (ground, drone) = (pair.join("ground"), pair.join("drone"));
    let text = |path: &Path| path.display().to_string();
    let truth = |path: &Path| path.join("groundtruth.txt");
    fly(
        &text(&ground),
        &truth(&ground),
        &text(&drone),
        &truth(&drone),
    );
}

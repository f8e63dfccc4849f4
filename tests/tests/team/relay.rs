//! Several vehicles that know the Earth only through each other, and anchors of which one lies.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::processes::{succeed, summary, team_of};
use crate::recordings::{RECORDINGS, Tour};

/// To and fro along so many frames.
fn to_and_fro(step: usize, span: usize) -> usize {
    let phase = step % (2 * span);
    phase.min(2 * span - phase)
}

/// The least trace of the position covariance that a vehicle stated.
fn least_variance(folder: &Path, id: &str) -> f64 {
    let text = fs::read_to_string(folder.join(format!("{id}.cov.csv"))).unwrap();
    let rows = text.lines().filter_map(|line| {
        let values: Vec<f64> = line.split(',').filter_map(|one| one.parse().ok()).collect();
        (values.len() == 7).then(|| values[1] + values[4] + values[6])
    });
    rows.fold(f64::INFINITY, f64::min)
}

/// Goal: a vehicle that sees nothing of the anchor's map finds itself by that of one that does,
/// says so, and is no more certain than that one. Method: the ground vehicle of the lab looks at
/// one wall all the time; the first peer goes from there around two corners; the second stays
/// behind them.
#[test]
fn a_place_is_handed_on_and_grows_no_more_certain() {
    const STEP_COUNT: usize = 240;
    let folder = TempDir::new().unwrap();
    let along = |frame_of: &dyn Fn(usize) -> usize| (0..STEP_COUNT).map(frame_of).collect();
    let tour = Tour::lab();
    let anchor = tour.render(
        &folder.path().join("a"),
        along(&|step| to_and_fro(step, 45)),
    );
    let first = tour.render(
        &folder.path().join("b"),
        along(&|step| match step {
            ..70 => 5 + to_and_fro(step, 35),
            _ => 5 + (step - 70),
        }),
    );
    let second = tour.render(
        &folder.path().join("c"),
        along(&|step| 105 + to_and_fro(step, 45)),
    );
    let out = folder.path().join("out");
    let fixes = tour.fixes(&folder.path().join("fixes.tum"), STEP_COUNT, |step| {
        to_and_fro(step, 45)
    });
    succeed(
        team_of(&anchor, &fixes, &out)
            .arg("--peer")
            .arg(&first)
            .arg("--peer")
            .arg(&second),
    );
    let [anchor, first, second] = ["anchor1", "peer1", "peer2"].map(|id| summary(&out, id));
    let counted = |vehicle: &Value, name: &str| vehicle["counters"][name].as_u64().unwrap();
    assert!(counted(&anchor, "chunks_published") > 3, "{anchor}");
    assert!(counted(&first, "chunks_published") > 3, "{first}");
    assert!(first["global_share"].as_f64().unwrap() > 0.3, "{first}");
    assert_eq!(second["state"], "Global", "{second}");
    let reason = second["reason"].as_str().unwrap();
    assert_eq!(reason, "registered to peer1, itself registered (anchor1)");
    let variances = [least_variance(&out, "peer1"), least_variance(&out, "peer2")];
    assert!(variances[0] <= variances[1], "{variances:?}");
}

/// The fixes as somebody would tell them who is 2 m, 5° and a tenth off.
fn falsified(folder: &Path) -> PathBuf {
    let mut text = String::new();
    let (sin, cos) = 5_f64.to_radians().sin_cos();
    for line in fs::read_to_string(&RECORDINGS.fixes)
        .unwrap()
        .lines()
        .skip(1)
    {
        let values: Vec<&str> = line.split(' ').collect();
        let [x, y, z] = [1, 2, 3].map(|idx| values[idx].parse::<f64>().unwrap() * 1.1);
        let (x, y) = (cos * x - sin * y + 1.2, sin * x + cos * y - 1.6);
        writeln!(text, "{} {x} {y} {z} 0 0 0 1", values[0]).unwrap();
    }
    let path = folder.join("lies.tum");
    fs::write(&path, text).unwrap();
    path
}

/// Goal: of three anchors the one that lies is named and left out. Method: the same drive three
/// times, once with falsified fixes.
#[test]
fn an_anchor_that_contradicts_two_others_is_named_and_left_out() {
    let folder = TempDir::new().unwrap();
    let lies = falsified(folder.path());
    let ground = format!("{}@0..120", RECORDINGS.ground.display());
    let out = folder.path().join("out");
    let mut team = team_of(&ground, &lies, &out);
    for _ in 0..2 {
        team.args(["--anchor", &ground, "--fixes"])
            .arg(&RECORDINGS.fixes);
    }
    let drone = format!("{}@0..120", RECORDINGS.drone.display());
    succeed(team.args(["--peer", &drone]));
    let peer = summary(&out, "peer1");
    assert_eq!(peer["state"], "Global", "{peer}");
    let reason = peer["reason"].as_str().unwrap();
    assert_eq!(
        reason,
        "registered to anchor2, anchor3; anchor1 contradicts and is left out"
    );
    let log = fs::read_to_string(out.join("peer1.log")).unwrap();
    assert!(
        log.contains("left out, since it contradicts the others"),
        "{log}"
    );
}

//! Goal: a drone that hovers, and has no map of its own, knows where it is from single frames among
//! the ground vehicle's chunks, also while it turns on the spot. Method: fly it as a recording over
//! real zenoh, and compare what it published with the truth.

use peer::evaluate::{Alignment, trajectory_error};
use peer::files::read_tum;
use peer::rendered::write_folder;
use sim::{Recording, RecordingSettings, RecordingWorld};
use tempfile::TempDir;

use crate::processes::{succeed, summary, team_of};
use crate::recordings::{RECORDINGS, SEED};

/// The frames of the truth and of the estimate are never mixed up.
struct Truth;
struct Estimate;

#[test]
fn a_hovering_drone_is_global_soon_after_the_first_chunks() {
    let folder = TempDir::new().unwrap();
    let (still, out) = (folder.path().join("still"), folder.path().join("out"));
    let recording = Recording::new(RecordingSettings {
        world: RecordingWorld::Still,
        seed: SEED,
        conditions: Vec::new(),
        frame_count_max: Some(150),
    });
    write_folder(&recording, &still, || ()).unwrap();
    succeed(
        team_of(&RECORDINGS.ground, &RECORDINGS.fixes, &out)
            .args(["--fix-noise-m", "0.02", "--peer"])
            .arg(&still),
    );
    let (anchor, peer) = (summary(&out, "anchor1"), summary(&out, "peer1"));
    assert_eq!(peer["state"], "Global", "{peer}");
    let reason = peer["reason"].as_str().unwrap();
    assert!(reason.contains("single frames"), "{peer}");
    assert_eq!(peer["keyframe_count"], 0, "{peer}");
    // No chunk can be placed before the anchor is.
    let first_global_s = |vehicle: &serde_json::Value| vehicle["first_global_s"].as_f64().unwrap();
    assert!(first_global_s(&peer) < first_global_s(&anchor) + 3.0);
    let truth = read_tum::<Truth>(&still.join("groundtruth.txt")).unwrap();
    let estimate = read_tum::<Estimate>(&out.join("peer1.tum")).unwrap();
    let error = trajectory_error(&truth, &estimate, Alignment::None).unwrap();
    assert!(error.rmse_m <= 0.1, "{}", error.rmse_m);
}

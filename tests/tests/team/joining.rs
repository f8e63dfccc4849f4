//! Who comes late, who is alone, and who only asks.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use tempfile::TempDir;

use crate::processes::{Vehicle, starling, succeed, summary};
use crate::recordings::RECORDINGS;

const PATIENCE: Duration = Duration::from_secs(120);

fn anchor(folder: &Path) -> Vehicle {
    let tables = format!(
        "[camera]\ndataset = {:?}\n[position]\nfile = {:?}\n",
        RECORDINGS.ground, RECORDINGS.fixes
    );
    Vehicle::start(folder, "anchor1", &[], &tables)
}

/// Waits until the anchor has this many chunks.
fn wait_for_chunks(endpoint: &str, chunk_count: u64) {
    for _ in 0..100 {
        let output = starling()
            .args([
                "map",
                "get",
                "anchor/*/map",
                "--json",
                "--connect",
                endpoint,
            ])
            .output()
            .unwrap();
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        if answer["maps"][0]["chunk_count"].as_u64() >= Some(chunk_count) {
            return;
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    panic!("the anchor has fewer than {chunk_count} chunks after 20 s");
}

#[test]
fn a_late_joiner_gets_the_map_by_query() {
    let folder = TempDir::new().unwrap();
    let anchor = anchor(folder.path());
    wait_for_chunks(&anchor.endpoint, 8);
    let tables = format!(
        "[camera]\ndataset = \"{}@0..100\"\n",
        RECORDINGS.drone.display()
    );
    let peer = Vehicle::start(folder.path(), "peer1", &[&anchor.endpoint], &tables);
    peer.wait(PATIENCE);
    let peer = summary(folder.path(), "peer1");
    let counted = |name: &str| peer["counters"][name].as_u64().unwrap();
    assert!(counted("chunks_pulled") >= 8, "{peer}");
    assert!(counted("chunks_received") >= 8, "{peer}");
    assert_eq!(counted("equivocations") + counted("malformed"), 0, "{peer}");
}

#[test]
fn a_peer_that_never_hears_an_anchor_says_so_and_why() {
    let folder = TempDir::new().unwrap();
    let tables = format!(
        "[camera]\ndataset = \"{}@0..60\"\n",
        RECORDINGS.drone.display()
    );
    Vehicle::start(folder.path(), "peer1", &[], &tables).wait(PATIENCE);
    let peer = summary(folder.path(), "peer1");
    assert_eq!(peer["state"], "LocalUnscaled", "{peer}");
    assert_eq!(peer["reason"], "no anchor heard yet");
    assert_eq!(peer["global_share"], 0.0);
    assert_eq!(peer["scale"], serde_json::Value::Null);
}

#[test]
fn an_outside_client_lists_maps_and_exports_points() {
    let folder = TempDir::new().unwrap();
    let anchor = anchor(folder.path());
    wait_for_chunks(&anchor.endpoint, 5);
    // Placed points need a georeference, which takes the anchor a few more seconds.
    let cloud = folder.path().join("map.ply");
    let export = || {
        starling()
            .args([
                "map",
                "get",
                "anchor/*/map",
                "--connect",
                &anchor.endpoint,
                "--out",
            ])
            .arg(&cloud)
            .output()
            .unwrap()
            .status
            .success()
    };
    let exported = (0..20).any(|_| {
        std::thread::sleep(Duration::from_millis(500));
        export()
    });
    assert!(exported && cloud.metadata().unwrap().len() > 1000);
    list_with_python(&anchor.endpoint);
    // Ended by hand, it leaves everything behind that it would at the end of its recording.
    anchor.interrupt();
    anchor.wait(PATIENCE);
    let anchor = summary(folder.path(), "anchor1");
    assert_eq!(anchor["state"], "Global", "{anchor}");
    let corrected = std::fs::read_to_string(folder.path().join("anchor1.final.tum")).unwrap();
    assert!(corrected.lines().count() > 10);
}

/// The same from Python, where it is there with what it needs.
fn list_with_python(endpoint: &str) {
    let imports = ["-c", "import zenoh, cbor2, numpy"];
    let present = Command::new("python3").args(imports).output();
    if !present.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no python3 with eclipse-zenoh, cbor2 and numpy");
        return;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/list_maps.py");
    let output = succeed(Command::new("python3").arg(script).arg(endpoint));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("chunks; held by anchor1"), "{text}");
    assert!(text.contains("points in the keyframe's camera"), "{text}");
}

//! Goal: input that is lost is named, counted, and shows in the exit code. Method: spoil what a
//! vehicle is given, and compare with the same flight unspoilt.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;

use serde_json::Value;
use sim::stream::{Message, write_message};
use tempfile::TempDir;

use crate::processes::{starling, summary, team_of};
use crate::recordings::RECORDINGS;

/// Flies the first second of the ground vehicle alone: exit code, JSON and diagnostics.
fn fly(fixes: &Path) -> (Option<i32>, Value, String) {
    let folder = TempDir::new().unwrap();
    let anchor = format!("{}@0..10", RECORDINGS.ground.display());
    let output = team_of(anchor, fixes, folder.path()).output().unwrap();
    (
        output.status.code(),
        serde_json::from_slice(&output.stdout).unwrap_or_default(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn skipped_fixes_are_named_counted_and_a_loss() {
    let (code, json, diagnostics) = fly(&RECORDINGS.fixes);
    assert_eq!(code, Some(0), "{diagnostics}");
    assert_eq!(json["ok"], true);
    assert_eq!(json["vehicles"][0]["skipped_fixes"], 0);

    let folder = TempDir::new().unwrap();
    let path = folder.path().join("spoilt.tum");
    let good = fs::read_to_string(&RECORDINGS.fixes).unwrap();
    let mut lines: Vec<&str> = good.lines().collect();
    lines.insert(2, "0.05 nan 1 2 0 0 0 1");
    lines.insert(3, "4000000000 0 1 2 0 0 0 1");
    fs::write(&path, lines.join("\n")).unwrap();
    let (code, json, diagnostics) = fly(&path);
    assert_eq!(code, Some(3), "{diagnostics}");
    assert_eq!(json["ok"], false);
    assert_eq!(json["vehicles"][0]["skipped_fixes"], 2);
    for part in [
        "anchor1",
        "spoilt.tum",
        "no fix: line 3",
        "out of order: line 4",
    ] {
        assert!(diagnostics.contains(part), "{part}: {diagnostics}");
    }

    fs::write(&path, "-7 0 1 2\n-5 0 1 2\n").unwrap();
    let (code, _, diagnostics) = fly(&path);
    assert_eq!(code, Some(1), "{diagnostics}");
    assert!(diagnostics.contains("the fixes span -7.0"), "{diagnostics}");
}

#[test]
fn a_stream_that_breaks_off_is_an_error_with_its_endpoint() {
    let folder = TempDir::new().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let driver = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        write_message(&mut stream, &Message::Hello).unwrap();
        stream
            .write_all(b"HTTP/1.1 400 Bad Request, says someone")
            .unwrap();
        // Until the vehicle has closed.
        let _ = stream.read_to_end(&mut Vec::new());
    });
    let calibration = RECORDINGS.drone.join("camera.yaml");
    let config = folder.path().join("v.toml");
    let text = format!(
        "id = \"v\"\nout = {:?}\n[camera]\nstream = {address:?}\ncalibration = {calibration:?}\n\
         [zenoh]\nlisten = [\"tcp/127.0.0.1:0\"]\n",
        folder.path()
    );
    fs::write(&config, text).unwrap();
    let run = starling().args(["run", "--config"]).arg(&config).output();
    driver.join().unwrap();
    let output = run.unwrap();
    let diagnostics = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{diagnostics}");
    assert!(diagnostics.contains(&address), "{diagnostics}");
    assert!(diagnostics.contains("message starts with"), "{diagnostics}");
    let vehicle = summary(folder.path(), "v");
    assert_eq!(vehicle["frame_count"], 0, "{vehicle}");
    assert!(folder.path().join("v.final.tum").is_file());
}

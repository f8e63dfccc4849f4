//! Exit codes and errors that a person can act on.

use std::fs;

use tempfile::TempDir;

use crate::processes::starling;
use crate::recordings::RECORDINGS;

fn check(arguments: &[&str], code: i32, expected: &str) {
    let output = starling().args(arguments).output().unwrap();
    let diagnostics = String::from_utf8_lossy(&output.stderr);
    assert_eq!(
        output.status.code(),
        Some(code),
        "{arguments:?}: {diagnostics}"
    );
    assert!(
        diagnostics.contains(expected),
        "{arguments:?}: {diagnostics}"
    );
}

#[test]
fn commands_end_with_the_codes_of_the_contract() {
    check(&["swarm", "--drones", "0", "--out", "s"], 2, "--drones");
    check(&["no-such-command"], 2, "unrecognized subcommand");
    check(&["team", "--out", "o"], 2, "--anchor");
    check(
        &["team", "--out", "o", "--fixes", "f", "--anchor", "a"],
        2,
        "--fixes f follows no --anchor",
    );
    check(
        &[
            "team", "--out", "o", "--anchor", "a", "--fixes", "f", "--outage", "x:1..2",
        ],
        2,
        "not in the team",
    );
    for (option, value) in [
        ("--threads", "0"),
        ("--fix-noise-m", "nan"),
        ("--fix-noise-m", "-1"),
        ("--fix-noise-m", "2000"),
    ] {
        let team = ["team", "--out", "o", "--anchor", "a", "--fixes", "f"];
        check(&[&team[..], &[option, value]].concat(), 2, option);
    }
    check(
        &["slam", "d", "--out", "o", "--threads", "0"],
        2,
        "--threads",
    );
    check(
        &["config", "check"],
        1,
        "`starling config check` is not built yet",
    );
    check(
        &["map", "get", "anchor/*/map?bbox=1"],
        2,
        "east_min,north_min",
    );
    check(
        &["map", "get", "anchor/*/map", "--out", "x.las"],
        1,
        ".las is not built yet",
    );
    // A file stands where the folder should be; the vehicles are not looked at.
    let file = file!().rsplit_once('/').unwrap().1;
    let out = format!("{}/tests/team/{file}", env!("CARGO_MANIFEST_DIR"));
    let team = ["team", "--anchor", "a", "--fixes", "f", "--out", &out];
    check(&team, 1, "this is a file, expected a folder");
    check(&["demo", "--headless", "--out", &out], 1, "this is a file");
    check(
        &["run", "--config", "no-such-file.toml"],
        1,
        "no-such-file.toml",
    );
    let nobody = ["map", "get", "anchor/*/map", "--connect", "tcp/127.0.0.1:9"];
    check(
        &nobody,
        1,
        "cannot connect to tcp/127.0.0.1:9; is a starling vehicle up there?\n",
    );
}

#[test]
fn bad_input_is_named_with_its_place() {
    let folder = TempDir::new().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let run = |name: &str, tables: &str, code: i32, expected: &str| {
        let path = folder.path().join(name);
        let head = format!("id = \"v\"\nout = {:?}\n", folder.path());
        fs::write(&path, head + tables).unwrap();
        check(&["run", "--config", path.to_str().unwrap()], code, expected);
    };
    let camera = format!(
        "[camera]\ndataset = \"{}@0..5\"\n",
        RECORDINGS.drone.display()
    );
    let zenoh = format!("{camera}[zenoh]\nlisten = [\"tcp/127.0.0.1:{port}\"]\n");
    let expected = format!("cannot listen on tcp/127.0.0.1:{port}: port in use");
    run("port.toml", &zenoh, 1, &expected);
    let empty = folder.path().join("no-fixes.tum");
    fs::write(&empty, "0.0 nan 1 2 0 0 0 1\n").unwrap();
    let position = format!("{camera}[position]\nfile = {empty:?}\n");
    run("fixes.toml", &position, 1, "no usable line of 1");
    run(
        "missing.toml",
        "[camera]\ndataset = \"nowhere\"\n",
        1,
        "nowhere",
    );
    let stream = "[camera]\nstream = \"127.0.0.1:9\"\ncalibration = \"no.yaml\"\n";
    run("calibration.toml", stream, 1, "no.yaml");
}

/// A person or a parent that cannot be told anything still gets the exit code.
#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_said_changes_no_exit_code() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().to_str().unwrap();
    let end = |arguments: &[&str]| {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let output = starling().args(arguments).stderr(full).output().unwrap();
        output.status.code()
    };
    assert_eq!(end(&["slam", "nope", "--out", out]), Some(1));
    assert_eq!(end(&["no-such-command"]), Some(2));
    let config = folder.path().join("v.toml");
    let dataset = RECORDINGS.ground.display();
    let fixes = folder.path().join("fixes.tum");
    let given = fs::read_to_string(&RECORDINGS.fixes).unwrap();
    fs::write(&fixes, format!("{given}0.0 nan 1 2 0 0 0 1\n")).unwrap();
    let text = format!(
        "id = \"v\"\nout = {out:?}\n[camera]\ndataset = \"{dataset}@0..2\"\n\
         [position]\nfile = {fixes:?}\n[zenoh]\nlisten = [\"tcp/127.0.0.1:0\"]\n"
    );
    fs::write(&config, text).unwrap();
    // The vehicle warns of the bad fix through the log, and of its loss at the end.
    assert_eq!(end(&["run", "--config", config.to_str().unwrap()]), Some(3));
}

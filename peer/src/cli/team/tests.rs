use clap::{Args, FromArgMatches};

use super::*;

/// The vehicle's id, its calibration and its topic.
type Planned = (String, Option<PathBuf>, Option<String>);

fn planned(line: &str) -> anyhow::Result<Vec<Planned>> {
    let command = TeamArguments::augment_args(clap::Command::new("team"));
    let words = format!("team --out o {line}");
    let order = command.try_get_matches_from(words.split_whitespace())?;
    let arguments = TeamArguments::from_arg_matches(&order)?;
    let vehicles = plan(&arguments, &order)?.vehicles.into_iter();
    Ok(vehicles
        .map(|one| (one.id, one.recording.calibration, one.recording.topic))
        .collect())
}

#[test]
fn calibrations_and_topics_belong_to_the_recording_before_them() {
    let line = "--peer p1 --topic /left --anchor a1 --fixes f1 --peer p2 --calibration c2 \
                --anchor a2 --calibration c1 --fixes f2 --topic /right";
    let vehicles = planned(line).unwrap();
    let file = |name: &str| Some(PathBuf::from(name));
    let topic = |name: &str| Some(name.to_owned());
    let expected = [
        ("anchor1".to_owned(), None, None),
        ("anchor2".to_owned(), file("c1"), topic("/right")),
        ("peer1".to_owned(), None, topic("/left")),
        ("peer2".to_owned(), file("c2"), None),
    ];
    assert_eq!(vehicles, expected);
}

#[test]
fn values_without_a_recording_before_them_are_refused() {
    let check = |line: &str, expected: &str| {
        let error = planned(line).unwrap_err().to_string();
        assert!(error.contains(expected), "{line}: {error}");
    };
    let anchor = "--anchor a --fixes f";
    let expected = "--calibration c follows no --anchor or --peer";
    check(&format!("--calibration c {anchor}"), expected);
    let expected = "--topic /b follows no --anchor or --peer";
    check(&format!("{anchor} --topic /a --topic /b"), expected);
    check(
        &format!("--fixes f2 {anchor}"),
        "--fixes f2 follows no --anchor",
    );
    check(
        "--anchor a --peer p --fixes f --anchor b",
        "each --anchor needs --fixes",
    );
}

/// Goal: a file of an earlier flight that is read is not written. Method: its trajectory as fixes.
#[test]
fn what_a_flight_reads_it_does_not_overwrite() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(
        path("0.pgm"),
        [b"P5 32 24 255\n", &[9; 32 * 24][..]].concat(),
    )
    .unwrap();
    std::fs::write(path("rgb.txt"), "0.5 0.pgm\n").unwrap();
    let camera = "intrinsics: [30, 30, 16, 12]\nresolution: [32, 24]\n";
    std::fs::write(path("camera.yaml"), camera).unwrap();
    std::fs::write(path("anchor1.tum"), "0.5 0 0 0 0 0 0 1\n").unwrap();
    let words = [
        "team",
        "--anchor",
        folder.path().to_str().unwrap(),
        "--fixes",
        path("./anchor1.tum").to_str().unwrap(),
        "--out",
        folder.path().to_str().unwrap(),
    ]
    .map(str::to_owned);
    let command = TeamArguments::augment_args(clap::Command::new("team"));
    let order = command.try_get_matches_from(words).unwrap();
    let arguments = TeamArguments::from_arg_matches(&order).unwrap();
    let error = run(&arguments, &order).unwrap_err();
    assert!(error.is::<crate::files::Clash>(), "{error}");
    assert!(
        error.to_string().contains("would overwrite the fixes"),
        "{error}"
    );
}

use super::*;

fn read(text: &str, noise_m: f64) -> Result<FixFile, PositionError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fixes.txt");
    std::fs::write(&path, text).unwrap();
    let config = PositionConfig {
        sigma_m: 0.1,
        noise_m,
        noise_seed: 3,
        ..PositionConfig::default()
    };
    read_fixes(&config, &path)
}

#[test]
fn orientations_are_not_read() {
    let plain = read("0.5 1 2 3\n", 0.0).unwrap();
    let turned = read("0.5 1 2 3 0.1 0.2 0.3 0.9\n", 0.0).unwrap();
    let nonsense = read("0.5 1 2 3 nan nan x y\n", 0.0).unwrap();
    assert_eq!(plain.fixes, turned.fixes);
    assert_eq!(plain.fixes, nonsense.fixes);
}

fn skipped(file: &FixFile) -> Vec<(usize, SkipReason)> {
    let skipped = file.skipped.iter();
    skipped.map(|one| (one.line, one.reason)).collect()
}

fn seconds(file: &FixFile) -> Vec<f64> {
    let fixes = file.fixes.iter();
    fixes.map(|fix| fix.captured_at.seconds()).collect()
}

#[test]
fn bad_lines_are_skipped_and_named_with_file_and_line() {
    use SkipReason::{Malformed, OtherFrame, OutOfOrder};
    let text = "# stamp\n0 1 2 3\n1 nan 2 3\n0.5 1 2 3\n0.5 1 2 3\n0.2 1 2 3\n2 1\n\
                nan 1 2 3\nx 1 2 3\n2.5,52,13,40\n3 1 2 3\n";
    let file = read(text, 0.0).unwrap();
    assert_eq!(seconds(&file), [0.0, 0.5, 3.0]);
    let expected = [
        (3, Malformed),
        (5, OutOfOrder),
        (6, OutOfOrder),
        (7, Malformed),
        (8, Malformed),
        (9, Malformed),
        (10, OtherFrame),
    ];
    assert_eq!(skipped(&file), expected);
    let warning = file.warning().unwrap();
    let expected = "skipped 7 of 10 fixes (no fix: lines 3, 7, 8, 9; out of order: \
                    lines 5, 6; of another kind of frame: line 10): ";
    assert!(warning.starts_with(expected), "{warning}");
    assert!(warning.ends_with("fixes.txt"), "{warning}");
    let many: String = (0..9).map(|idx| format!("{} 1 2 3\n", 9 - idx)).collect();
    let warning = read(&many, 0.0).unwrap().warning().unwrap();
    assert!(
        warning.contains("lines 2, 3, 4, 5, 6 and 3 more"),
        "{warning}"
    );
    assert!(read("nothing here\n", 0.0).is_err());
}

#[test]
fn a_wrong_stamp_costs_one_fix_wherever_it_is() {
    let check = |stamps: &[f64], expected: &[usize]| {
        let lines = stamps.iter().map(|stamp| format!("{stamp} 1 2 3\n"));
        let file = read(&lines.collect::<String>(), 0.0).unwrap();
        let lines: Vec<usize> = skipped(&file).iter().map(|(line, _)| *line).collect();
        assert_eq!(lines, expected, "{stamps:?}");
    };
    check(&[0.0, 1.0, 2.0, 3.0], &[]);
    check(&[0.0, 9e8, 2.0, 3.0, 4.0], &[2]);
    check(&[9e8, 1.0, 2.0, 3.0], &[1]);
    check(&[5.0, 6.0, 7.0, 0.5, 8.0], &[4]);
    check(&[1.0, 2.0, 2.0, 3.0], &[3]);
    check(&[4.0, 3.0, 2.0, 1.0], &[2, 3, 4]);
}

#[test]
fn a_good_file_has_nothing_skipped() {
    let texts = [
        "# timestamp tx ty tz\n0 1 2 3\n\n1 1 2 3\r\n",
        "\u{feff}timestamp,latitude_deg,longitude_deg,altitude_m\n0,52,13,40\n1,52,13,40\n",
        "timestamp tx ty tz\n0 1 2 3\n1 1 2 3\n",
    ];
    for text in texts {
        let file = read(text, 0.0).unwrap();
        assert_eq!((file.fixes.len(), file.warning()), (2, None), "{text:?}");
    }
}

#[test]
fn fixes_of_another_time_are_refused_with_both_spans() {
    let file = read("5 1 2 3\n6.5 1 2 3\n", 0.0).unwrap();
    let at = |seconds: f64| Timestamp::from_seconds(seconds).unwrap();
    assert_eq!(file.within(at(6.5), at(9.0)).unwrap().len(), 1);
    let error = file.within(at(7.0), at(9.0)).unwrap_err().to_string();
    let expected = "the fixes span 5.000000000..6.500000000 s, \
                    the recording 7.000000000..9.000000000 s";
    assert!(error.contains(expected), "{error}");
}

#[test]
fn reads_geodetic_positions_with_their_sigma() {
    let file = read(
        "timestamp,latitude_deg\n0,52.1,13.2,40\n1,52.1,13.2,40,0.5\n",
        0.0,
    );
    let fixes = file.unwrap().fixes;
    assert!((fixes[0].sigma_m() - 0.1).abs() < 1e-12);
    assert!((fixes[1].sigma_m() - 0.5).abs() < 1e-12);
    assert!(matches!(fixes[1].position, FixPosition::Geodetic(_)));
}

#[test]
fn noise_of_a_fix_depends_on_its_stamp_alone() {
    let all = read("0 1 2 3\n1 1 2 3\n2 1 2 3\n", 0.5).unwrap().fixes;
    let some = read("0 1 2 3\n2 1 2 3\n", 0.5).unwrap().fixes;
    assert_eq!(all[0], some[0]);
    assert_eq!(all[2], some[1]);
    assert_ne!(all[0].position, all[1].position);
}

use geometry::{Enu, Timestamp};

use super::*;

#[test]
fn reads_seconds_exactly() {
    let check = |text: &str, expected: Option<i64>| {
        let got = parse_seconds(text).map(Timestamp::nanoseconds);
        assert_eq!(got, expected, "{text:?}");
    };
    check("0.033333", Some(33_333_000));
    check("1403715273.262142976", Some(1_403_715_273_262_142_976));
    check("12", Some(12_000_000_000));
    check("-0.5", Some(-500_000_000));
    check(".25", Some(250_000_000));
    check("1.5e3", Some(1_500_000_000_000));
    for malformed in [
        "",
        ".",
        "-",
        "nan",
        "inf",
        "1.2.3",
        "0x10",
        "1_0",
        "99999999999999",
        "+-1",
    ] {
        check(malformed, None);
    }
}

#[test]
fn trajectory_keeps_its_stamps_to_the_nanosecond() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.tum");
    let line = "1403715273.262142976 1.000000000 -2.500000000 0.250000000 \
                0.000000000 0.000000000 0.707106781 0.707106781";
    let pose: StampedPose<Enu> = parse_tum_line(line).unwrap();
    write_tum(&path, [pose]).unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("{line}\n"));
    assert_eq!(read_tum::<Enu>(&path).unwrap().len(), 1);
}

#[test]
fn trajectory_errors_name_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.tum");
    let check = |text: &str, expected: &str| {
        std::fs::write(&path, text).unwrap();
        let error = read_tum::<Enu>(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(error.ends_with("t.tum:2"), "{error}");
    };
    check("# c\n0.1 1 2 3 0 0 0\n", "expected 8 numbers");
    check("# c\n0.1 1 2 nan 0 0 0 1\n", "\"nan\" is no finite number");
    check("# c\nx 1 2 3 0 0 0 1\n", "\"x\" is no time stamp");
    check("# c\n0.1 1 2 3 0 0 0 0\n", "norm is 0.0000");
    let missing = read_tum::<Enu>(&folder.path().join("none.tum")).unwrap_err();
    assert!(missing.to_string().starts_with("cannot read"), "{missing}");
}

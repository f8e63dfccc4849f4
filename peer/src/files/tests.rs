use std::path::Path;

use geometry::{Enu, Timestamp};
use nalgebra::{Matrix3, Vector3};
use registration::Descriptors;

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

#[test]
fn covariances_survive_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.csv");
    let covariance = Matrix3::new(1.0, 0.1, 1e-7, 0.1, 2.0, -0.3, 1e-7, -0.3, 3.0);
    let line = (Timestamp::from_nanoseconds(1_100_000_001), covariance);
    write_covariances(&path, [line, line]).unwrap();
    assert_eq!(read_covariances(&path).unwrap(), vec![line, line]);
    std::fs::write(&path, "1.0,1,2,3\n").unwrap();
    let error = read_covariances(&path).unwrap_err().to_string();
    assert!(error.starts_with("expected timestamp,xx"), "{error}");
}

/// Three points with colours and descriptors, all different.
fn small_cloud() -> PointCloud {
    PointCloud {
        points: (0..3)
            .map(|idx| Vector3::new(f64::from(idx), -0.5, 0.25 * f64::from(idx)))
            .collect(),
        colors: Some(vec![[1, 2, 3], [255, 0, 128], [9, 8, 7]]),
        descriptors: Descriptors::Binary(vec![
            features::Descriptor([1, 2, 3, u64::MAX]),
            features::Descriptor([0; 4]),
            features::Descriptor([5, 6, 7, 8]),
        ]),
    }
}

fn binary(cloud: &PointCloud) -> &[features::Descriptor] {
    match &cloud.descriptors {
        Descriptors::Binary(list) => list,
        _ => panic!("no binary descriptors"),
    }
}

#[test]
fn ply_survives_every_encoding() {
    let cloud = small_cloud();
    for encoding in [
        ply::Encoding::Ascii,
        ply::Encoding::BinaryLittleEndian,
        ply::Encoding::BinaryBigEndian,
    ] {
        let bytes = ply::format(&cloud, encoding);
        let read = ply::parse(&bytes).unwrap();
        assert_eq!(read.points, cloud.points, "{encoding:?}");
        assert_eq!(read.colors, cloud.colors, "{encoding:?}");
        assert_eq!(binary(&read), binary(&cloud), "{encoding:?}");
        // The last number of a text may lose digits unseen; everything else must be missed.
        let shortest_whole = match encoding {
            ply::Encoding::Ascii => bytes.len() - 3,
            _ => bytes.len(),
        };
        for length in 0..shortest_whole {
            assert!(
                ply::parse(&bytes[..length]).is_err(),
                "{encoding:?} {length}"
            );
        }
    }
}

#[test]
fn ply_keeps_histograms() {
    let histograms: Vec<[u8; 128]> = (0..3).map(|idx| [idx * 7; 128]).collect();
    let cloud = PointCloud {
        descriptors: Descriptors::Histogram(histograms.clone()),
        ..small_cloud()
    };
    let bytes = ply::format(&cloud, ply::Encoding::BinaryLittleEndian);
    let Descriptors::Histogram(read) = ply::parse(&bytes).unwrap().descriptors else {
        panic!("128 bytes are a histogram");
    };
    assert_eq!(read, histograms);
}

#[test]
fn archives_are_read_and_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let error = write_cloud(&path, &small_cloud()).unwrap_err().to_string();
    assert!(error.contains(".csv or .txt: "), "{error}");
    std::fs::write(&path, "nothing").unwrap();
    let error = read_cloud(&path).unwrap_err().to_string();
    assert!(error.starts_with("not an NPZ file"), "{error}");
}

#[test]
fn ply_skips_what_it_does_not_know() {
    let text = "ply\r\nformat ascii 1.0\r\ncomment hello\r\nobj_info x\r\n\
                element camera 1\r\nproperty list uchar int views\r\n\
                element vertex 2\r\nproperty double x\r\nproperty float32 nx\r\n\
                property double y\r\nproperty double z\r\n\
                element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\
                3 1 2 3\r\n1 9 2 3\r\n4 9 5 6\r\n3 0 1 1\r\n";
    let cloud = ply::parse(text.as_bytes()).unwrap();
    assert_eq!(cloud.points[1], Vector3::new(4.0, 5.0, 6.0));
    assert!(cloud.colors.is_none() && matches!(cloud.descriptors, Descriptors::None));
}

#[test]
fn pcd_survives_and_reads_text() {
    let cloud = small_cloud();
    let bytes = pcd::format(&cloud);
    let read = pcd::parse(&bytes).unwrap();
    assert_eq!((read.points, read.colors), (cloud.points, cloud.colors));
    for length in 0..bytes.len() {
        assert!(pcd::parse(&bytes[..length]).is_err(), "{length}");
    }
    let text = "VERSION .7\nFIELDS x y z intensity rgb\nSIZE 4 4 4 2 4\nTYPE F F F U F\n\
                COUNT 1 1 1 2 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n\
                1 2 nan 7 8 2.34180515e-38\n";
    let read = pcd::parse(text.as_bytes()).unwrap();
    assert_eq!(read.points[0].xy(), nalgebra::Vector2::new(1.0, 2.0));
    // The bits of the float are 0x00ff0000.
    assert_eq!(read.colors.unwrap(), vec![[255, 0, 0]]);
    assert_eq!(read.points.len(), 1);
}

#[test]
fn text_clouds_may_name_their_columns() {
    let check = |text: &str, expected: [f64; 3]| {
        let cloud = xyz::parse(text.as_bytes()).unwrap();
        assert_eq!(
            *cloud.points.last().unwrap(),
            Vector3::from(expected),
            "{text:?}"
        );
    };
    check("1 2 3\n", [1.0, 2.0, 3.0]);
    check("# note\n 1.5e0   2  3 9\n", [1.5, 2.0, 3.0]);
    check("x,y,z,nx\n-3.5 , 0.6 , -1.3 , 1\n", [-3.5, 0.6, -1.3]);
    check("id;Z;Y;X\n7;3;2;1\n", [1.0, 2.0, 3.0]);
    assert_eq!(
        xyz::parse(&xyz::format(&small_cloud())).unwrap().points,
        small_cloud().points
    );
}

/// Expects the error of reading `text` under a name to end like this, `FILE` being the path.
fn check_refused(name: &str, text: &str, expected: &str) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    let error = read_cloud(&path).unwrap_err().to_string();
    let expected = expected.replace("FILE", &path.display().to_string());
    assert!(
        error.ends_with(&expected),
        "got {error:?}, expected {expected:?}"
    );
}

#[test]
fn text_clouds_that_cannot_be_read_name_file_and_line() {
    let check = check_refused;
    check("a.xyz", "1 2 3\n1 2\n", "2 columns, expected 3 at FILE:2");
    check("a.xyz", "1 2 3\n1 2 x\n", "\"x\" is no number at FILE:2");
    check(
        "a.csv",
        "a,b,c\n1,2,3\n",
        "got [\"a\", \"b\", \"c\"] at FILE:1",
    );
    check("a.txt", "1 2\n", "2 columns, expected 3 at FILE:1");
    check("a.xyz", "# nothing\n", "holds no points: FILE");
    check("a.las", "", ".xyz, .csv, .txt or .npz: FILE");
    let missing = read_cloud(Path::new("/no/such/file.ply")).unwrap_err();
    assert!(missing.to_string().starts_with("cannot read"), "{missing}");
}

#[test]
fn ply_that_cannot_be_read_names_file_and_line() {
    let check = |text: &str, expected: &str| check_refused("a.ply", text, expected);
    check("hello", "does not begin with `ply` at FILE:1");
    check(
        "ply\nformat binary_little_endian 1.0\nelement x 99999999999\nend_header\n",
        "element \"x\" has no properties: FILE",
    );
    check(
        "ply\nformat ascii 1.0\nend_header\n",
        "names no element `vertex`: FILE",
    );
    let header = "ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\n\
                  property float y\nproperty float z\nend_header\n";
    let body = |rows: &str| format!("{header}{rows}\n");
    check(&body("1 2"), "truncated: too few numbers at FILE:8");
    check(&body("1 2 3 4"), "\"4\" after the last number at FILE:8");
    check(&body("1 2 x"), "\"x\" is no number at FILE:8");
    check(
        &body("1 2 3"),
        "truncated before vertex 1 of 99999999999 at FILE:9",
    );
    let half = header.replace("float x", "half x");
    check(&half, "unknown type \"half\" at FILE:4");
    let lists = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                 property float z\nproperty list uchar uchar descriptor\nend_header\n\
                 1 2 3 1 9\n1 2 3 1 9\n";
    check(lists, "all have 32 or all have 128 bytes: FILE");
}

#[test]
fn pcd_that_cannot_be_read_names_file_and_line() {
    let check = |text: &str, expected: &str| check_refused("a.pcd", text, expected);
    check("hello", "unknown header line \"hello\" at FILE:1");
    check(
        "FIELDS x y\nSIZE 4\nTYPE F F\nDATA ascii\n",
        "do not agree at FILE:4",
    );
    check(
        "DATA binary_compressed\n",
        "DATA binary_compressed is not supported at FILE:1",
    );
    let header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 2\nDATA ascii\n";
    check(
        &format!("{header}1 2 3\n4 5\n"),
        "2 numbers, expected 3 at FILE:7",
    );
    check(
        &format!("{header}1 2 3\n"),
        "truncated before point 1 of 2: FILE",
    );
}

#[test]
fn a_cloud_written_under_a_name_is_read_under_it() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.ply", "a.pcd", "a.xyz", "a.CSV"] {
        let path = folder.path().join(name);
        write_cloud(&path, &small_cloud()).unwrap();
        assert_eq!(
            read_cloud(&path).unwrap().points,
            small_cloud().points,
            "{name}"
        );
    }
    assert_eq!(small_cloud().into_cloud().points().len(), 3);
}

proptest::proptest! {
    #[test]
    fn no_bytes_make_a_reader_panic(
        header in 0..4_usize,
        bytes in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..200),
    ) {
        let headers: [&[u8]; 4] = [
            b"",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty list int int a\n\
              property float x\nproperty float y\nproperty float z\nend_header\n",
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 9\nDATA binary\n",
            b"FIELDS x\nSIZE ",
        ];
        let file = [headers[header], &bytes].concat();
        let _ = (ply::parse(&file), pcd::parse(&file), xyz::parse(&file), npz::parse(&file));
    }
}

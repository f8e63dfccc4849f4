use super::*;

/// An array as `numpy.save` writes it.
fn npy(kind: &str, shape: &str, by_columns: bool, body: &[u8]) -> Vec<u8> {
    let order = if by_columns { "True" } else { "False" };
    let header = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(body);
    file
}

fn npz(arrays: &[(&str, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let (mut file, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in arrays {
        let name = format!("{name}.npy");
        let packed = if deflated {
            miniz_oxide::deflate::compress_to_vec(content, 6)
        } else {
            content.clone()
        };
        let mut sizes = crc32fast::hash(content).to_le_bytes().to_vec();
        sizes.extend((packed.len() as u32).to_le_bytes());
        sizes.extend((content.len() as u32).to_le_bytes());
        sizes.extend((name.len() as u16).to_le_bytes());
        sizes.extend(0_u16.to_le_bytes());
        let method = [if deflated { 8 } else { 0 }, 0];
        directory.extend(b"PK\x01\x02\x14\0\x14\0\0\0");
        directory.extend(method);
        directory.extend([0; 4]);
        directory.extend(&sizes);
        directory.extend([0; 10]);
        directory.extend((file.len() as u32).to_le_bytes());
        directory.extend(name.as_bytes());
        file.extend(b"PK\x03\x04\x14\0\0\0");
        file.extend(method);
        file.extend([0; 4]);
        file.extend(&sizes);
        file.extend(name.as_bytes());
        file.extend(packed);
    }
    let start = file.len() as u32;
    file.extend(&directory);
    file.extend(b"PK\x05\x06\0\0\0\0");
    file.extend([arrays.len() as u8, 0, arrays.len() as u8, 0]);
    file.extend((directory.len() as u32).to_le_bytes());
    file.extend(start.to_le_bytes());
    file.extend([0, 0]);
    file
}

fn floats(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

const POINTS: [f32; 6] = [1.0, 2.0, 3.0, -4.0, 5.5, 6.0];

fn points() -> Vec<u8> {
    npy("<f4", "(2, 3)", false, &floats(&POINTS))
}

#[test]
fn points_colors_and_descriptors_are_found() {
    let histograms: Vec<u8> = (0..=255).collect();
    for deflated in [false, true] {
        let bytes = npz(
            &[
                ("n_obs", npy("|u1", "(2,)", false, &[3, 4])),
                ("note", npy("<U5", "()", false, &[0; 20])),
                ("xyz", points()),
                ("rgb", npy("|u1", "(2, 3)", false, &[1, 2, 3, 4, 5, 6])),
                ("sift_mean", npy("|u1", "(2, 128)", false, &histograms)),
            ],
            deflated,
        );
        let cloud = parse(&bytes).unwrap();
        assert_eq!(cloud.points[1], Vector3::new(-4.0, 5.5, 6.0));
        assert_eq!(cloud.colors.as_ref().unwrap()[1], [4, 5, 6]);
        let Descriptors::Histogram(list) = &cloud.descriptors else {
            panic!("histograms of 128 bytes");
        };
        assert_eq!((list[1][0], list[1][127]), (128, 255));
        for length in 0..bytes.len() {
            assert!(parse(&bytes[..length]).is_err(), "{length}");
        }
    }
}

#[test]
fn any_layout_of_numbers_is_read() {
    let by_columns = [1.0, -4.0, 2.0, 5.5, 3.0, 6.0_f64];
    let big: Vec<u8> = by_columns
        .iter()
        .flat_map(|one| one.to_be_bytes())
        .collect();
    let small: Vec<u8> = [1_i16, 2, 3, -4, 5, 6]
        .iter()
        .flat_map(|one| one.to_le_bytes())
        .collect();
    let cloud = parse(&npz(&[("any", npy(">f8", "(2, 3)", true, &big))], true)).unwrap();
    assert_eq!(cloud.points[1], Vector3::new(-4.0, 5.5, 6.0));
    let cloud = parse(&npz(
        &[("points", npy("<i2", "(2, 3)", false, &small))],
        true,
    ))
    .unwrap();
    assert_eq!(cloud.points[1], Vector3::new(-4.0, 5.0, 6.0));
}

#[test]
fn what_is_wrong_is_named() {
    let check = |arrays: &[(&str, Vec<u8>)], expected: &str| {
        let refused = parse(&npz(arrays, false)).unwrap_err();
        let error = refused
            .into_error(std::path::Path::new("a.npz"))
            .to_string();
        assert!(error.contains(expected), "{error}");
    };
    let bytes = |shape: &str, count: usize| npy("|u1", shape, false, &vec![0; count]);
    check(&[], "no array `xyz`");
    check(&[("xyz", bytes("(6,)", 6))], "has shape [6]");
    check(&[("a", points()), ("b", points())], "a, b; name one `xyz`");
    check(
        &[("xyz", points()), ("d", bytes("(1, 32)", 32))],
        "1 descriptors for 2 points",
    );
    let twice = [
        ("xyz", points()),
        ("d", bytes("(2, 32)", 64)),
        ("e", bytes("(2, 128)", 256)),
    ];
    check(&twice, "d, e; keep one");
    check(&[("xyz", bytes("(9, 3)", 26))], "truncated");
    check(&[("xyz", b"nothing".to_vec())], "no NPY array");
    let huge = npy("<f8", "(99999999999999999999, 3)", false, &[]);
    check(&[("xyz", huge)], "no shape");
    let mut damaged = npz(&[("xyz", points())], false);
    let last = damaged.len() - 120;
    damaged[last] ^= 1;
    assert!(parse(&damaged).is_err());
}

/// Goal: members that fit one by one, but not together, are refused before they are unpacked.
#[test]
fn archives_that_unpack_to_too_much_are_refused() {
    let mut bytes = npz(&[("a", points()), ("b", points()), ("c", points())], true);
    let entries: Vec<usize> = (0..bytes.len())
        .filter(|place| bytes[*place..].starts_with(b"PK\x01\x02"))
        .collect();
    assert_eq!(entries.len(), 3);
    for entry in entries {
        bytes[entry + 24..entry + 28].copy_from_slice(&0x7fff_ffff_u32.to_le_bytes());
    }
    let refused = parse(&bytes).unwrap_err();
    let error = refused
        .into_error(std::path::Path::new("a.npz"))
        .to_string();
    assert!(error.contains("unpacks to"), "{error}");
}

/// Goal: no damage makes the reader panic. Method: each byte in turn is changed.
#[test]
fn damage_is_refused_or_read() {
    let bytes = npz(
        &[
            ("xyz", points()),
            ("d", npy("|u1", "(2, 32)", false, &[7; 64])),
        ],
        true,
    );
    for place in 0..bytes.len() {
        for change in [1, 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[place] ^= change;
            let _ = parse(&damaged);
        }
    }
}

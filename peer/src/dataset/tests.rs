use std::fs;
use std::path::Path;

use tempfile::TempDir;

use super::*;

const CAMERA: &str = "intrinsics: [30, 30, 16, 12]\nresolution: [32, 24]\n";

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

fn png_bytes(
    size: (u32, u32),
    color: png::ColorType,
    depth: png::BitDepth,
    pixels: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
    encoder.set_color(color);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(pixels).unwrap();
    writer.finish().unwrap();
    bytes
}

fn grey_png(width: u32, height: u32, shade: u8) -> Vec<u8> {
    let pixels = vec![shade; (width * height) as usize];
    png_bytes(
        (width, height),
        png::ColorType::Grayscale,
        png::BitDepth::Eight,
        &pixels,
    )
}

/// Four frames of growing shade in TUM RGB-D layout.
fn tum_folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut list = "# timestamp filename\n".to_owned();
    for idx in 0..4_u8 {
        list += &format!("{idx}.100000 rgb/{idx}.png\n");
        write(
            folder.path(),
            &format!("rgb/{idx}.png"),
            grey_png(32, 24, 10 * idx),
        );
    }
    write(folder.path(), "rgb.txt", list);
    write(folder.path(), "camera.yaml", CAMERA);
    folder
}

fn open(folder: &Path, range: &str) -> Result<Dataset, DatasetError> {
    let text = format!("{}{range}", folder.display());
    Dataset::open(&text.parse().unwrap())
}

fn refusal(folder: &Path) -> String {
    open(folder, "").unwrap_err().to_string()
}

fn shades(mut camera: DatasetCamera) -> Vec<(usize, i64, u8)> {
    std::iter::from_fn(|| camera.next_event())
        .filter_map(|event| match event {
            CameraEvent::Frame(frame) => Some((
                frame.frame_idx,
                frame.captured_at.nanoseconds(),
                frame.image.get(5, 5),
            )),
            CameraEvent::Unreadable { .. } => None,
        })
        .collect()
}

#[test]
fn reads_a_part_of_a_tum_folder_the_same_way_inline_and_ahead() {
    let folder = tum_folder();
    let expected = vec![(1, 1_100_000_000, 10), (2, 2_100_000_000, 20)];
    let dataset = open(folder.path(), "@1..3").unwrap();
    assert_eq!(dataset.layout(), Some(Layout::TumRgbd));
    assert_eq!(dataset.calibration().camera.width(), 32);
    assert_eq!(shades(DatasetCamera::inline(dataset.clone())), expected);
    assert_eq!(shades(DatasetCamera::decoding_ahead(dataset)), expected);
}

#[test]
fn a_reader_may_stop_early_while_decoding_runs_ahead() {
    let folder = tum_folder();
    let mut camera = DatasetCamera::decoding_ahead(open(folder.path(), "").unwrap());
    assert!(camera.next_event().is_some());
    drop(camera);
}

#[test]
fn ranges_are_half_open_and_their_ends_may_be_left_out() {
    let folder = tum_folder();
    let check = |range: &str, expected: &[usize]| {
        let dataset = open(folder.path(), range).unwrap();
        let got: Vec<usize> = dataset
            .frames()
            .iter()
            .map(|frame| frame.frame_idx)
            .collect();
        assert_eq!(got, expected, "{range}");
    };
    check("", &[0, 1, 2, 3]);
    check("@1..3", &[1, 2]);
    check("@2..", &[2, 3]);
    check("@..2", &[0, 1]);
    check("@3..99", &[3]);
    for malformed in ["x@3..3", "x@3..1", "x@-1..2", "x@a..b", "x@1...3"] {
        assert!(malformed.parse::<DatasetArgument>().is_err(), "{malformed}");
    }
    let with_at: DatasetArgument = "some@folder".parse().unwrap();
    assert_eq!((with_at.path, with_at.range), ("some@folder".into(), None));
    let error = open(folder.path(), "@9..12").unwrap_err().to_string();
    assert!(
        error.starts_with("frames 9..12 of a recording of 4"),
        "{error}"
    );
}

#[test]
fn refuses_recordings_that_cannot_be_used_and_says_why() {
    let check = |break_it: &dyn Fn(&Path), expected: &str| {
        let folder = tum_folder();
        break_it(folder.path());
        let error = refusal(folder.path());
        assert!(
            error.contains(expected),
            "got {error:?}, expected {expected:?}"
        );
    };
    check(
        &|path| fs::remove_file(path.join("rgb.txt")).unwrap(),
        "none of rgb.txt",
    );
    check(
        &|path| write(path, "rgb.txt", "rgb/0.png\n"),
        "expected `timestamp path`",
    );
    check(
        &|path| write(path, "rgb.txt", "a rgb/0.png\n"),
        "no time stamp in seconds",
    );
    check(
        &|path| write(path, "rgb.txt", "# none\n"),
        "lists no images",
    );
    check(
        &|path| write(path, "rgb.txt", "2 rgb/0.png\n2 rgb/1.png\n"),
        "time stamp 2.000000000 is not after the one before, 2.000000000",
    );
    check(
        &|path| write(path, "rgb.txt", b"\xff\xfe\x00"),
        "cannot read",
    );
    check(
        &|path| fs::remove_file(path.join("camera.yaml")).unwrap(),
        "no calibration",
    );
    check(
        &|path| write(path, "camera.yaml", "hello"),
        "calibration refused",
    );
    check(
        &|path| write(path, "camera.yaml", CAMERA.replace("[32, 24]", "[64, 48]")),
        "the calibration is for 64×48, the images have 32×24",
    );
    check(
        &|path| (0..4).for_each(|idx| write(path, &format!("rgb/{idx}.png"), "no image")),
        "no image could be decoded, of 4; the first: neither PNG, JPEG, PGM nor PPM",
    );
    check(
        &|path| {
            let whole = grey_png(32, 24, 9);
            for idx in 0..4 {
                write(path, &format!("rgb/{idx}.png"), &whole[..whole.len() - 20]);
            }
        },
        "no image could be decoded, of 4; the first: damaged PNG",
    );
    assert!(refusal(Path::new("/no/such/folder")).contains("no such file or folder"));
    assert!(refusal(Path::new(file!())).contains("no such file or folder"));
}

#[test]
fn a_calibration_may_be_given_and_must_fit_the_images() {
    let folder = tum_folder();
    fs::remove_file(folder.path().join("camera.yaml")).unwrap();
    let open = |name: &str, text: &str| {
        write(folder.path(), name, text);
        let options = RecordingOptions {
            calibration: Some(folder.path().join(name)),
            ..RecordingOptions::default()
        };
        let argument = folder.path().display().to_string().parse().unwrap();
        Dataset::open_with(&argument, &options)
    };
    assert!(open("fits.yaml", CAMERA).is_ok());
    let kalibr = include_str!("../../../algorithms/camera/src/calibration/tests/kalibr_ds.yaml");
    let check = |text: &str, expected: &[&str]| {
        let error = open("other.yaml", text).unwrap_err().to_string();
        for part in expected {
            assert!(error.contains(part), "{error:?} lacks {part:?}");
        }
    };
    check(kalibr, &["512×512", "32×24", "other.yaml", "rgb/0.png"]);
    let sized = |size: &str| CAMERA.replace("[32, 24]", size);
    let hint = "32×24 (it looks like another resolution";
    check(&sized("[64, 48]"), &["64×48", hint]);
    check(
        "intrinsics: [60, 60, 64, 48]\nresolution: [128, 96]\n",
        &["128×96", hint],
    );
    check(
        "intrinsics: [30, 30, 12, 16]\nresolution: [24, 32]\n",
        &["turned by a quarter"],
    );
}

#[test]
fn an_odd_first_image_is_one_unreadable_image() {
    let folder = tum_folder();
    write(folder.path(), "rgb/0.png", grey_png(16, 12, 9));
    let dataset = open(folder.path(), "").unwrap();
    assert_eq!(dataset.calibration().camera.width(), 32);
    let images = shades(DatasetCamera::inline(dataset));
    assert_eq!(
        images.iter().map(|image| image.0).collect::<Vec<_>>(),
        [1, 2, 3]
    );
}

#[test]
fn images_that_do_not_decode_are_skipped_and_named() {
    let folder = tum_folder();
    let whole = grey_png(32, 24, 9);
    write(folder.path(), "rgb/0.png", &whole[..whole.len() / 2]);
    write(folder.path(), "rgb/2.png", grey_png(16, 12, 9));
    fs::remove_file(folder.path().join("rgb/3.png")).unwrap();
    let mut camera = DatasetCamera::inline(open(folder.path(), "").unwrap());
    let mut unreadable = Vec::new();
    while let Some(event) = camera.next_event() {
        if let CameraEvent::Unreadable { error, .. } = event {
            unreadable.push(error.to_string());
        }
    }
    assert_eq!(unreadable.len(), 3);
    assert!(unreadable[0].contains("damaged PNG"), "{}", unreadable[0]);
    assert!(
        unreadable[1].contains("image of 16×12"),
        "{}",
        unreadable[1]
    );
    assert!(
        unreadable[2].contains("cannot read the file"),
        "{}",
        unreadable[2]
    );
    assert!(unreadable[2].ends_with("rgb/3.png"), "{}", unreadable[2]);
}

#[test]
fn decodes_every_kind_of_png_to_grey() {
    use png::{BitDepth, ColorType};
    let check = |color, depth, pixel: &[u8], expected: u8| {
        let image = decode_grey(&png_bytes((2, 1), color, depth, &pixel.repeat(2))).unwrap();
        assert_eq!(image.pixels(), [expected; 2], "{color:?} {depth:?}");
    };
    check(ColorType::Grayscale, BitDepth::Eight, &[77], 77);
    check(ColorType::Grayscale, BitDepth::Sixteen, &[77, 200], 77);
    check(ColorType::GrayscaleAlpha, BitDepth::Eight, &[77, 3], 77);
    check(ColorType::Rgb, BitDepth::Eight, &[255, 0, 0], 77);
    check(ColorType::Rgba, BitDepth::Eight, &[0, 0, 255, 9], 29);
    check(
        ColorType::Rgb,
        BitDepth::Sixteen,
        &[255, 1, 255, 2, 255, 3],
        255,
    );
}

/// A grey baseline JPEG of 16×8 pixels, black on the left, white on the right.
const JPEG: &[u8] = include_bytes!("tests/grey_16x8.jpg");

#[test]
fn decodes_jpeg_and_refuses_every_truncation() {
    let image = decode_grey(JPEG).unwrap();
    assert_eq!((image.width(), image.height()), (16, 8));
    assert!(image.get(2, 4) < 60 && image.get(13, 4) > 200, "{image:?}");
    for length in 0..JPEG.len() {
        assert!(decode_grey(&JPEG[..length]).is_err(), "{length} bytes");
    }
    let png = grey_png(32, 24, 7);
    for length in 0..png.len() - 12 {
        assert!(decode_grey(&png[..length]).is_err(), "{length} bytes");
    }
}

#[test]
fn reads_euroc_and_kitti_folders() {
    let euroc = tempfile::tempdir().unwrap();
    write(
        euroc.path(),
        "mav0/cam0/data.csv",
        "\u{feff}#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n",
    );
    write(
        euroc.path(),
        "mav0/cam0/data/1403636579763555584.png",
        grey_png(32, 24, 7),
    );
    write(euroc.path(), "mav0/cam0/sensor.yaml", CAMERA);
    for part in ["mav0", "mav0/cam0"] {
        let dataset = open(&euroc.path().join(part), "").unwrap();
        assert_eq!(dataset.layout(), Some(Layout::Euroc), "{part}");
    }
    let dataset = open(euroc.path(), "").unwrap();
    assert_eq!(dataset.layout(), Some(Layout::Euroc));
    assert_eq!(
        dataset.frames()[0].captured_at.nanoseconds(),
        1_403_636_579_763_555_584
    );
    assert_eq!(shades(DatasetCamera::inline(dataset))[0].2, 7);

    let kitti = tempfile::tempdir().unwrap();
    write(kitti.path(), "times.txt", "0.000000e+00\n1.037359e-01\n");
    write(
        kitti.path(),
        "calib.txt",
        "P0: 30 0 16 0 0 31 12 0 0 0 1 0\n",
    );
    write(kitti.path(), "image_0/000000.png", grey_png(32, 24, 1));
    write(kitti.path(), "image_0/000001.png", grey_png(32, 24, 2));
    let dataset = open(kitti.path(), "").unwrap();
    assert_eq!(dataset.layout(), Some(Layout::Kitti));
    assert_eq!(dataset.calibration().camera.intrinsics().fy, 31.0);
    assert_eq!(
        shades(DatasetCamera::inline(dataset))[1],
        (1, 103_735_900, 2)
    );
    // Elsewhere it is the same, also for images that lie otherwise.
    let given = |folder: &Path| {
        let options = RecordingOptions {
            calibration: Some(kitti.path().join("calib.txt")),
            ..RecordingOptions::default()
        };
        let argument = folder.display().to_string().parse().unwrap();
        Dataset::open_with(&argument, &options)
    };
    for folder in [kitti.path(), euroc.path()] {
        let camera = given(folder).unwrap().calibration().camera.clone();
        assert_eq!((camera.width(), camera.intrinsics().fy), (32, 31.0));
    }
    write(
        kitti.path(),
        "calib.txt",
        "P0: nan 0 16 0 0 31 12 0 0 0 1 0\n",
    );
    let error = given(euroc.path()).unwrap_err().to_string();
    assert!(error.contains("fx = NaN is not a finite number"), "{error}");
    write(kitti.path(), "calib.txt", "P0: 30 0\n");
    assert!(refusal(kitti.path()).contains("P0 has 2 numbers"));
    write(kitti.path(), "times.txt", "0.0\n");
    assert!(refusal(kitti.path()).contains("1 time stamps for 2 images"));
    write(kitti.path(), "image_0/.directory", "by a file manager");
    write(kitti.path(), "image_0/list.txt", "000000.png");
    assert!(refusal(kitti.path()).contains("1 time stamps for 2 images"));
}

#[test]
fn files_that_are_no_recording_say_what_is_expected() {
    let folder = tempfile::tempdir().unwrap();
    let check = |name: &str, expected: &str| {
        write(folder.path(), name, "no recording");
        let error = refusal(&folder.path().join(name));
        assert!(error.contains(expected), "{name}: {error}");
    };
    check("flight.bag", "`mcap convert`");
    check("flight_0.db3", "`ros2 bag convert`");
    check(
        "flight.txt",
        "expected a folder, an MCAP file (.mcap), or a video",
    );
    check("flight.mcap", "no MCAP file");
    check("flight.y4m", "expected a folder, an MCAP file");
    write(folder.path(), "rgb.txt", "1 1.png\n");
    let options = RecordingOptions {
        topic: Some("/image".to_owned()),
        ..RecordingOptions::default()
    };
    let argument = folder.path().display().to_string().parse().unwrap();
    let error = Dataset::open_with(&argument, &options).unwrap_err();
    assert!(error.to_string().contains("only MCAP files have topics"));
}

/// Five frames of 32×24, each a shade brighter.
fn film(folder: &Path, name: &str) -> std::path::PathBuf {
    let mut bytes = b"YUV4MPEG2 W32 H24 F10:1 Cmono\n".to_vec();
    for frame in 0..5_u8 {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.resize(bytes.len() + 32 * 24, 10 * frame);
    }
    write(folder, name, bytes);
    folder.join(name)
}

#[test]
fn a_recording_in_one_file_has_ranges_and_its_calibration_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = film(folder.path(), "film.y4m");
    let error = refusal(&path);
    let expected = "expected one of film.yaml, camera.yaml, sensor.yaml";
    assert!(error.contains(expected), "{error}");
    write(folder.path(), "camera.yaml", CAMERA);
    let expected = vec![(1, 100_000_000, 10), (2, 200_000_000, 20)];
    let dataset = open(&path, "@1..3").unwrap();
    assert_eq!(dataset.layout(), None);
    assert_eq!(shades(DatasetCamera::inline(dataset.clone())), expected);
    assert_eq!(shades(DatasetCamera::decoding_ahead(dataset)), expected);
    write(
        folder.path(),
        "film.yaml",
        CAMERA.replace("[32, 24]", "[64, 48]"),
    );
    assert!(refusal(&path).contains("for 64×48, the images have 32×24"));
}

#[test]
fn what_a_recording_lost_is_told_unless_it_lies_behind_the_range() {
    let folder = tempfile::tempdir().unwrap();
    let path = film(folder.path(), "film.y4m");
    write(folder.path(), "camera.yaml", CAMERA);
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 9]).unwrap();
    let dataset = open(&path, "").unwrap();
    assert_eq!(dataset.frames().len(), 4);
    let expected = "the recording ends after 4 images: damaged after frame 4: it ends in a frame";
    assert!(
        dataset.losses()[0].starts_with(expected),
        "{:?}",
        dataset.losses()
    );
    assert!(dataset.losses()[0].ends_with("film.y4m"));
    assert_eq!(open(&path, "@2..").unwrap().losses().len(), 1);
    assert_eq!(open(&path, "@2..9").unwrap().losses().len(), 1);
    assert!(open(&path, "@2..4").unwrap().losses().is_empty());
}

#[test]
fn ten_bits_in_sixteen_are_spread_over_all_shades_and_a_mosaic_becomes_even() {
    let folder = tum_folder();
    for idx in 0..4_u16 {
        let mosaic = |place: usize| match (place / 32 % 2, place % 2) {
            (0, 0) => 900,
            (1, 1) => 100,
            _ => 400 + idx,
        };
        let values = (0..32 * 24).flat_map(|place| u16::to_be_bytes(mosaic(place)));
        let values: Vec<u8> = values.collect();
        let depth = png::BitDepth::Sixteen;
        let bytes = png_bytes((32, 24), png::ColorType::Grayscale, depth, &values);
        write(folder.path(), &format!("rgb/{idx}.png"), bytes);
    }
    let shades_of = || shades(DatasetCamera::inline(open(folder.path(), "").unwrap()));
    assert_eq!(shades_of()[3].2, 100 >> 2);
    write(
        folder.path(),
        "camera.yaml",
        format!("{CAMERA}bayer: RGGB\n"),
    );
    // A quarter of 225, of 25 and of twice 100: red, blue and green.
    assert_eq!(shades_of()[3].2, 113);
}

#[cfg(unix)]
#[test]
fn what_is_no_file_is_neither_waited_for_nor_read_without_end() {
    for path in ["/dev/zero", "/"] {
        let error = read_bytes(Path::new(path)).unwrap_err();
        assert!(matches!(error, ImageError::NoFile), "{path}: {error}");
    }
}

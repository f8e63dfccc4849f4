use std::path::PathBuf;

use sim::marker_light::MarkerScene;

use super::*;

fn write_pgm(path: &Path, image: &camera::Image) {
    let mut bytes = format!("P5 {} {} 255\n", image.width(), image.height()).into_bytes();
    bytes.extend_from_slice(image.pixels());
    std::fs::write(path, bytes).unwrap();
}

fn arguments(images: &Path, annotate: Option<PathBuf>) -> MarkersArguments {
    MarkersArguments {
        images: images.to_owned(),
        annotate,
        baseline: 90.0,
        json: false,
    }
}

/// Looks at every image of a folder as the command does.
fn look(folder: &Path, finder: FinderSettings) -> MarkersSummary {
    let mut camera = CameraMarkers::new(finder, TrackerSettings::default(), 0);
    let mut summary = MarkersSummary {
        images: Vec::new(),
        images_with_pair: 0,
        images_with_confirmed_track: 0,
        unreadable: Vec::new(),
    };
    for entry in list::list_images(folder).unwrap() {
        let looked = look_at(&entry, &mut camera, None, &mut BTreeSet::new());
        summary.add(looked.unwrap().unwrap());
    }
    summary
}

#[test]
fn pairs_in_a_folder_are_found_annotated_and_followed() {
    let folder = tempfile::tempdir().unwrap();
    let frame = MarkerScene::lab().draw(3);
    for idx in 0..4 {
        write_pgm(&folder.path().join(format!("{idx}.pgm")), &frame.image);
    }
    let summary = look(folder.path(), FinderSettings::default());
    assert_eq!(
        (
            summary.images_with_pair,
            summary.images_with_confirmed_track
        ),
        (4, 2)
    );
    let pair = &summary.images[0].pairs[0];
    assert!(
        (pair.separation_px - 10.0).abs() < 0.2,
        "{}",
        pair.separation_px
    );
    assert_eq!(summary.images[3].tracks[0].state, "Track");

    let annotated = folder.path().join("annotated");
    let exit = run(&arguments(folder.path(), Some(annotated.clone()))).unwrap();
    assert_eq!(exit, Exit::Done);
    let picture = dataset::read_grey(&annotated.join("2.png")).unwrap();
    assert_eq!(picture.width(), 3 * 324);
    assert!(picture.height() > 3 * 244, "there is room for the legend");
}

/// A picture on its side has its pairs side by side.
fn on_its_side(image: &camera::Image) -> camera::Image {
    let (width, height) = (image.height(), image.width());
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
    let pixels = places.map(|(x, y)| image.get(x, y)).collect();
    camera::Image::from_pixels(width, height, pixels).unwrap()
}

#[test]
fn pairs_side_by_side_are_found_where_they_are_expected() {
    let folder = tempfile::tempdir().unwrap();
    let image = on_its_side(&MarkerScene::lab().draw(3).image);
    write_pgm(&folder.path().join("0.pgm"), &image);
    for (baseline, expected) in [(90.0, 0), (0.0, 1), (180.0, 1)] {
        let finder = finder_settings(baseline);
        assert_eq!(
            look(folder.path(), finder).images_with_pair,
            expected,
            "{baseline}"
        );
    }
}

#[test]
fn damaged_images_are_named_and_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let error = run(&arguments(folder.path(), None))
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("no images; expected names"), "{error}");
    std::fs::write(folder.path().join("broken.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    let error = run(&arguments(folder.path(), None))
        .unwrap_err()
        .to_string();
    assert!(error.contains("broken.png"), "{error}");
    write_pgm(
        &folder.path().join("good.pgm"),
        &MarkerScene::lab().draw(3).image,
    );
    assert_eq!(
        run(&arguments(folder.path(), None)).unwrap(),
        Exit::DoneWithLoss
    );
}

#[test]
fn annotated_images_never_replace_what_is_read() {
    let folder = tempfile::tempdir().unwrap();
    write_pgm(
        &folder.path().join("0.pgm"),
        &MarkerScene::lab().draw(3).image,
    );
    let annotate = folder
        .path()
        .join("..")
        .join(folder.path().file_name().unwrap());
    let error = run(&arguments(folder.path(), Some(annotate))).unwrap_err();
    assert!(error.is::<UsageError>(), "{error}");

    // A recording's images lie beside its list.
    let images = folder.path().join("rgb");
    std::fs::create_dir(&images).unwrap();
    std::fs::write(images.join("0.png"), "kept").unwrap();
    std::fs::write(folder.path().join("rgb.txt"), "0.5 rgb/0.png\n").unwrap();
    let error = run(&arguments(folder.path(), Some(images.clone()))).unwrap_err();
    assert!(error.is::<files::Clash>(), "{error}");
    let kept = std::fs::read_to_string(images.join("0.png")).unwrap();
    assert_eq!(kept, "kept");
}

#[test]
fn real_pictures_without_our_lights_confirm_no_track() {
    let Some(data) = std::env::var_os("STARLING_DATA") else {
        println!("skipped: no data");
        return;
    };
    let folder = PathBuf::from(data).join("vision/aideck");
    if !folder.is_dir() {
        println!("skipped: no data in {}", folder.display());
        return;
    }
    let summary = look(&folder, FinderSettings::default());
    assert_eq!(summary.images_with_confirmed_track, 0);
    // A still camera sees the same picture again and again.
    for image in &summary.images {
        let entry = |idx: i64| ListedImage {
            path: image.path.clone(),
            captured_at: geometry::Timestamp::from_nanoseconds(50_000_000 * idx),
            is_stamped: true,
        };
        let mut camera =
            CameraMarkers::new(FinderSettings::default(), TrackerSettings::default(), 0);
        for idx in 0..6 {
            let seen = look_at(&entry(idx), &mut camera, None, &mut BTreeSet::new()).unwrap();
            let tracks = seen.unwrap().tracks;
            let confirmed = tracks.iter().find(|track| track.state != "Acquire");
            assert_eq!(confirmed, None, "{}", image.path.display());
        }
    }
}

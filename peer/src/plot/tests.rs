use super::*;

/// A room's outline, a loop through it, and an outlier far away.
fn room() -> Plot {
    let cloud: Vec<Vector3<f64>> = (0..2000)
        .map(|idx| {
            let angle = 0.01 * f64::from(idx);
            Vector3::new(
                4.0 * angle.cos(),
                3.0 * angle.sin(),
                f64::from(idx % 20) * 0.1,
            )
        })
        .chain([
            Vector3::new(1e6, 0.0, 0.0),
            Vector3::new(f64::NAN, 0.0, 0.0),
        ])
        .collect();
    let path = (0..100)
        .map(|idx| {
            let angle = 0.063 * f64::from(idx);
            Vector3::new(2.0 * angle.cos(), angle.sin(), 1.0)
        })
        .collect();
    Plot {
        title: "Lab <1> & co".to_owned(),
        layers: vec![
            Layer {
                name: "anchor's cloud".to_owned(),
                color: Color::RED,
                mark: Mark::Dots,
                points: cloud,
            },
            Layer {
                name: "truth".to_owned(),
                color: Color::PURPLE,
                mark: Mark::Line,
                points: path,
            },
        ],
    }
}

#[test]
fn svg_shows_metres_names_and_no_outlier() {
    let svg = room().to_svg();
    for expected in [
        "x [m]",
        "y [m]",
        "z [m]",
        "from above",
        "from the side",
        "anchor's cloud",
        "Lab &lt;1&gt; &amp; co",
        "#d63027",
        ">-4<",
        ">0<",
    ] {
        assert!(svg.contains(expected), "{expected} is missing");
    }
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
    assert!(svg.len() < 200_000, "{} bytes", svg.len());
}

#[test]
fn layers_without_a_name_take_no_room_in_the_legend() {
    let mut plot = room();
    let named = plot.to_svg();
    let unnamed = Layer {
        name: String::new(),
        ..plot.layers[1].clone()
    };
    plot.layers.extend(vec![unnamed; 30]);
    let size = |svg: &str| svg.split('>').next().unwrap().to_owned();
    assert_eq!(size(&plot.to_svg()), size(&named));
    // Two views and a sample of its line, and two views of each of the others.
    assert_eq!(plot.to_svg().matches("#873caa").count(), 3 + 60);
}

#[test]
fn png_decodes_and_has_the_colours_of_its_layers() {
    let bytes = room().to_png();
    let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    let reddish = |pixel: &[u8]| pixel[0] > 200 && pixel[1] < 140 && pixel[2] < 140;
    let red_count = pixels
        .chunks_exact(3)
        .filter(|pixel| reddish(pixel))
        .count();
    assert!(red_count > 1000, "{red_count}");
    let white_count = pixels
        .chunks_exact(3)
        .filter(|pixel| *pixel == [255; 3])
        .count();
    assert!(white_count * 2 > pixels.len() / 3, "{white_count}");
}

#[test]
fn nothing_to_draw_is_still_a_picture() {
    let check = |points: Vec<Vector3<f64>>| {
        let mut plot = room();
        plot.layers.truncate(1);
        plot.layers[0].points = points;
        assert!(plot.to_svg().ends_with("</svg>\n"));
        assert!(plot.to_png().len() > 100);
        plot.layers[0].mark = Mark::Line;
        assert!(plot.to_svg().ends_with("</svg>\n"));
    };
    check(Vec::new());
    check(vec![Vector3::zeros()]);
    check(vec![Vector3::new(f64::NAN, f64::INFINITY, 0.0); 3]);
    check(vec![Vector3::zeros(), Vector3::new(1e12, 1e-12, -1e9)]);
}

#[test]
fn a_realignment_has_the_colours_of_the_paper_and_leaves_out_what_is_empty() {
    let realignment = Realignment {
        vehicle: "drone1".to_owned(),
        anchor_cloud: room().layers[0].points.clone(),
        path_after: room().layers[1].points.clone(),
        ..Realignment::default()
    };
    let plot = realignment.plot("Lab");
    let colors: Vec<Color> = plot.layers.iter().map(|layer| layer.color).collect();
    assert_eq!(colors, [Color::RED, Color::GREEN]);
    assert_eq!(plot.layers[1].name, "drone1's path, after");
}

#[test]
fn ticks_are_round() {
    let check = |start: f64, end: f64, expected: &[f64], decimals: usize| {
        let (ticks, got_decimals) = axis::Range { start, end }.ticks(5.0);
        assert_eq!(got_decimals, decimals, "{start} {end}");
        assert_eq!(ticks.len(), expected.len(), "{ticks:?}");
        for (got, expected) in ticks.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-9, "{ticks:?}");
        }
    };
    check(0.0, 10.0, &[0.0, 2.0, 4.0, 6.0, 8.0, 10.0], 0);
    check(-0.12, 0.31, &[-0.1, 0.0, 0.1, 0.2, 0.3], 1);
    check(3.0, 1203.0, &[500.0, 1000.0], 0);
}

#[test]
fn names_decide_the_format() {
    let folder = tempfile::tempdir().unwrap();
    room().write(&folder.path().join("a.svg")).unwrap();
    room().write(&folder.path().join("a.PNG")).unwrap();
    let error = room().write(&folder.path().join("a.pdf")).unwrap_err();
    assert!(
        error.to_string().starts_with("expected a name that ends"),
        "{error}"
    );
}

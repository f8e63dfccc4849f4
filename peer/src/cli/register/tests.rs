use super::*;

fn parsed(text: &str) -> anyhow::Result<Start> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("start.txt");
    std::fs::write(&path, text).unwrap();
    read_start(path.to_str().unwrap())
}

#[test]
fn a_start_is_a_similarity_or_refused() {
    let Start::Given(start) = parsed("0 -2 0 1\n2 0 0 2\n0 0 2 3\n0 0 0 1\n").unwrap() else {
        panic!("a file is a given start");
    };
    assert!((start.scale() - 2.0).abs() < 1e-12);
    let moved = start * Vector3::new(1.0, 0.0, 0.0);
    assert!((moved - Vector3::new(1.0, 4.0, 3.0)).norm() < 1e-12);
    for (text, expected) in [
        ("1 2 3", "3 numbers, expected 16"),
        ("1 0 0 0 0 1 0 0 0 0 x 0 0 0 0 1", "\"x\" is no number"),
        ("1 0 0 0 0 1 0 0 0 0 nan 0 0 0 0 1", "not a similarity"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1", "not a similarity"),
        ("1 0 0 0 0 1 0 0 0 0 2 0 0 0 0 1", "not a similarity"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2", "not a similarity"),
        ("0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 1", "not a similarity"),
    ] {
        let error = parsed(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(read_start("/no/such/file").is_err());
}

/// A corner of a room with three different walls.
fn corner() -> Vec<Vector3<f64>> {
    let mut points = Vec::new();
    for a in 0..30 {
        for b in 0..20 {
            let (a, b) = (f64::from(a) * 0.1, f64::from(b) * 0.1);
            points.push(Vector3::new(a, b, 0.02 * (3.0 * a).sin()));
            points.push(Vector3::new(a, 0.0, b));
            points.push(Vector3::new(0.0, b * 1.2, a * 0.5));
        }
    }
    points
}

fn write_points(path: &Path, points: Vec<Vector3<f64>>) {
    files::write_cloud(path, &files::PointCloud::from_points(points)).unwrap();
}

fn arguments(source: impl Into<PathBuf>, target: impl Into<PathBuf>) -> RegisterArguments {
    RegisterArguments {
        source: source.into(),
        target: target.into(),
        metric: MetricArgument::Point,
        with_scale: false,
        init: "identity".to_owned(),
        z_up: false,
        voxel: None,
        max_distance: None,
        threads: 1,
        repeat: 2,
        plot: None,
        json: true,
    }
}

#[test]
fn a_moved_cloud_is_registered_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let [source, target, plot] = ["s.ply", "t.pcd", "p.svg"].map(|name| folder.path().join(name));
    let shift = Vector3::new(0.03, -0.02, 0.04);
    write_points(&source, corner());
    write_points(
        &target,
        corner().iter().map(|point| point + shift).collect(),
    );
    let arguments = RegisterArguments {
        metric: MetricArgument::Gicp,
        threads: 2,
        plot: Some(plot.clone()),
        ..arguments(source, target)
    };
    assert_eq!(run(&arguments).unwrap(), Exit::Done);
    assert!(
        std::fs::read_to_string(plot)
            .unwrap()
            .contains("source after")
    );
}

#[test]
fn a_refused_registration_says_why_and_fails() {
    let folder = tempfile::tempdir().unwrap();
    let [source, target] = ["s.xyz", "t.xyz"].map(|name| folder.path().join(name));
    write_points(&source, corner()[..2].to_vec());
    write_points(&target, corner());
    let arguments = arguments(source, target);
    assert_eq!(run(&arguments).unwrap(), Exit::Refused);
}

#[test]
fn points_that_no_cloud_can_have_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.xyz");
    std::fs::write(&path, "1 2 3\n1 nan 3\n4 5 6\n7 8 inf\n1 2 1e10\n").unwrap();
    let (cloud, dropped_count) = read_usable(&path).unwrap();
    assert_eq!((cloud.points().len(), dropped_count), (2, 3));
}

#[test]
fn large_clouds_are_thinned_alike_unless_told_otherwise() {
    let floor = |count: usize| {
        let point = |idx: usize| {
            let (x, y) = ((idx % 200) as f64 * 0.05, (idx / 200) as f64 * 0.05);
            Vector3::new(x, y, 0.0)
        };
        Cloud::from_points((0..count).map(point).collect())
    };
    let (small, large, larger) = (floor(1000), floor(40_000), floor(60_000));
    let mut arguments = arguments("s.ply", "t.ply");
    assert_eq!(choose_voxels(&small, &small, &arguments), [None; 2]);
    let [source, target] = choose_voxels(&large, &larger, &arguments);
    assert!(source.is_some() && source == target);
    assert!(large.thinned(source.unwrap()).points().len() <= 5000);
    let site = Cloud::from_points(large.points().iter().map(|point| point * 10.0).collect());
    let [source, target] = choose_voxels(&large, &site, &arguments);
    assert!(source == target);
    assert!(large.thinned(source.unwrap()).points().len() > 1000);
    arguments.with_scale = true;
    let [source, target] = choose_voxels(&large, &larger, &arguments);
    assert!(source < target);
    arguments.voxel = Some(0.3);
    assert_eq!(choose_voxels(&small, &large, &arguments), [Some(0.3); 2]);
}

/// Goal: two laser scans come within 0.02 m and 0.1° of the truth, by both metrics of surfaces,
/// thinned to 0.25 m and without being told how to thin; planes alone, untold, within 0.04 m and
/// 0.25°.
#[test]
fn two_laser_scans_come_near_the_truth() {
    let Some(data) = std::env::var_os("STARLING_DATA") else {
        println!("skipped: no data");
        return;
    };
    let folder = Path::new(&data).join("cloud/lidar_pair");
    let truth = read_similarity(&folder.join("T_target_source.txt")).unwrap();
    for metric in [MetricArgument::Gicp, MetricArgument::Plane] {
        for voxel in [Some(0.25), None] {
            let arguments = RegisterArguments {
                metric,
                voxel,
                ..arguments(folder.join("source.ply"), folder.join("target.ply"))
            };
            let source = files::read_cloud(&arguments.source).unwrap().into_cloud();
            let target = files::read_cloud(&arguments.target).unwrap().into_cloud();
            let voxels_m = choose_voxels(&source, &target, &arguments);
            let (source, target) = prepare_both(&source, &target, voxels_m, 1);
            let settings = RegisterSettings {
                metric: settings_metric(metric),
                ..RegisterSettings::default()
            };
            let outcome = registration::align(&source, &target, &settings);
            let Outcome::Accepted(alignment) = outcome else {
                panic!("{metric:?}, {voxel:?}: {outcome:?}");
            };
            let found = alignment.target_from_source;
            let error_m = (found.translation() - truth.translation()).norm();
            let error_deg = found.rotation().angle_to(truth.rotation()).to_degrees();
            // Nobody promises how near the coarser cubes of the default come by planes alone.
            let limits = match (metric, voxel) {
                (MetricArgument::Plane, None) => (0.04, 0.25),
                _ => (0.02, 0.1),
            };
            assert!(
                error_m < limits.0 && error_deg < limits.1,
                "{metric:?}, {voxel:?}: {error_m} m, {error_deg} degrees"
            );
        }
    }
}

#[test]
fn the_picture_is_checked_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |plot: &str| {
        // There are no clouds: nothing but the picture's name can be looked at.
        let arguments = RegisterArguments {
            plot: Some(folder.path().join(plot)),
            ..arguments("none.ply", "none.ply")
        };
        run(&arguments).unwrap_err()
    };
    let error = refused("p.jpg");
    assert!(error.is::<UsageError>(), "{error}");
    let cloud = folder.path().join("cloud.png");
    let same = RegisterArguments {
        plot: Some(folder.path().join("./cloud.png")),
        ..arguments(&cloud, "none.ply")
    };
    std::fs::write(&cloud, "points").unwrap();
    let error = run(&same).unwrap_err();
    assert!(error.is::<files::Clash>(), "{error}");
    assert_eq!(std::fs::read_to_string(&cloud).unwrap(), "points");
    std::fs::create_dir(folder.path().join("p.svg")).unwrap();
    let error = refused("p.svg").to_string();
    assert!(error.starts_with("this is a folder"), "{error}");
}

#[test]
fn summary_has_the_names_of_the_contract() {
    let outcome = Outcome::Refused {
        reason: registration::Refusal::SearchFoundNothing,
        quality: None,
    };
    let json = serde_json::to_value(summarise(&outcome, 1.0, 2.0)).unwrap();
    let names: Vec<&String> = json.as_object().unwrap().keys().collect();
    let mut expected = [
        "accepted",
        "reason",
        "target_from_source",
        "scale",
        "rmse_m",
        "overlap",
        "iterations",
        "correspondences",
        "consistent",
        "runner_up",
        "dropped_points",
        "voxel_m",
        "ms_preprocess",
        "ms_align",
        "covariance",
    ];
    expected.sort_unstable();
    let mut names: Vec<&str> = names.into_iter().map(String::as_str).collect();
    names.sort_unstable();
    assert_eq!(names, expected);
    assert!(json["scale"].is_null() && json["accepted"] == false);
}

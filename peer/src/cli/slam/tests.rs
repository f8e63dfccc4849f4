use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use geometry::Timestamp;
use vslam::ImuSample;

use super::*;
use crate::dataset::{CameraEvent, Frame};

#[test]
fn summary_has_the_names_of_the_contract() {
    let drive = Drive::new(vslam_of(32, 24), Readings::default());
    let json = serde_json::to_value(drive.summarise(0, 0)).unwrap();
    let mut names: Vec<&str> = json
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    names.sort_unstable();
    let expected = [
        "dropped",
        "frames",
        "keyframes",
        "live_left_out",
        "lost",
        "maps",
        "ms_per_frame_p50",
        "ms_per_frame_p99",
        "ms_waiting_p50",
        "ms_waiting_p99",
        "peak_rss_bytes",
        "points",
        "tracked",
        "tracked_live",
    ];
    assert_eq!(names, expected);
    assert!(json["ms_per_frame_p50"].is_null());
    assert!(json["peak_rss_bytes"].as_u64().unwrap() > 1 << 20);
}

fn vslam_of(width: usize, height: usize) -> Vslam {
    let text = format!("intrinsics: [30, 30, 16, 12]\nresolution: [{width}, {height}]\n");
    let calibration = camera::Calibration::from_euroc_yaml(&text).unwrap();
    Vslam::new(calibration.camera, VslamSettings::default())
}

/// A recording in which every image is grey: nothing can be tracked, nothing may fail.
fn grey_recording(folder: &std::path::Path, frame_count: usize) {
    let mut list = String::new();
    for idx in 0..frame_count {
        list += &format!("0.{idx:03} {idx}.png\n");
        let image = camera::Image::filled(32, 24, 90);
        write_grey(&folder.join(format!("{idx}.png")), &image);
    }
    std::fs::write(folder.join("rgb.txt"), list).unwrap();
    let camera = "intrinsics: [30, 30, 16, 12]\nresolution: [32, 24]\n";
    std::fs::write(folder.join("camera.yaml"), camera).unwrap();
}

fn write_grey(path: &std::path::Path, image: &camera::Image) {
    let file = std::fs::File::create(path).unwrap();
    let mut encoder = png::Encoder::new(file, image.width() as u32, image.height() as u32);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(image.pixels()).unwrap();
}

fn arguments(folder: &std::path::Path) -> SlamArguments {
    SlamArguments {
        dataset: folder.display().to_string().parse().unwrap(),
        calibration: None,
        topic: None,
        out: folder.join("out.tum"),
        map: Some(folder.join("map.ply")),
        save_map: None,
        continued: None,
        imu: None,
        frames: None,
        realtime: false,
        threads: 2,
        json: true,
    }
}

#[test]
fn a_recording_without_texture_fails_with_an_empty_trajectory() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    assert_eq!(run(&arguments(folder.path())).unwrap(), Exit::Refused);
    let text = std::fs::read_to_string(folder.path().join("out.tum")).unwrap();
    assert_eq!(text, "");
    assert!(folder.path().join("map.ply").is_file());
}

#[test]
fn a_damaged_image_is_loss_and_not_failure() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    std::fs::write(folder.path().join("2.png"), "no image").unwrap();
    let dataset = Dataset::open(&arguments(folder.path()).dataset).unwrap();
    let mut drive = Drive::new(vslam_of(32, 24), Readings::default());
    let progress = Progress::start("slam", 5);
    drive.run_through(DatasetCamera::inline(dataset), Plan::default(), &progress);
    assert_eq!(
        (drive.intake.unreadable_count, drive.times.frame_count()),
        (1, 4)
    );
    assert_eq!(drive.exit(5, 4), Exit::DoneWithLoss);
    assert_eq!(drive.exit(5, 0), Exit::Refused);
    let reason = drive.untracked.unwrap().to_string();
    assert_eq!(reason, "starting: too few corners in the image");
}

#[test]
fn a_recording_that_was_cut_off_is_loss_and_not_failure() {
    let mut drive = Drive::new(vslam_of(32, 24), Readings::default());
    assert_eq!(drive.exit(5, 4), Exit::Done);
    drive.losses = vec!["the recording ends after 5 images".to_owned()];
    assert_eq!(drive.exit(5, 4), Exit::DoneWithLoss);
}

#[test]
fn a_calibration_may_be_given() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    let camera = folder.path().join("camera.yaml");
    std::fs::rename(&camera, folder.path().join("other.yaml")).unwrap();
    let mut arguments = arguments(folder.path());
    let error = run(&arguments).unwrap_err().to_string();
    assert!(error.contains("or --calibration FILE"), "{error}");
    arguments.calibration = Some(folder.path().join("other.yaml"));
    assert_eq!(run(&arguments).unwrap(), Exit::Refused);
}

#[test]
fn where_results_go_is_checked_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    // There is no recording: nothing but the destinations can be looked at.
    let refused = |out: &str, map: &str| {
        let mut arguments = arguments(folder.path());
        arguments.out = folder.path().join(out);
        arguments.map = Some(folder.path().join(map));
        run(&arguments).unwrap_err()
    };
    std::fs::write(folder.path().join("file"), "").unwrap();
    let error = refused("", "map.ply").to_string();
    assert!(error.starts_with("this is a folder"), "{error}");
    let error = refused("file/out.tum", "map.ply").to_string();
    assert!(error.starts_with("this is a file"), "{error}");
    for out in ["map.ply", "./map.ply", "new/../map.ply"] {
        let error = refused(out, "map.ply");
        assert!(error.is::<files::Clash>(), "{error}");
    }
    let error = refused("out.tum", "map.las");
    assert!(error.is::<UsageError>(), "{error}");
    assert!(error.to_string().contains(".ply, .pcd, .xyz"), "{error}");
}

#[test]
fn a_map_that_is_none_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    let mut arguments = arguments(folder.path());
    arguments.continued = Some(folder.path().join("0.png"));
    let error = run(&arguments).unwrap_err().to_string();
    assert!(error.starts_with("this is no map"), "{error}");
    arguments.continued = None;
    arguments.save_map = Some(arguments.out.clone());
    let error = run(&arguments).unwrap_err();
    assert!(error.is::<files::Clash>(), "{error}");
}

#[test]
fn no_result_replaces_what_is_read() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("imu.csv"), "0,0,0,0,9.8,0,0\n").unwrap();
    std::fs::write(path("sensor.yaml"), "sensor_type: imu\n").unwrap();
    let rendered = rendered_frames(30);
    let camera = &rendered.calibration.camera;
    let mut drive = Drive::new(
        Vslam::new(camera.clone(), VslamSettings::default()),
        Readings::default(),
    );
    drive.run_through(
        rendered.clone(),
        Plan::default(),
        &Progress::start("slam", 1),
    );
    files::write_slam_map(&path("old.map"), drive.vslam.largest_map(), camera).unwrap();
    let check = |out: &str, expected: &str, change: &dyn Fn(&mut SlamArguments)| {
        let before = std::fs::read(path(out)).unwrap();
        let mut arguments = arguments(folder.path());
        arguments.out = path(out);
        change(&mut arguments);
        let error = run(&arguments).unwrap_err();
        assert!(error.is::<files::Clash>(), "{error}");
        let error = error.to_string();
        assert!(
            error.contains(&format!("would overwrite {expected}")),
            "{error}"
        );
        assert_eq!(std::fs::read(path(out)).unwrap(), before);
    };
    check("rgb.txt", "the recording's list of images", &|_| {});
    check("./camera.yaml", "the calibration", &|_| {});
    check("2.png", "an image of the recording", &|_| {});
    let with_readings = |arguments: &mut SlamArguments| arguments.imu = Some(path("imu.csv"));
    check("imu.csv", "the readings", &with_readings);
    check("sensor.yaml", "the sensor's place", &with_readings);
    check("rgb.txt", "the recording's list of images", &|arguments| {
        arguments.save_map = Some(std::mem::replace(&mut arguments.out, path("a.tum")));
    });
    // A map is read only with the camera that made it.
    let text = crate::demo::sensor_yaml(camera, &rendered.calibration.body_from_camera);
    std::fs::write(path("lab.yaml"), text).unwrap();
    let image = &rendered.frames[0].image;
    for idx in 0..5 {
        write_grey(&path(&format!("{idx}.png")), image);
    }
    check("old.map", "the map that is continued", &|arguments| {
        arguments.calibration = Some(path("lab.yaml"));
        arguments.continued = Some(path("old.map"));
    });
    check("lab.yaml", "the calibration", &|arguments| {
        arguments.calibration = Some(path("lab.yaml"));
    });
    // The map itself is replaced as a whole.
    let mut arguments = arguments(folder.path());
    arguments.continued = Some(path("old.map"));
    arguments.save_map = Some(path("old.map"));
    let results = check_destinations(&arguments).unwrap();
    check_continued_is_kept(&arguments, &results).unwrap();
}

#[test]
fn a_saved_map_is_continued_in_its_own_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lab.map");
    let rendered = rendered_frames(80);
    let camera = rendered.calibration.camera.clone();
    let settings = VslamSettings::default();
    let run_on = |vslam: Vslam, frames: std::ops::Range<usize>| {
        let mut part = rendered.clone();
        part.frames = part.frames.drain(frames).collect();
        let mut drive = Drive::new(vslam, Readings::default());
        drive.run_through(part, Plan::default(), &Progress::start("slam", 1));
        drive
    };
    let first = run_on(Vslam::new(camera.clone(), settings.clone()), 0..60);
    files::write_slam_map(&path, first.vslam.largest_map(), &camera).unwrap();
    let loaded = files::read_slam_map(&path, &camera, &settings).unwrap();
    let second = run_on(Vslam::continuing(camera, settings, loaded), 50..80);
    let poses = |drive: &Drive| trajectory_in(&drive.vslam, drive.vslam.largest_map().id());
    let (before, after) = (poses(&first), poses(&second));
    assert!(after.len() >= 28, "{}", after.len());
    // Frames of both sessions stand where they stood; the unit is the median depth at the start.
    let mut shared_count = 0;
    for one in &before {
        let twin = after
            .iter()
            .find(|other| other.captured_at == one.captured_at);
        if let Some(twin) = twin {
            let moved = one.target_from_camera.inverse() * twin.target_from_camera;
            assert!(moved.translation().norm() < 0.02, "{}", moved.translation());
            shared_count += 1;
        }
    }
    assert!(shared_count >= 8, "{shared_count}");
}

#[test]
fn readings_are_found_beside_the_recording_and_bad_lines_are_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    let mut arguments = arguments(folder.path());
    arguments.imu = Some("auto".into());
    let error = run(&arguments).unwrap_err().to_string();
    assert!(error.contains("found no mav0/imu0/data.csv"), "{error}");
    let imu = folder.path().join("mav0/imu0");
    std::fs::create_dir_all(&imu).unwrap();
    let readings_of = |text: &str| {
        std::fs::write(imu.join("data.csv"), text).unwrap();
        let dataset = Dataset::open(&arguments.dataset)?;
        Readings::open(std::path::Path::new("auto"), folder.path(), &dataset)
    };
    let error = readings_of("9000000000,0,0,0,0,0,0\n")
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("lie outside the recording from 0"),
        "{error}"
    );
    let mut readings = readings_of("0,0,0,1,0,0,9.8\n1,broken\n2000000,0,0,1,0,0,9.8\n").unwrap();
    let skipped = readings.skipped.as_ref().unwrap();
    assert_eq!(skipped.count, 1);
    assert!(skipped.first.ends_with("data.csv:2"), "{}", skipped.first);
    // Only what is due is given; nothing is given twice.
    let mut vslam = vslam_of(32, 24);
    readings.give_until(Timestamp::from_nanoseconds(1_000_000), &mut vslam);
    let sample = |nanoseconds| ImuSample {
        captured_at: Timestamp::from_nanoseconds(nanoseconds),
        rate_in_camera: nalgebra::Vector3::zeros(),
        specific_force_in_camera: None,
    };
    assert!(!vslam.take_imu(sample(0)));
    assert!(vslam.take_imu(sample(1)));
    let drive = Drive::new(vslam, readings);
    assert_eq!(drive.exit(5, 5), Exit::DoneWithLoss);
}

#[test]
fn frames_are_chosen_once() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 5);
    let mut arguments = arguments(folder.path());
    arguments.dataset.range = Some("0..2".parse().unwrap());
    assert_eq!(run(&arguments).unwrap(), Exit::Refused);
    arguments.frames = Some("0..2".parse().unwrap());
    assert!(run(&arguments).unwrap_err().is::<UsageError>());
}

#[test]
fn at_real_time_late_frames_are_dropped_and_early_ones_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    grey_recording(folder.path(), 3);
    // The second frame is over before it can be looked at, the third is 200 ms away.
    let list = "0 0.png\n0.000000001 1.png\n0.2 2.png\n";
    std::fs::write(folder.path().join("rgb.txt"), list).unwrap();
    for thread_count in [1, 2] {
        let dataset = Dataset::open(&arguments(folder.path()).dataset).unwrap();
        let mut drive = Drive::new(vslam_of(32, 24), Readings::default());
        let started = Instant::now();
        let progress = Progress::start("slam", 3);
        let plan = Plan {
            thread_count,
            pace: Some(Pace::default()),
        };
        drive.run_through(DatasetCamera::inline(dataset), plan, &progress);
        assert!(started.elapsed() >= Duration::from_millis(200));
        assert_eq!((drive.intake.dropped, drive.times.frame_count()), (1, 2));
    }
}

#[test]
fn two_threads_give_the_trajectory_of_one() {
    let rendered = rendered_frames(70);
    let trajectories = [1, 2].map(|thread_count| {
        let vslam = Vslam::new(
            rendered.calibration.camera.clone(),
            VslamSettings::default(),
        );
        let mut drive = Drive::new(vslam, Readings::default());
        let plan = Plan {
            thread_count,
            pace: None,
        };
        drive.run_through(rendered.clone(), plan, &Progress::start("slam", 70));
        assert_eq!(drive.times.frame_count(), 70);
        drive.vslam.trajectory()
    });
    let tracked = trajectories[0]
        .iter()
        .filter(|one| one.map_from_camera.is_some());
    assert!(tracked.count() > 40);
    assert_eq!(trajectories[0], trajectories[1]);
}

/// Images of a drone's camera in the rendered lab.
#[derive(Clone)]
struct Rendered {
    calibration: camera::Calibration,
    frames: VecDeque<Frame>,
}

impl Camera for Rendered {
    fn calibration(&self) -> &camera::Calibration {
        &self.calibration
    }

    fn next_event(&mut self) -> Option<CameraEvent> {
        self.frames.pop_front().map(CameraEvent::Frame)
    }
}

fn rendered_frames(frame_count: usize) -> Rendered {
    const DRONE_IDX: usize = 1;
    let scenario = sim::Scenario::lab(1);
    let drone = &scenario.vehicles[DRONE_IDX];
    let scene = Arc::new(scenario.paint());
    let mut renderer = sim::Renderer::new(scene, &drone.description.camera, drone.sensor);
    let frames = (0..frame_count).map(|frame_idx| Frame {
        frame_idx,
        captured_at: scenario.timestamp(scenario.frame_time_s(frame_idx)),
        image: renderer.render(&scenario.shot(DRONE_IDX, frame_idx)),
    });
    Rendered {
        frames: frames.collect(),
        calibration: camera::Calibration {
            body_from_camera: drone.description.body_from_camera,
            ..camera::Calibration::looking_forward(drone.description.camera.clone())
        },
    }
}

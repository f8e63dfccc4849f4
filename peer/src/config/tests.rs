use super::*;

#[test]
fn every_example_in_deploy_loads() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy");
    let mut example_count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path
            .extension()
            .is_some_and(|extension| extension == "toml")
        {
            VehicleConfig::load(&path).unwrap();
            example_count += 1;
        }
    }
    assert!(example_count >= 2);
}

#[test]
fn refuses_what_makes_no_sense_and_names_it() {
    let check = |text: &str, expected: &str| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vehicle.toml");
        std::fs::write(&path, text).unwrap();
        let error = VehicleConfig::load(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error:?} lacks {expected:?}");
    };
    check(
        "id = 'a'\nout = 'o'\n[camera]\n",
        "exactly one of dataset and stream",
    );
    check(
        "id = 'a/b'\nout = 'o'\n[camera]\ndataset = 'd'\n",
        "letters",
    );
    check(
        "id = 'a'\nout = 'o'\n[camera]\nstream = '127.0.0.1:1'\n",
        "needs a calibration",
    );
    check(
        "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\ncolour = 1\n",
        "unknown field",
    );
    check(
        "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\n[position]\n",
        "exactly one of file and stream",
    );
    check(
        "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\n[position]\nfile = 'f'\nsigma_m = nan",
        "sigma_m is NaN",
    );
}

#[test]
fn refuses_numbers_out_of_range_naming_key_value_and_file() {
    let check = |tables: &str, expected: &str| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vehicle.toml");
        let text = format!("id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\n{tables}\n");
        std::fs::write(&path, text).unwrap();
        let error = VehicleConfig::load(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error:?} lacks {expected:?}");
        assert!(error.ends_with("vehicle.toml"), "{error:?}");
        assert!(
            !error.contains("\n:"),
            "the path follows its reason: {error:?}"
        );
    };
    let position = |line: &str, expected: &str| {
        check(&format!("[position]\nfile = 'f'\n{line}"), expected);
    };
    position(
        "lever_arm_m = [nan, 0, 0]",
        "lever_arm_m is [NaN, 0.0, 0.0]",
    );
    position(
        "lever_arm_m = [0, inf, 0]",
        "lever_arm_m is [0.0, inf, 0.0]",
    );
    position("lever_arm_m = [0, 80, 80]", "at most 100 m");
    position("noise_m = -1.0", "noise_m is -1, expected 0 to 1000");
    position("sigma_m = 1e4", "sigma_m is 10000");
    position("site = ''", "[position] site: ");
    let estimation = |line: &str, expected: &str| {
        check(&format!("[estimation]\n{line}"), expected);
    };
    estimation("global_sigma_m = 0.0", "global_sigma_m is 0, expected more");
    estimation("global_sigma_m = nan", "global_sigma_m is NaN");
    estimation("global_sigma_m = 1001.0", "at most 1000");
    estimation("stale_after_s = inf", "stale_after_s is inf");
    estimation("stale_after_s = -2.0", "stale_after_s is -2");
    estimation("threads = 0", "threads is 0");
    estimation("threads = -1", "expected usize");
    check("[zenoh]\nlisten = []", "listen is []");
    let keeping = |line: &str, expected: &str| {
        check(&format!("[keeping]\n{line}"), expected);
    };
    keeping(
        "separation_px = 1.0",
        "separation_px is 1, expected 3 to 50",
    );
    keeping("light_distance_m = nan", "light_distance_m is NaN");
    keeping("rate_hz = 0.0", "rate_hz is 0, expected 2 to 200");
    keeping("lateral_px = -1.0", "lateral_px is -1");
    keeping("distance_m_min = inf", "distance_m_min is inf");
    keeping("speed_mps_max = 0.0", "speed_mps_max is 0");
    keeping("preferred_m = 0.1", "preferred_m is 0.1");
    keeping("speed_mps = -1.0", "speed_mps is -1");
    keeping("rule = 'flock'", "unknown variant `flock`");
    keeping("colour = 1", "unknown field");
}

#[test]
fn refuses_cameras_and_fixes_that_do_not_go_together() {
    let check = |camera: &str, position: &str, expected: &str| {
        let text = format!("id = 'a'\nout = 'o'\n[camera]\n{camera}\n{position}\n");
        let config: VehicleConfig = toml::from_str(&text).unwrap();
        let error = config.check().unwrap_err();
        assert!(error.contains(expected), "{error:?} lacks {expected:?}");
    };
    let stream = "stream = '127.0.0.1:1'\ncalibration = 'c'";
    check(
        stream,
        "[position]\nfile = 'f'",
        "file needs a [camera] dataset",
    );
    check(
        "dataset = 'd'",
        "[position]\nstream = true",
        "needs a [camera] stream",
    );
    check(
        "dataset = 'd'",
        "[keeping]",
        "[keeping] needs a [camera] stream",
    );
    check(
        "stream = 'here'\ncalibration = 'c'",
        "",
        "expected HOST:PORT",
    );
    check("dataset = 'd@3..3'", "", "\"3..3\" is no frame range");
    check("dataset = ''", "", "expected a file or folder");
    let topic = format!("{stream}\ntopic = '/image'");
    check(&topic, "", "topic needs a dataset");
}

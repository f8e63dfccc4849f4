use super::*;

fn summary(id: &str) -> VehicleSummary {
    let counters = serde_json::to_value(crate::node::NodeCounters::default()).unwrap();
    serde_json::from_value(serde_json::json!({
        "id": id, "role": "peer", "state": "Global", "reason": "", "frame_count": 9,
        "unreadable_count": 0, "input_error": null, "global_frame_count": 9,
        "keyframe_count": 0, "point_count": 0, "bytes_sent": 0, "bytes_received": 0,
        "without_link_s": 0.0, "dropped_count": 0, "unwritten_count": 4,
        "write_error": "the map: No space left on device", "counters": counters,
    }))
    .unwrap()
}

#[test]
fn a_truth_that_cannot_be_written_costs_the_judgement_and_not_the_report() {
    let folder = tempfile::TempDir::new().unwrap();
    let out = folder.path();
    // A folder stands where the first truth should be.
    std::fs::create_dir(truth_path(out, "ugv")).unwrap();
    let truth = |id: &str| VehicleTruth {
        id: id.to_owned(),
        truth_tum: "0.0 0 0 0 0 0 0 1\n".to_owned(),
    };
    let report = SimulatorReport {
        frame_count: 9,
        realtime_factor: Some(0.5),
        vehicles: vec![truth("ugv"), truth("drone1")],
    };
    let plan = DemoPlan {
        scenario: ScenarioName::Lab,
        seed: 1,
        out: out.to_owned(),
    };
    let summaries = [summary("ugv")];
    let judged = judge(&plan, out, &summaries, Some(report), Ending::Flown);
    assert_eq!(judged.vehicles.len(), 1);
    let losses = judged.losses.join("\n");
    let expected = "ugv: writes failed: 4, the map: No space left on device\nugv: cannot write ";
    assert!(losses.starts_with(expected), "{losses}");
    assert!(truth_path(out, "drone1").exists());
}

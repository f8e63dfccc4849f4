use geometry::{Camera, Enu};
use nalgebra::{UnitQuaternion, Vector3};

use super::*;

fn stamp(nanoseconds: i64) -> Stamp<'static> {
    Stamp {
        frame_id: "map",
        captured_at: Timestamp::from_nanoseconds(nanoseconds),
    }
}

fn pose(x: f64) -> Transform<Enu, Camera> {
    Transform::new(
        UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2),
        Vector3::new(x, 2.0, 3.0),
    )
}

fn record(path: &Path) -> Recorder {
    let mut recorder = Recorder::create(path).unwrap();
    let cloud = PointCloud {
        points: vec![Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 5.0, 6.0)],
        colors: Some(vec![[1, 2, 3], [4, 5, 6]]),
        descriptors: Descriptors::Binary(vec![features::Descriptor([7; 4]); 2]),
    };
    for idx in 0..10_u32 {
        let stamp = stamp(1_500_000_000 + 100_000_000 * i64::from(idx));
        let pose = pose(f64::from(idx));
        recorder
            .record_pose("/peer1/pose", stamp, &pose, Some(&Matrix6::identity()))
            .unwrap();
        recorder
            .record_cloud("/peer1/cloud", stamp, &cloud)
            .unwrap();
        let state = serde_json::json!({ "state": "Global", "frame": idx });
        recorder
            .record_state("/peer1/state", stamp.captured_at, &state)
            .unwrap();
    }
    recorder
}

#[test]
fn what_was_recorded_is_read_back_by_topic_and_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    record(&path).finish().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 30);
    let messages: Vec<mcap::Message> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    let poses: Vec<&mcap::Message> = messages
        .iter()
        .filter(|message| message.channel.topic == "/peer1/pose")
        .collect();
    assert_eq!(poses.len(), 10);
    assert_eq!(poses[3].log_time, 1_800_000_000);
    let schema = poses[0].channel.schema.as_ref().unwrap();
    assert_eq!(schema.name, "geometry_msgs/msg/PoseWithCovarianceStamped");
    // Encapsulation, seconds, nanoseconds, "map" with its length, padded to eight, then x.
    let body = &poses[3].data;
    assert_eq!(body[..4], [0, 1, 0, 0]);
    assert_eq!(body[4..12], [1, 0, 0, 0, 0x00, 0x08, 0xaf, 0x2f]);
    assert_eq!(body[12..20], *b"\x04\0\0\0map\0");
    assert_eq!(body[20..28], 3.0_f64.to_le_bytes());
    assert_eq!(body.len(), 4 + 16 + 8 * (7 + 36));
    let state = messages.last().unwrap();
    assert!(
        state
            .data
            .ends_with(b"{\"frame\":9,\"state\":\"Global\"}\0")
    );
}

#[test]
fn a_recording_that_was_cut_off_keeps_what_was_flushed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    let mut recorder = record(&path);
    recorder.flush().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::mem::forget(recorder);
    let whole_count = mcap::MessageStream::new(&bytes)
        .unwrap()
        .take_while(Result::is_ok)
        .count();
    assert_eq!(whole_count, 30);
}

/// A vehicle that looks along y is unsure along its own x: that is −y … in the map's axes.
#[test]
fn covariance_is_turned_into_the_fixed_frame() {
    let mut covariance = Matrix6::zeros();
    covariance[(3, 3)] = 4.0;
    covariance[(0, 0)] = 0.25;
    let turned = position_first(&pose(0.0).rotation_matrix(), &covariance);
    let mut expected = Matrix6::zeros();
    expected[(1, 1)] = 4.0;
    expected[(4, 4)] = 0.25;
    assert!((turned - expected).norm() < 1e-12, "{turned}");
}

#[test]
fn a_folder_is_no_recording() {
    let folder = tempfile::tempdir().unwrap();
    let error = Recorder::create(folder.path()).err().unwrap().to_string();
    assert!(error.starts_with("cannot create the recording"), "{error}");
}

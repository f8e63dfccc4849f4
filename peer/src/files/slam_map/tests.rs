use camera::{Distortion, Intrinsics};
use proptest::prelude::*;

use super::*;

fn camera_of(fx: f64) -> CameraModel {
    let intrinsics = Intrinsics {
        fx,
        fy: 100.0,
        cx: 63.5,
        cy: 47.5,
    };
    CameraModel::new(128, 96, intrinsics, Distortion::None).unwrap()
}

/// Two keyframes side by side that see the same four points.
fn small_map() -> VslamMap {
    let points = [[-0.2, 0.1], [0.3, 0.2], [0.0, -0.3], [0.4, -0.1]];
    let keyframes = [0.0, 0.2].map(|x| KeyframeParts {
        captured_at: Timestamp::from_nanoseconds(1_403_636_579_763_555_584 + (x * 1e9) as i64),
        camera_from_map: Transform::new(
            UnitQuaternion::from_euler_angles(0.01 * x, 0.02 * x, -0.03 * x),
            Vector3::new(-x, 0.01, -0.02),
        ),
        parent: (x > 0.0).then_some(0),
        keypoints: points
            .iter()
            .enumerate()
            .map(|(idx, point)| KeypointParts {
                position_px: Vector2::new(63.5 + 100.0 * (point[0] - x), 47.5 + 100.0 * point[1]),
                level: idx as u8,
                angle_rad: 0.1 * idx as f32,
                descriptor: Descriptor::from_bytes([idx as u8; 32]),
            })
            .collect(),
    });
    let points = (0..4).map(|idx| PointParts {
        position_in_map: Vector3::new(points[idx][0], points[idx][1], 1.0),
        covariance_in_map: Matrix3::from_diagonal_element(1e-4),
        parallax_rad: 0.2,
        views: [0, 1]
            .map(|keyframe_idx| ViewParts {
                keyframe_idx,
                keypoint_idx: idx as u32,
            })
            .to_vec(),
    });
    let parts = MapParts {
        keyframes: keyframes.to_vec(),
        points: points.collect(),
    };
    VslamMap::from_parts(&parts, &camera_of(100.0), &VslamSettings::default()).unwrap()
}

fn read(path: &Path) -> Result<VslamMap, FileError> {
    read_slam_map(path, &camera_of(100.0), &VslamSettings::default())
}

#[test]
fn a_map_comes_back_as_it_was_and_leaves_nothing_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.map");
    fs::write(&path, "an older map").unwrap();
    let map = small_map();
    write_slam_map(&path, &map, &camera_of(100.0)).unwrap();
    assert_eq!(read(&path).unwrap().to_parts(), map.to_parts());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn what_cannot_be_written_leaves_the_old_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("missing/room.map");
    let error = write_slam_map(&path, &small_map(), &camera_of(100.0)).unwrap_err();
    assert!(error.to_string().starts_with("cannot write"), "{error}");
}

#[test]
fn what_is_no_map_of_this_camera_and_version_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.map");
    let whole = encode(&small_map().to_parts(), &camera_of(100.0));
    let refusal = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        read(&path).unwrap_err().to_string()
    };
    let mut newer = whole.clone();
    newer[8] = 9;
    let mut longer = whole.clone();
    longer.push(0);
    let mut flipped = whole.clone();
    flipped[200] ^= 1;
    let cases = [
        (&b""[..], "this is no map of starling slam"),
        (b"ply\nformat ascii 1.0", "this is no map of starling slam"),
        (&whole[..10], "it ends too soon"),
        (&newer, "of version 9, expected 2"),
        (&whole[..whole.len() - 1], "it was cut or added to"),
        (&longer, "it was cut or added to"),
        (&flipped, "the map is damaged: checksum"),
    ];
    for (bytes, expected) in cases {
        let message = refusal(bytes);
        assert!(message.contains(expected), "{message}");
        assert!(message.ends_with("room.map"), "{message}");
    }
    let other = encode(&small_map().to_parts(), &camera_of(101.0));
    let message = refusal(&other);
    assert!(
        message.contains("another camera (128×96 px, fx 101,"),
        "{message}"
    );
    assert!(
        message.contains("this one (128×96 px, fx 100,"),
        "{message}"
    );
    let message = read(folder.path()).unwrap_err().to_string();
    assert!(message.starts_with("this is no file"), "{message}");
}

proptest! {
    #[test]
    fn a_flipped_byte_or_a_cut_is_an_error(at in any::<prop::sample::Index>(), flip in 1..=255_u8) {
        let whole = encode(&small_map().to_parts(), &camera_of(100.0));
        let at = at.index(whole.len());
        prop_assert!(decode(&whole[..at], &camera_of(100.0)).is_err());
        let mut flipped = whole;
        flipped[at] ^= flip;
        prop_assert!(decode(&flipped, &camera_of(100.0)).is_err());
    }

    /// Damage that the checksum was made for: numbers, counts and texts that cannot be.
    #[test]
    fn a_body_that_lies_never_panics(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut file = encode(&small_map().to_parts(), &camera_of(100.0));
        for (at, value) in changes {
            let at = HEADER_BYTES + at.index(file.len() - HEADER_BYTES);
            file[at] = value;
        }
        let crc = crc32fast::hash(&file[HEADER_BYTES..]);
        file[12..16].copy_from_slice(&crc.to_le_bytes());
        if let Ok(parts) = decode(&file, &camera_of(100.0)) {
            let made = VslamMap::from_parts(&parts, &camera_of(100.0), &VslamSettings::default());
            if let Ok(map) = made {
                prop_assert_eq!(map.keyframe_count(), parts.keyframes.len());
            }
        }
    }
}

use geometry::{Camera, Similarity, Timestamp, Transform};
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

/// A gentle spiral at 10 Hz: 0.5 m/s, turning, climbing.
fn spiral(count: usize) -> Vec<StampedPose<Enu>> {
    (0..count)
        .map(|idx| {
            let angle = 0.05 * idx as f64;
            StampedPose {
                captured_at: Timestamp::from_nanoseconds(100_000_000 * idx as i64),
                target_from_camera: Transform::new(
                    UnitQuaternion::from_euler_angles(0.1, 0.2, angle),
                    Vector3::new(angle.cos(), angle.sin(), 0.02 * angle),
                ),
            }
        })
        .collect()
}

fn in_map(truth: &[StampedPose<Enu>], map_from_enu: Similarity<Map, Enu>) -> Vec<StampedPose<Map>> {
    truth
        .iter()
        .map(|pose| StampedPose {
            captured_at: pose.captured_at,
            target_from_camera: map_from_enu.transform_pose(&pose.target_from_camera),
        })
        .collect()
}

fn shifted(truth: &[StampedPose<Enu>], shift: Vector3<f64>) -> Vec<StampedPose<Enu>> {
    let moved = Transform::<Enu, Enu>::new(UnitQuaternion::identity(), shift);
    truth
        .iter()
        .map(|pose| StampedPose {
            captured_at: pose.captured_at,
            target_from_camera: moved * pose.target_from_camera,
        })
        .collect()
}

fn some_map() -> Similarity<Map, Enu> {
    let rotation = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.9);
    Similarity::new(0.37, rotation, Vector3::new(5.0, -3.0, 2.0))
}

#[test]
fn poses_pair_with_their_nearest_within_the_tolerance() {
    let at = |milliseconds: &[i64]| -> Vec<StampedPose<Enu>> {
        milliseconds
            .iter()
            .map(|stamp| StampedPose {
                captured_at: Timestamp::from_nanoseconds(stamp * 1_000_000),
                target_from_camera: Transform::<Enu, Camera>::identity(),
            })
            .collect()
    };
    let check = |truth: &[i64], estimate: &[i64], expected: &[(usize, usize)]| {
        let got: Vec<(usize, usize)> = associate(&at(truth), &at(estimate))
            .iter()
            .map(|pair| (pair.truth_idx, pair.estimate_idx))
            .collect();
        assert_eq!(got, expected, "{truth:?} {estimate:?}");
    };
    check(
        &[0, 100, 200],
        &[0, 33, 67, 101, 195],
        &[(0, 0), (1, 3), (2, 4)],
    );
    check(&[0, 100], &[92, 97, 105], &[(1, 1)]);
    check(&[100], &[120], &[]);
    check(&[], &[1], &[]);
    check(&[1], &[], &[]);
}

#[test]
fn a_shift_is_an_error_until_it_is_aligned_away() {
    let truth = spiral(50);
    let estimate = shifted(&truth, Vector3::new(0.3, 0.0, 0.4));
    let error = trajectory_error(&truth, &estimate, Alignment::None).unwrap();
    assert!((error.rmse_m - 0.5).abs() < 1e-12 && (error.median_m - 0.5).abs() < 1e-12);
    assert_eq!(error.pair_count, 50);
    let aligned = trajectory_error(&truth, &estimate, Alignment::Rigid).unwrap();
    assert!(aligned.rmse_m < 1e-9);
}

proptest! {
    #[test]
    fn a_similarity_is_no_error_after_alignment(
        scale in 0.1_f64..10.0,
        angles in prop::array::uniform3(-3.0_f64..3.0),
        offset in prop::array::uniform3(-50.0_f64..50.0),
    ) {
        let truth = spiral(40);
        let rotation = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
        let own = in_map(&truth, Similarity::new(scale, rotation, Vector3::from(offset)));
        let error = trajectory_error(&truth, &own, Alignment::Similarity).unwrap();
        prop_assert!(error.rmse_m < 1e-9);
        prop_assert!((error.truth_from_estimate.scale() * scale - 1.0).abs() < 1e-9);
    }
}

#[test]
fn what_cannot_be_compared_says_why() {
    let truth = spiral(10);
    let error = trajectory_error(&truth, &truth[..0], Alignment::None).unwrap_err();
    assert_eq!(error, NotComparable::NoPairs);
    let error = trajectory_error(&truth, &truth[..2], Alignment::Similarity).unwrap_err();
    assert_eq!(error.to_string(), "cannot align 2 poses: too few");
}

/// Goal: a rough start of a perfect own trajectory has an error that can be computed by hand.
/// Method: with the offset alone every frame is off by exactly it; with the scale alone each
/// frame is off by its distance from the start times the scale's error.
#[test]
fn rough_starts_are_exactly_as_rough_as_they_say() {
    let truth = spiral(60);
    let own = in_map(&truth, some_map());
    let exact = BaselineSettings {
        offset_m: 0.0,
        turn_rad: 0.0,
        scale_factor: 1.0,
        ..BaselineSettings::default()
    };
    let rmse_m =
        |settings: &BaselineSettings| rough_start_rmse_m(&truth, &own, &truth, settings).unwrap();
    assert!(rmse_m(&exact) < 1e-9);
    let offset_alone = BaselineSettings {
        offset_m: 0.5,
        ..exact
    };
    assert!((rmse_m(&offset_alone) - 0.5).abs() < 1e-9);

    let start = truth[0].target_from_camera.translation();
    let distances_m: Vec<f64> = truth
        .iter()
        .map(|pose| (pose.target_from_camera.translation() - start).norm())
        .collect();
    let reach_m = trajectory_error::root_mean_square(&distances_m);
    let scale_alone = BaselineSettings {
        scale_factor: 1.1,
        draw_count: 1,
        ..exact
    };
    let got = rmse_m(&scale_alone);
    let expected = [0.1 * reach_m, (1.0 - 1.0 / 1.1) * reach_m];
    assert!(
        expected.iter().any(|value| (value - got).abs() < 1e-9),
        "{got} {expected:?}"
    );

    // A turn moves a frame by at most 2 sin(15°/2) of its distance from the start.
    let turn_alone = BaselineSettings {
        turn_rad: 15_f64.to_radians(),
        ..exact
    };
    let got = rmse_m(&turn_alone);
    let bound = 2.0 * 7.5_f64.to_radians().sin() * reach_m;
    assert!(got > 0.3 * bound && got <= bound + 1e-9, "{got} of {bound}");
}

#[test]
fn the_same_seed_draws_the_same_rough_starts() {
    let truth = spiral(30);
    let own = in_map(&truth, some_map());
    let rmse_m = |seed| {
        let settings = BaselineSettings {
            seed,
            ..BaselineSettings::default()
        };
        rough_start_rmse_m(&truth, &own, &truth, &settings).unwrap()
    };
    assert_eq!(rmse_m(7), rmse_m(7));
    assert_ne!(rmse_m(7), rmse_m(8));
}

/// Goal: the ideal start takes out everything but what happens after the beginning.
/// Method: an own trajectory that is perfect for 2 s and then stands still.
#[test]
fn an_ideal_start_leaves_only_drift() {
    let truth = spiral(60);
    let own = in_map(&truth, some_map());
    let settings = BaselineSettings::default();
    assert!(drift_rmse_m(&truth, &own, &truth, &settings).unwrap() < 1e-9);

    let stuck = in_map(&truth[..21], some_map());
    let got = drift_rmse_m(&truth, &stuck, &truth, &settings).unwrap();
    let last = truth[20].target_from_camera.translation();
    let errors_m: Vec<f64> = truth
        .iter()
        .map(|pose| pose.target_from_camera.translation())
        .enumerate()
        .map(|(idx, position)| {
            if idx > 20 {
                (position - last).norm()
            } else {
                0.0
            }
        })
        .collect();
    let expected = trajectory_error::root_mean_square(&errors_m);
    assert!((got - expected).abs() < 1e-9, "{got} {expected}");
}

/// A straight beginning leaves the roll about it to the orientations.
#[test]
fn an_ideal_start_may_be_straight_and_slow() {
    let mut truth = spiral(100);
    for (idx, pose) in truth.iter_mut().enumerate() {
        let east = 0.01 * idx as f64;
        let north = if idx > 60 {
            0.01 * (idx - 60) as f64
        } else {
            0.0
        };
        pose.target_from_camera = Transform::new(
            *pose.target_from_camera.rotation(),
            Vector3::new(east, north, 0.0),
        );
    }
    let own = in_map(&truth, some_map());
    let settings = BaselineSettings::default();
    // After 2 s only 0.2 m have been travelled: the beginning must last 5 s.
    assert!(drift_rmse_m(&truth, &own, &truth, &settings).unwrap() < 1e-9);
}

#[test]
fn without_own_frames_or_causal_frames_there_is_no_ratio() {
    let truth = spiral(30);
    let own = in_map(&truth, some_map());
    let settings = BaselineSettings::default();
    assert_eq!(rough_start_rmse_m(&truth, &[], &truth, &settings), None);
    assert_eq!(drift_rmse_m(&truth, &[], &truth, &settings), None);
    assert_eq!(rough_start_rmse_m(&truth, &own, &[], &settings), None);
    assert_eq!(drift_rmse_m(&truth, &own, &[], &settings), None);
}

/// Goal: drawn from its covariance, an error scores as honest. Tolerances: with 2000 draws the
/// mean of χ²₃/3 has a deviation of √(6/9/2000) = 0.018; five of them are allowed.
#[test]
fn honest_covariances_score_near_one_and_dishonest_ones_do_not() {
    let truth = spiral(2000);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let factor = Matrix3::new(0.1, 0.0, 0.0, 0.05, 0.2, 0.0, -0.03, 0.01, 0.05);
    let covariance = factor * factor.transpose();
    let causal: Vec<StampedPose<Enu>> = truth
        .iter()
        .map(|pose| {
            let noise = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng));
            shifted(&[*pose], factor * noise)[0]
        })
        .collect();
    let score = |scale: f64| consistency(&truth, &causal, &vec![covariance * scale; 2000]);
    let honest = score(1.0);
    assert!((honest.nees_mean.unwrap() - 1.0).abs() < 0.09, "{honest:?}");
    assert!(
        (honest.inside_3sigma_share.unwrap() - 0.9973).abs() < 0.006,
        "{honest:?}"
    );
    assert!(score(0.1).inside_3sigma_share.unwrap() < 0.7);
    assert!(score(100.0).nees_mean.unwrap() < 0.02);
    let impossible = consistency(&truth, &causal, &vec![Matrix3::zeros(); 2000]);
    assert_eq!(impossible.inside_3sigma_share, Some(0.0));
    assert_eq!(impossible.nees_mean, None);
}

#[test]
fn a_vehicle_is_judged_by_its_record() {
    let truth = spiral(60);
    let causal = shifted(&truth[20..], Vector3::new(0.1, 0.0, 0.0));
    let own = in_map(&truth, some_map());
    let covariances = vec![Matrix3::identity() * 0.01; causal.len()];
    let record = VehicleRecord {
        truth: &truth,
        causal: &causal,
        covariances: &covariances,
        corrected: &truth,
        own: &own,
        frame_count: 60,
    };
    let score = judge(&record, &BaselineSettings::default());
    assert!((score.global_share.unwrap() - 40.0 / 60.0).abs() < 1e-12);
    assert!((score.rmse_m.unwrap() - 0.1).abs() < 1e-12);
    assert!((score.nees_mean.unwrap() - 1.0 / 3.0).abs() < 1e-9);
    assert_eq!(score.inside_3sigma_share, Some(1.0));
    assert_eq!(score.rmse_final_m, Some(0.0));
    assert!(score.ratio.unwrap() > 4.0);
    assert!(score.ratio_ideal.unwrap() < 1e-6);

    let nothing = VehicleRecord {
        truth: &truth,
        causal: &[],
        covariances: &[],
        corrected: &[],
        own: &[],
        frame_count: 60,
    };
    let score = judge(&nothing, &BaselineSettings::default());
    let expected = VehicleScore {
        global_share: Some(0.0),
        ..VehicleScore::default()
    };
    assert_eq!(score, expected);
}

use nalgebra::Rotation3;

use super::*;

/// Of a keypoint, on the plane at depth one: 0.9 px at a focal length of 450.
const SIGMA: f64 = 0.002;

/// A camera that is carried about, turn by turn over 0.2 s: up to 0.5 rad/s about all axes.
fn carried(span: usize) -> Vector3<f64> {
    let phase = span as f64;
    0.1 * Vector3::new(
        (0.9 * phase).sin(),
        (0.5 * phase + 1.0).sin(),
        (0.7 * phase).cos(),
    )
}

/// What the pictures say of a gyroscope that tells this of each turn.
fn judged(
    seen: impl Fn(usize) -> Vector3<f64>,
    told: impl Fn(Vector3<f64>) -> Vector3<f64>,
) -> GyroState {
    let mut trial = Trial::default();
    for idx in 0..20 {
        let (seen, phase) = (seen(idx), 17.0 * idx as f64);
        // What the pose of a camera errs by.
        let noise = Vector3::new(phase.sin(), (1.3 * phase).sin(), (2.1 * phase).cos());
        let span = Span {
            seconds: 0.2,
            seen: seen + noise * (0.5 * SIGMA),
            told: told(seen),
        };
        trial.judge(span, SIGMA);
    }
    trial.state()
}

#[test]
fn a_right_gyroscope_is_confirmed_whatever_it_says_at_rest() {
    let bias = Vector3::new(0.03, -0.02, 0.01);
    assert_eq!(judged(carried, |turn| turn), GyroState::Confirmed);
    assert_eq!(judged(carried, |turn| turn + bias), GyroState::Confirmed);
    assert_eq!(judged(carried, |turn| turn * 0.9), GyroState::Confirmed);
    // A turn at a constant rate that no bias reaches.
    let turning = |_| Vector3::new(0.0, 0.1, 0.0);
    assert_eq!(judged(turning, |turn| turn + bias), GyroState::Confirmed);
}

#[test]
fn a_camera_at_rest_says_nothing() {
    let resting = |_| Vector3::zeros();
    let bias = Vector3::new(0.03, -0.02, 0.01);
    assert_eq!(judged(resting, |turn| turn + bias), GyroState::Untested);
    assert_eq!(judged(resting, |turn| turn), GyroState::Untested);
}

#[test]
fn a_wrong_gyroscope_is_refuted_with_what_is_wrong() {
    let degrees = 1_f64.to_degrees();
    let scale = |told: f64| match judged(carried, |turn| turn * told) {
        GyroState::Refuted(GyroFault::Scale { factor }) => factor,
        state => panic!("{state:?}"),
    };
    assert!((scale(degrees) / degrees - 1.0).abs() < 0.1);
    assert!((scale(1.0 / degrees) * degrees - 1.0).abs() < 0.2);
    let axes = GyroState::Refuted(GyroFault::Axes);
    assert_eq!(judged(carried, |turn| turn.zxy()), axes);
    assert_eq!(judged(carried, |turn| turn.yxz()), axes);
    assert_eq!(judged(carried, |turn| -turn), axes);
    let tilted = Rotation3::from_euler_angles(0.0, 1.5, 0.0);
    assert_eq!(judged(carried, |turn| tilted * turn), axes);
    // Constant turns and silence.
    let turning = |_| Vector3::new(0.0, 0.1, 0.0);
    assert_eq!(judged(turning, |turn| -turn), axes);
    let silent = judged(carried, |_| Vector3::zeros());
    assert_eq!(silent, GyroState::Refuted(GyroFault::Silent));
    // A slow turn.
    let slow = |span| 0.15 * carried(span);
    assert!(matches!(
        judged(slow, |turn| turn * degrees),
        GyroState::Refuted(GyroFault::Scale { .. })
    ));
}

#[test]
fn what_was_confirmed_may_be_refuted() {
    let mut trial = Trial::default();
    let mut states = Vec::new();
    for idx in 0..60 {
        let seen = carried(idx);
        let told = if idx < 20 { seen } else { -seen };
        let span = Span {
            seconds: 0.2,
            seen,
            told,
        };
        trial.judge(span, SIGMA);
        states.push(trial.state());
    }
    assert_eq!(states[19], GyroState::Confirmed);
    assert_eq!(states[59], GyroState::Refuted(GyroFault::Axes));
    // A single place that was mistaken for another does not do it.
    let mut trial = Trial::default();
    for idx in 0..20 {
        let told = carried(idx);
        let seen = if idx == 10 { -told } else { told };
        trial.judge(
            Span {
                seconds: 0.2,
                seen,
                told,
            },
            SIGMA,
        );
        assert!(idx < 5 || trial.state() == GyroState::Confirmed, "{idx}");
    }
}

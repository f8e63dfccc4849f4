use super::*;

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_seconds(seconds).unwrap()
}

/// A camera that turns at a rate for a second, read at 200 Hz.
fn turning(rate_in_camera: Vector3<f64>, bias: Vector3<f64>) -> Inertia {
    let mut inertia = Inertia::default();
    for idx in 0..=200 {
        assert!(inertia.take(ImuSample {
            captured_at: at(f64::from(idx) * 0.005),
            rate_in_camera: rate_in_camera + bias,
            specific_force_in_camera: None,
        }));
    }
    inertia
}

#[test]
fn a_constant_rate_turns_as_far_as_it_should() {
    let rate = Vector3::new(0.3, -2.0, 0.5);
    let inertia = turning(rate, Vector3::zeros());
    // Points that stand still turn the other way in the camera.
    for (from_s, to_s) in [(0.0, 1.0), (0.1234, 0.1667), (0.5, 0.503), (0.99, 1.02)] {
        let turn = inertia.turn(at(from_s), at(to_s)).unwrap();
        let expected = UnitQuaternion::from_scaled_axis(-rate * (to_s - from_s));
        assert!(turn.angle_to(&expected) < 1e-7, "{from_s} to {to_s}");
    }
}

#[test]
fn what_the_readings_do_not_cover_is_not_guessed() {
    let mut inertia = turning(Vector3::x(), Vector3::zeros());
    assert_eq!(inertia.turn(at(0.5), at(1.2)), None);
    assert_eq!(inertia.turn(at(2.0), at(2.1)), None);
    // A gap of a tenth of a second.
    let sample = |seconds| ImuSample {
        captured_at: at(seconds),
        rate_in_camera: Vector3::x(),
        specific_force_in_camera: None,
    };
    assert!(inertia.take(sample(1.1)));
    assert_eq!(inertia.turn(at(0.9), at(1.1)), None);
    assert_eq!(Inertia::default().turn(at(0.0), at(0.01)), None);
    // Old, NaN and impossible readings change nothing.
    assert!(!inertia.take(sample(1.1)));
    let nan = Vector3::new(0.0, f64::NAN, 0.0);
    for rate_in_camera in [nan, Vector3::repeat(1e6)] {
        assert!(!inertia.take(ImuSample {
            rate_in_camera,
            ..sample(1.2)
        }));
    }
}

#[test]
fn the_bias_is_learned_from_the_camera() {
    let (rate, bias) = (
        Vector3::new(0.1, 0.4, -0.2),
        Vector3::new(0.02, -0.01, 0.02),
    );
    let mut inertia = turning(rate, bias);
    let seen = UnitQuaternion::from_scaled_axis(-rate / 20.0);
    for frame in 0..200 {
        let from_s = f64::from(frame % 19) / 20.0;
        inertia.learn((at(from_s), at(from_s + 0.05)), &seen, 0.002);
    }
    assert!((inertia.bias - bias).norm() < 0.002, "{}", inertia.bias);
}

#[test]
fn up_is_kept_through_turns_and_bumps() {
    // Pitching at 1 rad/s while the vehicle shakes at 2 m/s² with 5 Hz.
    let mut inertia = Inertia::default();
    let up_at = |seconds: f64| {
        UnitQuaternion::from_scaled_axis(Vector3::x() * -seconds) * Vector3::new(0.0, -1.0, 0.0)
    };
    for idx in 0..600 {
        let seconds = f64::from(idx) * 0.005;
        let shake = Vector3::x() * (2.0 * (seconds * 31.4).sin());
        inertia.take(ImuSample {
            captured_at: at(seconds),
            rate_in_camera: Vector3::x(),
            specific_force_in_camera: Some(up_at(seconds) * STANDARD_GRAVITY + shake),
        });
    }
    let up = inertia.up_in_camera().unwrap();
    assert!(up.dot(&up_at(599.0 * 0.005)) > 0.9998, "{up:?}");
}

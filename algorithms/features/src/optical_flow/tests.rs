use camera::Image;

use super::*;
use crate::tests::{smooth_texture, view};

/// An image of the texture moved by `shift_px`.
fn moved(shift_px: Vector2<f64>, brightness: f64) -> FlowPyramid {
    let image = view(240, 180, |x, y| {
        smooth_texture(x - shift_px.x, y - shift_px.y) + brightness
    });
    FlowPyramid::new(&image, 4)
}

fn starts() -> Vec<FlowStart> {
    (0..30)
        .map(|idx| {
            let position_px = Vector2::new(
                60.3 + 20.0 * f64::from(idx % 6),
                50.7 + 18.0 * f64::from(idx / 6),
            );
            FlowStart {
                position_px,
                guess_px: position_px,
            }
        })
        .collect()
}

#[test]
fn follows_a_known_shift_under_changed_light() {
    // Quantisation to whole grey values has σ = 0.29; over 225 pixels with gradients of several
    // grey values a pixel it moves a window by less than 0.01 px, and bilinear interpolation
    // of the curved texture by a few hundredths.
    let first = moved(Vector2::zeros(), 0.0);
    for shift_px in [
        Vector2::new(0.37, -0.61),
        Vector2::new(4.25, 3.5),
        Vector2::new(-17.8, 11.3),
    ] {
        let second = moved(shift_px, 12.0);
        let mut flows = Vec::new();
        follow(
            &first,
            &second,
            &starts(),
            &FlowSettings::default(),
            &mut flows,
        );
        let mut found = 0;
        for (start, flow) in starts().iter().zip(&flows) {
            if let Flow::Found { position_px, .. } = flow {
                let error_px = (position_px - start.position_px - shift_px).norm();
                assert!(error_px < 0.06, "{shift_px} {error_px}");
                found += 1;
            }
        }
        assert!(found >= 27, "{shift_px} {found} {flows:?}");
    }
}

#[test]
fn says_why_a_point_is_lost() {
    let settings = FlowSettings::default();
    let textured = moved(Vector2::zeros(), 0.0);
    let flat = FlowPyramid::new(&Image::filled(240, 180, 90), 4);
    let check = |first: &FlowPyramid, second: &FlowPyramid, x: f64, y: f64, expected: FlowLoss| {
        let position_px = Vector2::new(x, y);
        let start = FlowStart {
            position_px,
            guess_px: position_px,
        };
        let mut flows = Vec::new();
        follow(first, second, &[start], &settings, &mut flows);
        assert_eq!(flows, [Flow::Lost(expected)], "at {x} {y}");
    };
    check(&flat, &textured, 100.0, 90.0, FlowLoss::Textureless);
    check(&textured, &textured, 2.0, 90.0, FlowLoss::OutOfImage);
    check(&textured, &textured, f64::NAN, 90.0, FlowLoss::OutOfImage);
    check(&textured, &textured, 1e300, -1e300, FlowLoss::OutOfImage);
    let tiny = FlowPyramid::new(&Image::filled(5, 300, 90), 4);
    check(&tiny, &tiny, 2.0, 100.0, FlowLoss::OutOfImage);
    check(
        &FlowPyramid::default(),
        &textured,
        90.0,
        90.0,
        FlowLoss::OutOfImage,
    );
    // Against a flat image the window slides somewhere, and there is no way back.
    let mut flows = Vec::new();
    follow(&textured, &flat, &starts(), &settings, &mut flows);
    assert!(
        flows.iter().all(|flow| matches!(flow, Flow::Lost(_))),
        "{flows:?}"
    );
}

#[test]
fn a_point_that_is_covered_does_not_return() {
    let first = moved(Vector2::zeros(), 0.0);
    let other = view(240, 180, |x, y| smooth_texture(y + 900.0, x - 400.0));
    let mut flows = Vec::new();
    follow(
        &first,
        &FlowPyramid::new(&other, 4),
        &starts(),
        &FlowSettings::default(),
        &mut flows,
    );
    let found = flows
        .iter()
        .filter(|flow| matches!(flow, Flow::Found { .. }))
        .count();
    assert!(
        found <= 3,
        "{found} of {} found in another image",
        flows.len()
    );
}

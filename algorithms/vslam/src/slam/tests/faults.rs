//! Images in which nothing can be found: the state says why, and tracking resumes.

use camera::Image;
use nalgebra::Vector3;

use super::world::{self, Pose, World};
use super::{machine, pose, stamp};
use crate::look::{Look, UsualLook};
use crate::{FrameReport, ImageFault, LostReason, StartReason, TrackingState};

/// Changes each shade by its place and itself.
fn changed(image: &Image, change: impl Fn(usize, f64) -> f64) -> Image {
    let mut image = image.clone();
    for (idx, pixel) in image.pixels_mut().iter_mut().enumerate() {
        *pixel = change(idx, f64::from(*pixel)).clamp(0.0, 255.0) as u8;
    }
    image
}

/// From -1 to 1, by the pixel.
fn noise(idx: usize) -> f64 {
    let mixed = (idx as u32).wrapping_mul(0x9E37_79B9) ^ 0x5851_F42D;
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2C1B_3C6D);
    f64::from(mixed ^ (mixed >> 13)) / f64::from(u32::MAX) * 2.0 - 1.0
}

fn blurred(image: &Image, reach_px: usize) -> Image {
    let (width, height) = (image.width(), image.height());
    changed(image, |idx, _| {
        let (x, y) = (idx % width, idx / width);
        let rows = y.saturating_sub(reach_px)..(y + reach_px + 1).min(height);
        let columns = x.saturating_sub(reach_px)..(x + reach_px + 1).min(width);
        let count = (rows.len() * columns.len()) as f64;
        let shades = rows.flat_map(|row| image.row(row)[columns.clone()].iter());
        shades.map(|shade| f64::from(*shade)).sum::<f64>() / count
    })
}

#[test]
fn what_is_wrong_with_an_image_has_a_name() {
    let world = World::new(7);
    let mut usual = UsualLook::default();
    for frame in 0..10 {
        usual.learn(&Look::of(&world.render(&pose(frame))));
    }
    let good = world.render(&pose(12));
    let noisy = changed(&good, |idx, shade| shade + 90.0 * noise(idx));
    let covered = changed(&good, |idx, _| 5.0 + 4.0 * noise(idx));
    let streaked = {
        let along_rows = |idx: usize, _| {
            let row = good.row(idx / world::WIDTH);
            let seen = &row[idx % world::WIDTH..(idx % world::WIDTH + 15).min(world::WIDTH)];
            seen.iter().map(|shade| f64::from(*shade)).sum::<f64>() / seen.len() as f64
        };
        changed(&good, along_rows)
    };
    let cases = [
        (good.clone(), None),
        (changed(&good, |_, shade| 0.8 * shade + 10.0), None),
        (
            changed(&good, |_, shade| shade * 0.12),
            Some(ImageFault::Dark),
        ),
        (covered, Some(ImageFault::Dark)),
        (
            changed(&good, |_, shade| shade * 4.0),
            Some(ImageFault::Overexposed),
        ),
        (blurred(&good, 5), Some(ImageFault::Blurred)),
        (streaked, Some(ImageFault::Blurred)),
        (noisy, Some(ImageFault::Noisy)),
        (
            changed(&good, |_, shade| shade * 0.4),
            Some(ImageFault::ExposureChanged),
        ),
        // Nothing is known of an image of one shade; that it has no corners is said elsewhere.
        (Image::filled(world::WIDTH, world::HEIGHT, 90), None),
    ];
    for (idx, (image, expected)) in cases.into_iter().enumerate() {
        assert_eq!(Look::of(&image).fault(&usual), expected, "case {idx}");
    }
    // Without anything usual only what is wrong in itself is known.
    let usual = UsualLook::default();
    assert_eq!(Look::of(&blurred(&good, 5)).fault(&usual), None);
    assert_eq!(
        Look::of(&Image::filled(1, 1, 0)).fault(&usual),
        Some(ImageFault::Dark)
    );
}

/// Frames of a walk, spoiled ones for a while, and the walk goes on.
fn interrupted(first_spoiled: usize, spoil: impl Fn(&Image) -> Image) -> Vec<FrameReport> {
    let world = World::new(7);
    let mut slam = machine();
    let spoiled = first_spoiled..first_spoiled + 30;
    let frames = 0..spoiled.end + 10;
    frames
        .map(|frame| {
            let walked = if frame < spoiled.end {
                frame.min(first_spoiled)
            } else {
                frame - 30
            };
            let image = world.render(&pose(walked));
            let image = if spoiled.contains(&frame) {
                spoil(&image)
            } else {
                image
            };
            slam.process(&image, stamp(frame)).0
        })
        .collect()
}

fn check_interrupted(reports: &[FrameReport], first_spoiled: usize, fault: ImageFault) {
    let expected = TrackingState::Lost {
        reason: LostReason::Image(fault),
    };
    let before = &reports[first_spoiled - 1];
    assert_eq!(before.state, TrackingState::Tracking);
    for report in &reports[first_spoiled..first_spoiled + 30] {
        assert_eq!(report.state, expected, "frame {}", report.frame_idx);
    }
    // Within a few frames, in the same map.
    for report in &reports[first_spoiled + 33..] {
        assert_eq!(
            report.state,
            TrackingState::Tracking,
            "frame {}",
            report.frame_idx
        );
        assert_eq!(report.map_id, before.map_id);
    }
}

#[test]
fn a_lens_that_is_covered_for_two_seconds_costs_no_map() {
    // The map is so young that it would be given up if it were the place that is unknown.
    let covered = |image: &Image| changed(image, |idx, _| 5.0 + 4.0 * noise(idx));
    check_interrupted(&interrupted(35, covered), 35, ImageFault::Dark);
}

#[test]
fn blur_and_radio_noise_are_named_and_pass() {
    let defocused = |image: &Image| blurred(image, 12);
    check_interrupted(&interrupted(35, defocused), 35, ImageFault::Blurred);
    let noisy =
        |image: &Image| changed(image, |idx, shade| 0.3 * shade + 90.0 + 160.0 * noise(idx));
    check_interrupted(&interrupted(35, noisy), 35, ImageFault::Noisy);
}

#[test]
fn hovering_and_turning_are_told_apart() {
    let world = World::new(3);
    let reason_after = |yaw_rad_per_frame: f64| {
        let mut slam = machine();
        let states = (0..15).map(|frame| {
            let turned = Pose {
                position: Vector3::zeros(),
                yaw_rad: yaw_rad_per_frame * frame as f64,
                pitch_rad: 0.0,
            };
            slam.process(&world.render(&turned), stamp(frame)).0.state
        });
        states.last().unwrap()
    };
    let starting = |reason| TrackingState::Starting { reason };
    assert_eq!(reason_after(0.01), starting(StartReason::OnlyTurned));
    assert_eq!(reason_after(0.0001), starting(StartReason::LowParallax));
}

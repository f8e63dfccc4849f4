//! The paper's pipeline: what it keeps, and what it loses.

use camera::Image;
use geometry::Timestamp;

use crate::markers::{PaperPair, PaperPipeline, PaperPipelineSettings};

fn stamp(frame_idx: i64) -> Timestamp {
    Timestamp::from_nanoseconds(50_000_000 * frame_idx)
}

/// Squares of three pixels around these places.
fn picture(places: &[[usize; 2]]) -> Image {
    let mut image = Image::filled(324, 244, 20);
    for [x, y] in places {
        for row in y - 1..=y + 1 {
            for column in x - 1..=x + 1 {
                image.pixels_mut()[row * 324 + column] = 240;
            }
        }
    }
    image
}

fn watch(frames: &[&[[usize; 2]]]) -> Vec<Option<PaperPair>> {
    let mut pipeline = PaperPipeline::new(PaperPipelineSettings::default());
    let see =
        |(idx, places): (usize, &&[[usize; 2]])| pipeline.find(&picture(places), stamp(idx as i64));
    frames.iter().enumerate().map(see).collect()
}

#[test]
fn the_closest_pair_of_plausible_direction_is_taken() {
    let found = watch(&[&[[100, 80], [100, 92], [104, 100], [130, 92]]]);
    let pair = found[0].unwrap();
    // The nearest two, (100, 92) and (104, 100), are tilted by more than 20 degrees.
    assert_eq!(pair.markers_px, [[100.0, 80.0], [100.0, 92.0]]);
    assert_eq!((pair.separation_px, pair.u_px), (12.0, 100.0));
}

#[test]
fn a_third_light_nearer_than_the_mate_is_taken_for_it() {
    // Wrong, and as the paper has it: the robust finder exists for this.
    let found = watch(&[&[[100, 80], [100, 92], [100, 98]]]);
    assert_eq!(found[0].unwrap().separation_px, 6.0);
}

#[test]
fn markers_keep_their_identity_and_the_filter_follows() {
    let found = watch(&[
        &[[100, 80], [100, 92]],
        &[[104, 80], [104, 96]],
        &[],
        &[[104, 80], [104, 96]],
        &[[200, 80], [200, 90]],
    ]);
    let [Some(first), Some(second), None, Some(again), Some(far)] = found[..] else {
        panic!("{found:?}");
    };
    assert!(first.reacquired && !second.reacquired && !again.reacquired && far.reacquired);
    assert_eq!(second.separation_raw_px, 16.0);
    // 50 ms of a low-pass of 0.2 s: a fifth of the step.
    assert!((second.separation_px - 12.8).abs() < 1e-9);
    assert!((second.u_px - 100.8).abs() < 1e-9);
    assert_eq!(far.separation_px, 10.0);
}

#[test]
fn areas_outside_the_gate_are_no_markers() {
    let mut image = picture(&[[100, 80], [100, 92]]);
    for row in 150..162 {
        image.pixels_mut()[row * 324 + 100..row * 324 + 111].fill(250);
    }
    let mut pipeline = PaperPipeline::new(PaperPipelineSettings::default());
    let pair = pipeline.find(&image, stamp(0)).unwrap();
    assert_eq!(pair.separation_px, 12.0);
    let strict = PaperPipelineSettings {
        area_px: 1..=8,
        ..PaperPipelineSettings::default()
    };
    assert_eq!(PaperPipeline::new(strict).find(&image, stamp(0)), None);
}

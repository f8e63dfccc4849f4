//! How the estimate settles, and whether it knows how well.

use super::*;

const RUN_COUNT: u64 = 30;
const STEP_COUNT: usize = 36;

/// Errors (m) and normalised squared errors at each keyframe, over many flights.
struct Flights {
    errors: Vec<Vec<f64>>,
    squared: Vec<Vec<f64>>,
}

fn flights(anchors: &[AnchorSettings], drift_scale: f64) -> Flights {
    let mut flights = Flights {
        errors: vec![Vec::new(); STEP_COUNT],
        squared: vec![Vec::new(); STEP_COUNT],
    };
    for seed in 0..RUN_COUNT {
        let mut scene = scene(500 + seed, drift_scale);
        for anchor in anchors {
            scene.publish(anchor);
        }
        for step in 0..STEP_COUNT {
            scene.step(step);
            if let Some((error, squared)) = scene.position_error() {
                flights.errors[step].push(error);
                flights.squared[step].push(squared);
            }
        }
    }
    flights
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Goal: the estimate settles as keyframes come, as in Fig. 9 of the paper. Method: the error at
/// each keyframe over 30 flights; what an anchor errs for all keyframes alike is made small, since
/// no keyframe takes that away.
#[test]
fn the_estimate_settles_and_stays() {
    let anchor = AnchorSettings {
        georeference_sigma: [2e-4, 8e-4, 3e-4],
        ..AnchorSettings::default()
    };
    let errors: Vec<f64> = flights(&[anchor], 0.5).errors[1..]
        .iter()
        .map(|errors| rms(errors))
        .collect();
    println!("error (m) of keyframe 1 and on: {errors:.4?}");
    let first = rms(&errors[..3]);
    let settled = rms(&errors[8..]);
    assert!(settled < 0.85 * first, "{first} {settled}");
    // It does not grow again: the last third against the middle one, and 20 % for chance.
    let (middle, last) = (rms(&errors[12..24]), rms(&errors[24..]));
    assert!(last < 1.2 * middle, "{middle} {last}");
}

/// Goal: what two anchors together say is as good as it claims. Method: the mean of the normalised
/// squared error over 30 flights is χ² of 90 degrees of freedom over 90, of which 95 % lie between
/// 0.73 and 1.31; at keyframes far enough apart to see other landmarks.
#[test]
fn the_fused_estimate_is_as_good_as_it_claims() {
    let anchors = [0, 1].map(votes::honest);
    let flights = flights(&anchors, 1.0);
    for step in [5, 15, 25, 35] {
        let squared = &flights.squared[step];
        assert_eq!(squared.len() as u64, RUN_COUNT);
        let mean = squared.iter().sum::<f64>() / squared.len() as f64 / 3.0;
        println!("keyframe {step}: normalised squared error {mean:.2}");
        assert!((0.73..1.31).contains(&mean), "keyframe {step}: {mean}");
    }
}

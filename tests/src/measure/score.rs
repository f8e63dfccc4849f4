//! One trajectory against the truth.

use geometry::{Enu, Map, Similarity, umeyama};
use nalgebra::Vector3;
use peer::evaluate::{Alignment, associate, trajectory_error};
use peer::files::StampedPose;

/// What a trajectory is worth; `None` where there is no answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Score {
    /// After Sim(3) alignment of the whole, metres.
    pub rmse_m: Option<f64>,
    /// Of the true path over the frames that have a pose, metres.
    pub length_m: f64,
    /// Median error of the motion over stretches of a metre, per metre.
    pub drift: Option<f64>,
    /// How much larger the last fifth is drawn than the first: 0 is none.
    pub scale_drift: Option<f64>,
}

/// The true length of a stretch.
const STRETCH_M: f64 = 1.0;
const FIFTH_PAIR_COUNT_MIN: usize = 10;

/// Judges a trajectory; poses belong together as in [`associate`].
pub fn score(truth: &[StampedPose<Enu>], estimate: &[StampedPose<Map>]) -> Score {
    let pairs: Vec<Pair> = associate(truth, estimate)
        .into_iter()
        .map(|pair| Pair {
            truth: &truth[pair.truth_idx],
            estimate: &estimate[pair.estimate_idx],
        })
        .collect();
    let length_m = lengths_m(&pairs).last().copied().unwrap_or(0.0);
    let Ok(error) = trajectory_error(truth, estimate, Alignment::Similarity) else {
        return Score {
            length_m,
            ..Score::default()
        };
    };
    let site_from_map = error.truth_from_estimate;
    Score {
        rmse_m: Some(error.rmse_m),
        length_m,
        drift: drift(&pairs, &site_from_map),
        scale_drift: scale_drift(&pairs),
    }
}

struct Pair<'a> {
    truth: &'a StampedPose<Enu>,
    estimate: &'a StampedPose<Map>,
}

impl Pair<'_> {
    fn places(&self) -> (Vector3<f64>, Vector3<f64>) {
        (
            *self.truth.target_from_camera.translation(),
            *self.estimate.target_from_camera.translation(),
        )
    }
}

/// The way until each pair.
fn lengths_m(pairs: &[Pair<'_>]) -> Vec<f64> {
    let mut length_m = 0.0;
    let mut last = None;
    let until = |pair: &Pair<'_>| {
        let (place, _) = pair.places();
        length_m += last.map_or(0.0, |last: Vector3<f64>| (place - last).norm());
        last = Some(place);
        length_m
    };
    pairs.iter().map(until).collect()
}

fn drift(pairs: &[Pair<'_>], site_from_map: &Similarity<Enu, Map>) -> Option<f64> {
    let lengths_m = lengths_m(pairs);
    let mut errors = Vec::new();
    for (from, start_m) in lengths_m.iter().enumerate() {
        let to = lengths_m.partition_point(|length_m| *length_m < start_m + STRETCH_M);
        if to >= pairs.len() {
            break;
        }
        let [begin, end] = [from, to].map(|idx| {
            let (truth, own) = pairs[idx].places();
            *site_from_map * own - truth
        });
        errors.push((end - begin).norm() / (lengths_m[to] - start_m));
    }
    errors.sort_by(f64::total_cmp);
    errors.get(errors.len() / 2).copied()
}

fn scale_drift(pairs: &[Pair<'_>]) -> Option<f64> {
    let fifth = pairs.len() / 5;
    if fifth < FIFTH_PAIR_COUNT_MIN {
        return None;
    }
    let scale = |part: &[Pair<'_>]| {
        let places = part.iter().map(|pair| {
            let (truth, estimate) = pair.places();
            (truth, estimate, 1.0)
        });
        umeyama::<Enu, Map>(places, true).ok().map(|it| it.scale())
    };
    let (first, last) = (
        scale(&pairs[..fifth])?,
        scale(&pairs[pairs.len() - fifth..])?,
    );
    Some(first / last - 1.0)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use geometry::{Timestamp, Transform, so3};

    use super::*;

    /// A helix of 20 m, in a frame turned by `turn`, drawn `scale(step)` times as large.
    fn helix<Target>(turn: Vector3<f64>, scale: impl Fn(usize) -> f64) -> Vec<StampedPose<Target>> {
        let mut place = Vector3::zeros();
        let rotation = so3::exp(&turn);
        (0..200_u32)
            .map(|step| {
                let angle_rad = 0.1 * f64::from(step);
                let ahead = Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.2);
                place += ahead * (0.1 / ahead.norm() * scale(step as usize));
                StampedPose {
                    captured_at: Timestamp::from_nanoseconds(0)
                        .after(Duration::from_millis(100) * step),
                    target_from_camera: Transform::new(
                        rotation * so3::exp(&(Vector3::z() * angle_rad)),
                        rotation * place,
                    ),
                }
            })
            .collect()
    }

    #[test]
    fn a_true_shape_in_another_frame_has_no_error() {
        let truth = helix(Vector3::zeros(), |_| 1.0);
        let score = score(&truth, &helix(Vector3::new(0.3, -0.5, 1.0), |_| 0.2));
        assert!(score.rmse_m.unwrap() < 1e-9);
        assert!((score.length_m - 19.9).abs() < 1e-9);
        assert!(score.drift.unwrap() < 1e-9);
        assert!(score.scale_drift.unwrap().abs() < 1e-9);
    }

    #[test]
    fn growing_scale_is_drift() {
        let truth = helix(Vector3::zeros(), |_| 1.0);
        // The middles of first and last fifth are 160 of 200 steps apart.
        let grown = helix(Vector3::zeros(), |step| 1.0 + 0.1 * step as f64 / 160.0);
        let score = score(&truth, &grown);
        assert!((score.scale_drift.unwrap() - 0.1).abs() < 0.01, "{score:?}");
        assert!((0.005..0.06).contains(&score.drift.unwrap()), "{score:?}");
    }

    #[test]
    fn what_never_ran_has_no_score() {
        let truth = helix(Vector3::zeros(), |_| 1.0);
        assert_eq!(score(&truth, &[]), Score::default());
    }
}

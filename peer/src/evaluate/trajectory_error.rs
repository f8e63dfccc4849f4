//! The absolute trajectory error.

use geometry::{DegenerateAlignment, Similarity, umeyama};
use nalgebra::Vector3;

use super::associate;
use crate::files::StampedPose;

/// What is taken out of the estimate before it is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// Nothing: the estimate claims to be in the truth's frame.
    None,
    /// Position and orientation of the whole.
    Rigid,
    /// Position, orientation and scale of the whole, as for maps of unknown scale.
    Similarity,
}

/// Distances between positions of the same frames, metres.
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryError<Truth, Estimate> {
    pub pair_count: usize,
    pub rmse_m: f64,
    pub mean_m: f64,
    pub median_m: f64,
    pub max_m: f64,
    pub truth_from_estimate: Similarity<Truth, Estimate>,
}

/// Why there is no error to report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotComparable {
    #[error("no pose of the estimate has a time stamp of the truth")]
    NoPairs,
    #[error("cannot align {pair_count} poses: {}", reason(.why))]
    Degenerate {
        pair_count: usize,
        why: DegenerateAlignment,
    },
}

fn reason(why: &DegenerateAlignment) -> &'static str {
    match why {
        DegenerateAlignment::TooFewPairs => "too few",
        DegenerateAlignment::Collinear => "they lie on a line",
    }
}

/// Compares the positions of two trajectories, paired by their time stamps.
///
/// The alignment is that of Umeyama (1991), as in the field's tools.
pub fn trajectory_error<Truth, Estimate>(
    truth: &[StampedPose<Truth>],
    estimate: &[StampedPose<Estimate>],
    alignment: Alignment,
) -> Result<TrajectoryError<Truth, Estimate>, NotComparable> {
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = associate(truth, estimate)
        .into_iter()
        .map(|pair| {
            (
                *truth[pair.truth_idx].target_from_camera.translation(),
                *estimate[pair.estimate_idx].target_from_camera.translation(),
            )
        })
        .collect();
    if pairs.is_empty() {
        return Err(NotComparable::NoPairs);
    }
    let truth_from_estimate = match alignment {
        Alignment::None => Similarity::identity(),
        Alignment::Rigid | Alignment::Similarity => umeyama(
            pairs.iter().map(|(truth, own)| (*truth, *own, 1.0)),
            alignment == Alignment::Similarity,
        )
        .map_err(|why| NotComparable::Degenerate {
            pair_count: pairs.len(),
            why,
        })?,
    };
    let mut errors_m: Vec<f64> = pairs
        .iter()
        .map(|(truth, own)| (truth_from_estimate * *own - truth).norm())
        .collect();
    let rmse_m = root_mean_square(&errors_m);
    let mean_m = errors_m.iter().sum::<f64>() / errors_m.len() as f64;
    Ok(TrajectoryError {
        pair_count: errors_m.len(),
        rmse_m,
        mean_m,
        median_m: median(&mut errors_m),
        max_m: errors_m.iter().copied().fold(0.0, f64::max),
        truth_from_estimate,
    })
}

/// Of a list that is not empty.
pub(super) fn root_mean_square(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().map(|value| value * value).sum();
    (sum / values.len() as f64).sqrt()
}

/// Of a list that is not empty; the mean of the middle two where their number is even.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 {
        values[middle]
    } else {
        0.5 * (values[middle - 1] + values[middle])
    }
}

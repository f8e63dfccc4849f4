//! How good a trajectory is, measured against the truth. Pure: trajectories in, numbers out.

mod association;
mod baseline;
mod consistency;
mod swarm;
mod trajectory_error;

use geometry::{Enu, Map};
use nalgebra::Matrix3;
use serde::Serialize;

use crate::files::StampedPose;

pub use association::{Pair, associate};
pub use baseline::{BaselineSettings, drift_rmse_m, rough_start_rmse_m};
pub use consistency::{Consistency, consistency};
pub use swarm::SwarmScore;
pub use trajectory_error::{Alignment, NotComparable, TrajectoryError, trajectory_error};

/// Poses farther apart in time than this are not of the same frame, seconds.
pub const STAMP_TOLERANCE_S: f64 = 0.01;

/// What a vehicle of a team left behind, and the truth.
#[derive(Clone, Copy, Debug)]
pub struct VehicleRecord<'a> {
    pub truth: &'a [StampedPose<Enu>],
    /// The poses as they were published, only while the state was `Global`.
    pub causal: &'a [StampedPose<Enu>],
    /// The covariance of each causal position, square metres.
    pub covariances: &'a [Matrix3<f64>],
    /// The trajectory after all corrections.
    pub corrected: &'a [StampedPose<Enu>],
    /// The vehicle's own poses as they were published, in its own map and its unit.
    pub own: &'a [StampedPose<Map>],
    /// Frames given to the vehicle, from the first on.
    pub frame_count: usize,
}

/// The numbers of a vehicle in the command line's contract; `None` where there is no answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct VehicleScore {
    /// Causal poses per frame given to the vehicle, which also the vehicle itself can tell.
    #[serde(skip)]
    pub global_share: Option<f64>,
    pub inside_3sigma_share: Option<f64>,
    pub nees_mean: Option<f64>,
    /// Of the causal positions, without any alignment to the truth.
    pub rmse_m: Option<f64>,
    /// Of the corrected positions, without any alignment to the truth.
    pub rmse_final_m: Option<f64>,
    /// How many times worse the vehicle's own trajectory is from a rough start.
    pub ratio: Option<f64>,
    /// How many times worse it is when only its drift counts.
    pub ratio_ideal: Option<f64>,
}

/// Judges one vehicle. The same record and settings give the same score.
pub fn judge(record: &VehicleRecord<'_>, settings: &BaselineSettings) -> VehicleScore {
    let unaligned = |estimate: &[StampedPose<Enu>]| {
        trajectory_error(record.truth, estimate, Alignment::None)
            .ok()
            .map(|error| error.rmse_m)
    };
    let rmse_m = unaligned(record.causal);
    let per_rmse = |baseline_m: Option<f64>| match (baseline_m, rmse_m) {
        (Some(baseline_m), Some(rmse_m)) if rmse_m > 0.0 => Some(baseline_m / rmse_m),
        _ => None,
    };
    let Consistency {
        inside_3sigma_share,
        nees_mean,
    } = consistency(record.truth, record.causal, record.covariances);
    VehicleScore {
        global_share: (record.frame_count > 0)
            .then(|| record.causal.len() as f64 / record.frame_count as f64),
        inside_3sigma_share,
        nees_mean,
        rmse_m,
        rmse_final_m: unaligned(record.corrected),
        ratio: per_rmse(rough_start_rmse_m(
            record.truth,
            record.own,
            record.causal,
            settings,
        )),
        ratio_ideal: per_rmse(drift_rmse_m(
            record.truth,
            record.own,
            record.causal,
            settings,
        )),
    }
}

#[cfg(test)]
mod tests;

//! What a vehicle knows of where it is, and why not more, for a person to read.

use protocol::VehicleState;
use vslam::{FrameReport, TrackingState};

/// State and reason, as published with every pose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    pub state: VehicleState,
    pub reason: String,
}

/// What ties the own map to the Earth, seen from the rule that decides the state.
#[derive(Clone, Debug)]
pub enum Tie {
    /// Nothing yet, and why.
    None {
        reason: String,
    },
    Known(KnownTie),
}

/// An estimate of where the own map stands.
#[derive(Clone, Debug)]
pub struct KnownTie {
    /// Since the newest accepted alignment or fix.
    pub age_s: f64,
    /// One sigma of the position along its worst axis; `None` without a pose.
    pub position_sigma_m: Option<f64>,
    /// Why it is not to be trusted, such as anchors that contradict each other.
    pub objection: Option<String>,
    /// What the estimate rests on.
    pub basis: String,
}

/// Limits of DESIGN section 2.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub stale_after_s: f64,
    pub global_sigma_m: f64,
}

impl Status {
    pub fn start() -> Self {
        Self {
            state: VehicleState::NoMap,
            reason: "no frame yet".to_owned(),
        }
    }

    /// The state after a frame.
    ///
    /// - `was_global`: the vehicle has been global in this flight.
    pub fn after(report: &FrameReport, tie: &Tie, limits: &Limits, was_global: bool) -> Self {
        let tracking = report.map_from_camera.is_some();
        let starting = matches!(report.state, TrackingState::Starting { .. });
        let fallback = |known: bool| match (was_global, known) {
            (true, _) => VehicleState::GlobalStale,
            (false, _) if starting => VehicleState::NoMap,
            (false, true) => VehicleState::LocalMetric,
            (false, false) => VehicleState::LocalUnscaled,
        };
        let state_and_reason = |state, reason: String| Self { state, reason };
        match (&report.state, tie) {
            (state, Tie::Known(known)) if known.position_sigma_m.is_none() && !tracking => {
                state_and_reason(fallback(true), state.to_string())
            }
            (_, Tie::Known(known)) => match known.objection(limits) {
                Some(objection) => state_and_reason(fallback(true), objection),
                None => state_and_reason(VehicleState::Global, known.basis.clone()),
            },
            (state, Tie::None { reason }) if !tracking => {
                state_and_reason(fallback(false), format!("{state}; {reason}"))
            }
            (_, Tie::None { reason }) => state_and_reason(fallback(false), reason.clone()),
        }
    }
}

impl KnownTie {
    fn objection(&self, limits: &Limits) -> Option<String> {
        if self.objection.is_some() {
            return self.objection.clone();
        }
        if self.age_s > limits.stale_after_s {
            return Some(format!("nothing accepted for {:.0} s", self.age_s));
        }
        match self.position_sigma_m {
            Some(sigma_m) if sigma_m <= limits.global_sigma_m => None,
            Some(sigma_m) => Some(format!(
                "position sigma is {sigma_m:.2} m, more than {:.2} m",
                limits.global_sigma_m
            )),
            None => Some("the pose has no covariance".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use geometry::Timestamp;
    use vslam::{MapId, StartReason};

    use super::*;

    const LIMITS: Limits = Limits {
        stale_after_s: 10.0,
        global_sigma_m: 0.5,
    };

    /// A camera that hovers: it has no map of its own, and so no pose in one.
    fn hovering() -> FrameReport {
        FrameReport {
            frame_idx: 0,
            captured_at: Timestamp::default(),
            map_id: MapId(0),
            map_revision: 0,
            state: TrackingState::Starting {
                reason: StartReason::LowParallax,
            },
            map_from_camera: None,
            pose_covariance: None,
            inlier_count: 0,
            keypoint_count: 500,
        }
    }

    fn tie(position_sigma_m: Option<f64>) -> Tie {
        Tie::Known(KnownTie {
            age_s: 0.0,
            position_sigma_m,
            objection: None,
            basis: "single frames".to_owned(),
        })
    }

    #[test]
    fn a_hovering_vehicle_is_global_or_without_a_map_and_nothing_between() {
        let none = Tie::None {
            reason: "no chunk".to_owned(),
        };
        for (tie, was_global, expected) in [
            (none.clone(), false, VehicleState::NoMap),
            (tie(Some(0.02)), false, VehicleState::Global),
            (tie(Some(0.8)), false, VehicleState::NoMap),
            (tie(Some(0.8)), true, VehicleState::GlobalStale),
            (tie(None), false, VehicleState::NoMap),
            (none, true, VehicleState::GlobalStale),
        ] {
            let status = Status::after(&hovering(), &tie, &LIMITS, was_global);
            assert_eq!(status.state, expected, "{tie:?}");
        }
    }
}

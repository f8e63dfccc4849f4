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
        let fallback = |known: bool| match (was_global, known) {
            (true, _) => VehicleState::GlobalStale,
            (false, true) => VehicleState::LocalMetric,
            (false, false) => VehicleState::LocalUnscaled,
        };
        let state_and_reason = |state, reason: String| Self { state, reason };
        match (&report.state, tie) {
            (TrackingState::Starting { .. }, _) if !was_global => {
                state_and_reason(VehicleState::NoMap, report.state.to_string())
            }
            (state, Tie::Known(_)) if !tracking => {
                state_and_reason(fallback(true), state.to_string())
            }
            (state, Tie::None { reason }) if !tracking => {
                state_and_reason(fallback(false), format!("{state}; {reason}"))
            }
            (_, Tie::None { reason }) => state_and_reason(fallback(false), reason.clone()),
            (_, Tie::Known(known)) => match known.objection(limits) {
                Some(objection) => state_and_reason(fallback(true), objection),
                None => state_and_reason(VehicleState::Global, known.basis.clone()),
            },
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

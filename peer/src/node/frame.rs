//! Frame in, pose out.

use std::sync::Arc;

use camera::Image;
use geodesy::Datum;
use geometry::{Body, Camera, Enu, Map, Matrix7, Similarity, Timestamp, Transform, so3};
use nalgebra::{Matrix3, Matrix6, SMatrix};
use protocol::keys::Key;
use protocol::sync::SyncEvent;
use protocol::{GlobalPose, Pose, VehicleState, encode};
use vslam::FrameReport;

use super::anchor_role::Outlet;
use super::peer_role::PeerRole;
use super::status::{KnownTie, Limits, Status, Tie};
use super::{Effect, FramePose, GlobalFramePose, Node, Role};
use crate::link::Class;

/// A pose on the Earth with its covariance `[ω; p]` in the global axes, and what the state rests
/// on.
pub(super) struct TiedPose {
    pub tie: Tie,
    pub pose: Option<(Transform<Enu, Camera>, Matrix6<f64>)>,
    pub datum: Option<Datum>,
    pub jump_count: u64,
}

impl Node {
    pub(super) fn take_frame(
        &mut self,
        image: &Image,
        captured_at: Timestamp,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) {
        self.exchange.tell(SyncEvent::Tick, now, effects);
        let report = self.slam.process(image, captured_at);
        let tied = match &mut self.role {
            Role::Peer(role) => {
                role.take_frame(&report, self.slam.map());
                tie_to_anchors(role, &report, now)
            }
            Role::Anchor(role) => {
                let mut outlet = Outlet {
                    shelf: &mut self.shelf,
                    exchange: &mut self.exchange,
                    counters: &mut self.counters,
                    effects,
                    now,
                };
                role.take_frame(&report, self.slam.map(), &mut outlet);
                role.tie(&report, now)
            }
        };
        self.counters.jumps = tied.jump_count;
        let limits = Limits {
            stale_after_s: self.settings.stale_after_s,
            global_sigma_m: self.global_sigma_m(),
        };
        self.status = Status::after(&report, &tied.tie, &limits, self.was_global);
        let is_global = self.status.state == VehicleState::Global;
        self.was_global |= is_global;
        let global = tied
            .pose
            .filter(|_| is_global)
            .map(|(enu_from_camera, covariance)| {
                let enu_from_body = enu_from_camera * self.calibration.body_from_camera.inverse();
                GlobalFramePose {
                    enu_from_camera,
                    position_covariance: position_block(&covariance),
                    body_covariance: in_body_axes(&covariance, &enu_from_body),
                    enu_from_body,
                }
            });
        self.publish_pose(
            captured_at,
            global.as_ref().zip(tied.datum.as_ref()),
            effects,
        );
        effects.push(Effect::Posed(Box::new(FramePose {
            captured_at,
            state: self.status.state,
            global,
            map_from_camera: report.map_from_camera,
            map_id: report.map_id,
        })));
    }

    fn publish_pose(
        &mut self,
        captured_at: Timestamp,
        global: Option<(&GlobalFramePose, &Datum)>,
        effects: &mut Vec<Effect>,
    ) {
        if !self.pose_is_due(captured_at) {
            return;
        }
        let global = global.map(|(pose, datum)| GlobalPose {
            datum: datum.clone(),
            enu_from_body: pose.enu_from_body,
            covariance: pose.body_covariance,
            geodetic: datum.geodetic(pose.enu_from_body.translation(), &[]).ok(),
        });
        let message = Pose {
            vehicle: self.settings.id.clone(),
            captured_at,
            state: self.status.state,
            reason: self.status.reason.clone(),
            jump_count: u32::try_from(self.counters.jumps).unwrap_or(u32::MAX),
            global,
        };
        effects.push(Effect::Publish {
            class: Class::Telemetry,
            key: Key::Pose(self.settings.id.clone()),
            payload: Arc::from(encode(&message)),
        });
    }

    /// At most ten poses a second.
    fn pose_is_due(&mut self, captured_at: Timestamp) -> bool {
        // A tenth less, so that a camera of 10 Hz with jitter has each of its poses published.
        const PERIOD_MIN_S: f64 = 0.09;
        let due = self
            .pose_published_at
            .is_none_or(|earlier| captured_at - earlier >= PERIOD_MIN_S);
        if due {
            self.pose_published_at = Some(captured_at);
        }
        due
    }
}

fn tie_to_anchors(role: &PeerRole, report: &FrameReport, now: Timestamp) -> TiedPose {
    let Some(estimate) = role.estimate(now) else {
        return TiedPose {
            tie: Tie::None {
                reason: role.reason(),
            },
            pose: None,
            datum: role.datum().cloned(),
            jump_count: 0,
        };
    };
    let pose = report.map_from_camera.as_ref().map(|map_from_camera| {
        let covariance = estimate.pose_covariance(map_from_camera, report.pose_covariance.as_ref());
        (estimate.enu_from_camera(map_from_camera), covariance)
    });
    let objection = estimate.conflict.then(|| {
        let others = role.names(&estimate.inconsistent_anchors);
        format!(
            "conflict: {} and {others} contradict each other",
            role.names(&estimate.anchors)
        )
    });
    let tie = Tie::Known(KnownTie {
        age_s: estimate.age_s,
        position_sigma_m: pose
            .as_ref()
            .map(|(_, covariance)| worst_sigma_m(covariance)),
        objection,
        basis: format!("registered to {}", role.names(&estimate.anchors)),
    });
    TiedPose {
        tie,
        pose,
        datum: role.datum().cloned(),
        jump_count: estimate.jump_count,
    }
}

/// The covariance of a camera's pose in the global frame, `[ω; p]` in the global axes.
///
/// - `map_covariance`: of `enu_from_map`, `[ω; ν; ln s]`, right perturbation.
/// - `own_covariance`: of `map_from_camera`, `[ω; ν]`, right perturbation.
pub(super) fn pose_covariance(
    enu_from_map: &Similarity<Enu, Map>,
    map_covariance: &Matrix7,
    map_from_camera: &Transform<Map, Camera>,
    own_covariance: Option<&Matrix6<f64>>,
) -> Matrix6<f64> {
    // S exp(δ) x ≈ S x + s R (ω × x + ν + λ x).
    let linear = enu_from_map.linear_matrix();
    let rotation = linear / enu_from_map.scale();
    let position = map_from_camera.translation();
    let mut d_pose_d_map = SMatrix::<f64, 6, 7>::zeros();
    d_pose_d_map
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&rotation);
    d_pose_d_map
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(-linear * so3::hat(position)));
    d_pose_d_map.fixed_view_mut::<3, 3>(3, 3).copy_from(&linear);
    d_pose_d_map
        .fixed_view_mut::<3, 1>(3, 6)
        .copy_from(&(linear * position));
    let mut covariance = d_pose_d_map * map_covariance * d_pose_d_map.transpose();
    if let Some(own_covariance) = own_covariance {
        let axes = map_from_camera.rotation_matrix();
        let mut d_pose_d_own = Matrix6::zeros();
        d_pose_d_own
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(rotation * axes));
        d_pose_d_own
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(linear * axes));
        covariance += d_pose_d_own * own_covariance * d_pose_d_own.transpose();
    }
    covariance
}

fn position_block(covariance: &Matrix6<f64>) -> Matrix3<f64> {
    covariance.fixed_view::<3, 3>(3, 3).into_owned()
}

/// One sigma along the axis that is known worst.
pub(super) fn worst_sigma_m(covariance: &Matrix6<f64>) -> f64 {
    let eigenvalues = position_block(covariance).symmetric_eigenvalues();
    eigenvalues.max().max(0.0).sqrt()
}

/// From `[ω; p]` in the global axes about the camera to `[ω; ν]` in the body's axes. The lever
/// between body and camera is centimetres, and its share of the covariance is left out.
fn in_body_axes(covariance: &Matrix6<f64>, enu_from_body: &Transform<Enu, Body>) -> Matrix6<f64> {
    let body_axes = enu_from_body.rotation_matrix().transpose();
    let mut turn = Matrix6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&body_axes);
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&body_axes);
    let turned = turn * covariance * turn.transpose();
    (turned + turned.transpose()) * 0.5
}

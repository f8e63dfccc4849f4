//! Frame in, pose out; then what the frame means for the own map.

use std::sync::Arc;

use camera::Image;
use geodesy::Datum;
use geometry::{Body, Enu, Timestamp, Transform};
use nalgebra::Matrix6;
use protocol::keys::Key;
use protocol::sync::SyncEvent;
use protocol::{GlobalPose, Pose, VehicleState, encode};

use super::outlet::Outlet;
use super::status::{Limits, Status};
use super::tied_pose::position_block;
use super::{Effect, FramePose, GlobalFramePose, Node, Role};
use crate::link::Class;

impl Node {
    pub(super) fn take_frame(
        &mut self,
        image: &Image,
        captured_at: Timestamp,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) {
        self.exchange.tell(SyncEvent::Tick, now, effects);
        self.map_frame(now, effects);
        let extracted = self.front_end.extract(image, captured_at);
        let single_frame = match &self.role {
            Role::Peer(role) => role.observe_frame(&extracted),
            Role::Anchor(_) => None,
        };
        let report = self.slam.track(extracted);
        let limits = Limits {
            stale_after_s: self.settings.stale_after_s,
            global_sigma_m: self.global_sigma_m(),
        };
        let mut outlet = Outlet {
            shelf: &mut self.shelf,
            exchange: &mut self.exchange,
            counters: &mut self.counters,
            effects,
            now,
        };
        let tied = match &mut self.role {
            Role::Peer(role) => {
                role.enter_map(report.map_id, self.slam.map(), &mut outlet);
                role.tie((&report, single_frame), &limits, now)
            }
            Role::Anchor(role) => {
                role.enter_map(report.map_id, self.slam.map(), &mut outlet);
                role.tie(&report, now)
            }
        };
        self.counters.jumps = tied.jump_count;
        self.counters.overruled = tied.overruled_count;
        if let Role::Peer(role) = &self.role {
            self.counters.circular = role.circular_count();
        }
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
        self.unmapped = Some(report);
    }

    /// Does what the newest frame leaves to do, unless that is done.
    pub(super) fn map_frame(&mut self, now: Timestamp, effects: &mut Vec<Effect>) {
        let Some(report) = self.unmapped.take() else {
            return;
        };
        let mapped = self.slam.map_frame();
        let is_global = self.status.state == VehicleState::Global;
        let mut outlet = Outlet {
            shelf: &mut self.shelf,
            exchange: &mut self.exchange,
            counters: &mut self.counters,
            effects,
            now,
        };
        let map = self.slam.map();
        match &mut self.role {
            Role::Peer(role) => {
                // Mapping may have joined the map to another.
                role.enter_map(mapped.map_id, map, &mut outlet);
                role.follow_map((&report, &mapped), map);
                let by_map = is_global && !role.handover.rests_on_frames();
                role.share_map((&report, &mapped), map, by_map, &mut outlet);
            }
            Role::Anchor(role) => {
                role.enter_map(mapped.map_id, map, &mut outlet);
                role.follow_map((&report, &mapped), map, &mut outlet);
            }
        }
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

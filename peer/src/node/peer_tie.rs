//! What a vehicle without a position source knows of where it is: by its own map, by single frames,
//! or by both.

use geometry::Timestamp;
use registration::localizer::Verdict;
use registration::{Estimate, FrameLocation, FrameObservation, NearPose, ObservedFeature};
use vslam::{ExtractedFrame, FrameReport};

use super::handover::GlobalCamera;
use super::peer_role::PeerRole;
use super::status::{KnownTie, Limits, Tie};
use super::tied_pose::TiedPose;

impl PeerRole {
    /// A frame to be located by itself; `None` where there is nothing to locate it in.
    pub fn observe_frame(&self, extracted: &ExtractedFrame) -> Option<FrameObservation> {
        if self.localizer.landmark_count() == 0 {
            return None;
        }
        let features = extracted.observations().iter().map(|one| ObservedFeature {
            position: one.position,
            sigma: one.sigma,
            descriptor: one.descriptor,
            point: None,
        });
        Some(FrameObservation {
            captured_at: extracted.captured_at(),
            features: features.collect(),
        })
    }

    /// Where the camera is, and what that rests on.
    pub(super) fn tie(
        &mut self,
        (report, single_frame): (&FrameReport, Option<FrameObservation>),
        limits: &Limits,
        now: Timestamp,
    ) -> TiedPose {
        let estimate = self.estimate(now);
        let by_map = estimate
            .as_ref()
            .and_then(|estimate| pose_by_map(estimate, report));
        let good = by_map.as_ref().zip(estimate.as_ref());
        let good = good.is_some_and(|(pose, estimate)| {
            pose.sigma_m() <= limits.global_sigma_m && estimate.age_s <= limits.stale_after_s
        });
        // Frames find themselves in one anchor's map and know nothing of a conflict with others.
        let in_conflict = estimate.as_ref().is_some_and(|estimate| estimate.conflict);
        let wanted = !in_conflict && (!good || !self.handover.is_over());
        let located = single_frame
            .filter(|_| wanted)
            .and_then(|frame| self.locate(&frame));
        let by_frame = located.map(|located| GlobalCamera {
            enu_from_camera: located.enu_from_camera,
            covariance: located.covariance,
            depth_m: located.depth_m,
        });
        // A map that is not good enough leaves the word to single frames that are there.
        let told_by_map = by_map.filter(|_| good || by_frame.is_none());
        let pose = self
            .handover
            .pose(report.captured_at, told_by_map, by_frame);
        let by_frames = by_frame.is_some() && self.handover.rests_on_frames();
        let tie = match (located.filter(|_| by_frames), &estimate) {
            (Some(located), _) => self.tie_by_frame(&located, pose.as_ref()),
            (None, Some(estimate)) => self.tie_by_map(estimate, pose.as_ref()),
            (None, None) => Tie::None {
                reason: self.reason(),
            },
        };
        TiedPose {
            tie,
            pose: pose.map(|pose| (pose.enu_from_camera, pose.covariance)),
            datum: self.datum().cloned(),
            jump_count: self.localizer.jump_count() + self.handover.jump_count(),
            overruled_count: self.localizer.overruled_count(),
        }
    }

    fn locate(&mut self, frame: &FrameObservation) -> Option<FrameLocation> {
        let near = self.handover.near(frame.captured_at);
        let near = near.map(|(captured_at, pose)| NearPose {
            captured_at,
            enu_from_camera: pose.enu_from_camera,
        });
        let located = self.localizer.observe_frame(frame, near.as_ref());
        self.frame_verdict = Some(match &located {
            Ok(_) => Verdict::Accepted,
            Err(verdict) => *verdict,
        });
        located.ok()
    }

    fn tie_by_frame(&self, located: &FrameLocation, pose: Option<&GlobalCamera>) -> Tie {
        Tie::Known(KnownTie {
            age_s: 0.0,
            position_sigma_m: pose.map(GlobalCamera::sigma_m),
            objection: None,
            basis: format!(
                "single frames located among the chunks of {}",
                self.names_with_sources(&[located.anchor])
            ),
        })
    }

    fn tie_by_map(&self, estimate: &Estimate, pose: Option<&GlobalCamera>) -> Tie {
        let names = self.names(estimate.anchors.iter().copied());
        let left_out = self.names_of(&estimate.left_out);
        let objection = estimate
            .conflict
            .then(|| format!("conflict: {names} and {left_out} contradict each other"));
        let names = self.names_with_sources(&estimate.anchors);
        let basis = if left_out.is_empty() {
            format!("registered to {names}")
        } else {
            format!("registered to {names}; {left_out} contradicts and is left out")
        };
        Tie::Known(KnownTie {
            age_s: estimate.age_s,
            position_sigma_m: pose.map(GlobalCamera::sigma_m),
            objection,
            basis,
        })
    }
}

fn pose_by_map(estimate: &Estimate, report: &FrameReport) -> Option<GlobalCamera> {
    let map_from_camera = report.map_from_camera.as_ref()?;
    Some(GlobalCamera {
        enu_from_camera: estimate.enu_from_camera(map_from_camera),
        covariance: estimate.pose_covariance(map_from_camera, report.pose_covariance.as_ref()),
        depth_m: estimate.depth_in_map * estimate.enu_from_map.scale(),
    })
}

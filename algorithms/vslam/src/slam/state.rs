//! Which frames are looked at, and what is the matter when there is no pose.

use super::{ExtractedFrame, Mode, Vslam};
use crate::frame::Frame;
use crate::{FrameRefusal, LostReason, StartReason, TrackingState};

impl Vslam {
    pub(super) fn admit(&self, extracted: ExtractedFrame) -> Result<Frame, FrameRefusal> {
        let frame = extracted.content?;
        let is_newer = self.newest_at.is_none_or(|at| extracted.captured_at > at);
        is_newer.then_some(frame).ok_or(FrameRefusal::OutOfOrder)
    }

    pub(super) fn refused(&self, refusal: FrameRefusal) -> TrackingState {
        match self.mode {
            Mode::Starting(_) => TrackingState::Starting {
                reason: StartReason::Refused(refusal),
            },
            Mode::Recalling { .. } | Mode::Following { .. } => TrackingState::Lost {
                reason: LostReason::Refused(refusal),
            },
        }
    }

    /// Blames the image where that is what is wrong.
    pub(super) fn explain(&mut self, state: TrackingState) -> TrackingState {
        let fault = self.look.fault(&self.usual_look);
        match (state, fault) {
            (TrackingState::Tracking, _) => self.usual_look.learn(&self.look),
            (TrackingState::Lost { .. }, Some(fault)) => {
                let reason = LostReason::Image(fault);
                return TrackingState::Lost { reason };
            }
            (
                TrackingState::Starting {
                    reason: StartReason::FewKeypoints | StartReason::FewMatches,
                },
                Some(fault),
            ) => {
                let reason = StartReason::Image(fault);
                return TrackingState::Starting { reason };
            }
            _ => {}
        }
        state
    }
}

//! A recording with a file of fixes.

use std::collections::VecDeque;

use anchor::PositionFix;
use anyhow::Context;
use camera::Calibration;
use geometry::Timestamp;

use super::{Input, Source};
use crate::config::VehicleConfig;
use crate::dataset::{
    CalibrationFile, Camera, CameraEvent, Dataset, DatasetArgument, DatasetCamera,
};

/// Images of a folder, and between them the fixes of the same time.
pub struct Recording {
    camera: DatasetCamera,
    calibration: Calibration,
    first_captured_at: Option<Timestamp>,
    fixes: VecDeque<PositionFix>,
    /// Lines of fixes that were left out.
    skipped: Option<Input>,
    pending: Option<CameraEvent>,
}

impl Recording {
    /// - `calibration`: instead of the one that the recording brings.
    pub fn open(
        config: &VehicleConfig,
        argument: &DatasetArgument,
        calibration: Option<CalibrationFile>,
    ) -> anyhow::Result<Self> {
        let dataset = Dataset::open_calibrated(argument, calibration)?;
        let stamps = dataset.frames().iter().map(|frame| frame.captured_at);
        let (first, last) = (stamps.clone().min(), stamps.max());
        let mut fixes = VecDeque::new();
        let mut skipped = None;
        let position = config.position.as_ref();
        if let Some((position, path)) = position.and_then(|one| Some((one, one.file.as_ref()?))) {
            let file = crate::position::read_fixes(position, path)?;
            let (first, last) = first.zip(last).context("the recording has no frame")?;
            // What the vehicle has not flown yet, or not any more, is none of its business.
            fixes = file.within(first, last)?.into();
            skipped = file.warning().map(|reason| Input::FixesLeftOut {
                count: file.skipped.len() as u64,
                reason,
            });
        }
        let calibration = dataset.calibration().clone();
        let camera = if config.estimation.threads > 1 {
            DatasetCamera::decoding_ahead(dataset)
        } else {
            DatasetCamera::inline(dataset)
        };
        Ok(Self {
            camera,
            calibration,
            first_captured_at: first,
            fixes,
            skipped,
            pending: None,
        })
    }
}

impl Source for Recording {
    fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    fn first_captured_at(&self) -> Option<Timestamp> {
        self.first_captured_at
    }

    fn next_input(&mut self) -> Option<Input> {
        if let Some(skipped) = self.skipped.take() {
            return Some(skipped);
        }
        let Some(event) = self.pending.take().or_else(|| self.camera.next_event()) else {
            return self.fixes.pop_front().map(Input::Fix);
        };
        let captured_at = event.captured_at();
        let due = self
            .fixes
            .front()
            .is_some_and(|fix| fix.captured_at <= captured_at);
        if due && let Some(fix) = self.fixes.pop_front() {
            self.pending = Some(event);
            return Some(Input::Fix(fix));
        }
        Some(match event {
            CameraEvent::Frame(frame) => Input::Frame {
                captured_at,
                image: frame.image,
            },
            CameraEvent::Unreadable { error, .. } => Input::Unreadable {
                captured_at,
                reason: error.to_string(),
            },
        })
    }

    fn acknowledge(&mut self, _captured_at: Timestamp) {}

    fn is_recorded(&self) -> bool {
        true
    }
}

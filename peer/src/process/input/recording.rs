//! A recording with a file of fixes.

use std::collections::VecDeque;

use anchor::PositionFix;
use anyhow::Context;
use camera::Calibration;
use geometry::Timestamp;

use super::{Input, Source};
use crate::config::VehicleConfig;
use crate::dataset::{
    Camera, CameraEvent, Dataset, DatasetArgument, DatasetCamera, RecordingOptions,
};

/// Images of a recording, and between them the fixes of the same time.
pub struct Recording {
    camera: DatasetCamera,
    calibration: Calibration,
    first_captured_at: Option<Timestamp>,
    fixes: VecDeque<PositionFix>,
    /// Lines of fixes that were left out.
    skipped: Option<Input>,
    pending: Option<CameraEvent>,
    /// Of what should have been in the recording.
    loss: Option<String>,
}

impl Recording {
    pub fn open(config: &VehicleConfig, argument: &DatasetArgument) -> anyhow::Result<Self> {
        let options = RecordingOptions {
            calibration: config.camera.calibration.clone(),
            topic: config.camera.topic.clone(),
            ..RecordingOptions::default()
        };
        let dataset = Dataset::open_with(argument, &options)?;
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
        let loss = (!dataset.losses().is_empty()).then(|| dataset.losses().join("; "));
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
            loss,
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
            let fix = self.fixes.pop_front().map(Input::Fix);
            let broken_off = |reason| Input::BrokenOff { reason };
            return fix.or_else(|| self.loss.take().map(broken_off));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_that_was_cut_off_breaks_off_after_its_images() {
        let folder = tempfile::tempdir().unwrap();
        let mut film = b"YUV4MPEG2 W32 H24 F10:1 Cmono\nFRAME\n".to_vec();
        film.resize(film.len() + 32 * 24, 90);
        film.extend_from_slice(b"FRAME\nhalf");
        std::fs::write(folder.path().join("film.y4m"), film).unwrap();
        let camera = "intrinsics: [30, 30, 16, 12]\nresolution: [32, 24]\n";
        std::fs::write(folder.path().join("own.yaml"), camera).unwrap();
        let text = "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\n";
        let mut config: VehicleConfig = toml::from_str(text).unwrap();
        config.camera.calibration = Some(folder.path().join("own.yaml"));
        let film = folder.path().join("film.y4m").display().to_string();
        let mut recording = Recording::open(&config, &film.parse().unwrap()).unwrap();
        assert!(matches!(recording.next_input(), Some(Input::Frame { .. })));
        let Some(Input::BrokenOff { reason }) = recording.next_input() else {
            panic!("nothing is said of the rest");
        };
        assert!(reason.contains("ends after 1 images"), "{reason}");
        assert!(recording.next_input().is_none());
    }
}

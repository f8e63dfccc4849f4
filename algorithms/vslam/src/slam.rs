//! The machine: frames in, poses and a map out.

mod backfill;
mod follow;
#[cfg(test)]
mod tests;

use backfill::Backfill;
use camera::{CameraModel, Image};
use features::{Extractor, ExtractorSettings, Features};
use geometry::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::bundle::Workspace;
use crate::frame::Frame;
use crate::mapping::{Insertion, Mapper, update_neighbours};
use crate::optics::{LEVEL_COUNT, LEVEL_FACTOR, Optics};
use crate::relocalise::Relocaliser;
use crate::start::Starter;
use crate::tracking::{KeyframeClock, Motion, Tracked, TrackedFrame, tracked_points};
use crate::trajectory::FrameRecord;
use crate::{
    FrameRefusal, FrameReport, KeyframeId, LostReason, MapId, PointId, StartReason, TrackingState,
    TrajectoryEntry, VslamMap, VslamSettings,
};

/// Monocular simultaneous localisation and mapping.
///
/// Deterministic: the same images give the same results, bit for bit.
#[derive(Debug)]
pub struct Vslam {
    optics: Optics,
    settings: VslamSettings,
    extractor: Extractor,
    features: Features,
    rng: ChaCha8Rng,
    workspace: Workspace,
    mode: Mode,
    mapper: Mapper,
    relocaliser: Relocaliser,
    map: VslamMap,
    /// The largest of the maps that were lost, small ones left out.
    earlier: Option<VslamMap>,
    /// Frames from before the map was born that are still to be found in it.
    backfill: Backfill,
    trajectory: Vec<FrameRecord>,
    newest_at: Option<Timestamp>,
    map_count: u32,
}

#[derive(Debug)]
enum Mode {
    Starting(Starter),
    Following {
        motion: Motion,
        clock: KeyframeClock,
    },
}

/// What a frame came to, before it is reported.
struct Outcome {
    state: TrackingState,
    tracked: Option<Tracked>,
    insertion: Option<Insertion>,
}

impl Outcome {
    fn without_pose(state: TrackingState) -> Self {
        Self {
            state,
            tracked: None,
            insertion: None,
        }
    }
}

impl Vslam {
    pub fn new(camera: CameraModel, settings: VslamSettings) -> Self {
        let extractor = Extractor::new(ExtractorSettings {
            feature_count: settings.feature_count_for(&camera),
            level_count: LEVEL_COUNT,
            scale_factor: LEVEL_FACTOR,
            ..ExtractorSettings::default()
        });
        Self {
            optics: Optics::new(camera, settings.keypoint_sigma_px),
            extractor,
            features: Features::default(),
            rng: ChaCha8Rng::seed_from_u64(settings.seed),
            workspace: Workspace::default(),
            mode: Mode::Starting(Starter::default()),
            mapper: Mapper::default(),
            relocaliser: Relocaliser::default(),
            map: VslamMap::new(MapId(0), KeyframeId(0), PointId(0)),
            earlier: None,
            backfill: Backfill::default(),
            trajectory: Vec::new(),
            newest_at: None,
            map_count: 1,
            settings,
        }
    }

    /// Takes the next frame.
    pub fn process(&mut self, image: &Image, captured_at: Timestamp) -> FrameReport {
        let frame_idx = self.trajectory.len() as u64;
        if let Some(refusal) = self.refusal(image, captured_at) {
            let outcome = Outcome::without_pose(self.refused(refusal));
            return self.report(captured_at, outcome, 0);
        }
        self.newest_at = Some(captured_at);
        self.extractor.extract(image, &mut self.features);
        let frame = Frame::new(&self.optics, &self.features, frame_idx, captured_at);
        let keypoint_count = frame.observations.len();
        let outcome = if matches!(self.mode, Mode::Starting(_)) {
            self.start(frame)
        } else {
            self.follow(frame)
        };
        self.report(captured_at, outcome, keypoint_count)
    }

    pub fn camera(&self) -> &CameraModel {
        &self.optics.camera
    }

    pub fn settings(&self) -> &VslamSettings {
        &self.settings
    }

    /// The map that frames are tracked in.
    pub fn map(&self) -> &VslamMap {
        &self.map
    }

    /// The map with the most keyframes so far, lost small ones left out: the one worth keeping at
    /// the end.
    pub fn largest_map(&self) -> &VslamMap {
        // Of equals the last one counts, which is the newest.
        let maps = self.earlier.iter().chain([&self.map]);
        maps.max_by_key(|map| map.keyframe_count())
            .unwrap_or(&self.map)
    }

    /// Every frame so far with its pose after all corrections.
    pub fn trajectory(&self) -> Vec<TrajectoryEntry> {
        (0..)
            .zip(&self.trajectory)
            .map(|(frame_idx, record)| {
                let maps = std::iter::once(&self.map).chain(&self.earlier);
                record.entry(frame_idx, maps)
            })
            .collect()
    }

    fn refusal(&self, image: &Image, captured_at: Timestamp) -> Option<FrameRefusal> {
        let got = (image.width(), image.height());
        let expected = (self.optics.camera.width(), self.optics.camera.height());
        if got != expected {
            return Some(FrameRefusal::ImageSize { got, expected });
        }
        (captured_at <= self.newest_at?).then_some(FrameRefusal::OutOfOrder)
    }

    fn refused(&self, refusal: FrameRefusal) -> TrackingState {
        match self.mode {
            Mode::Starting(_) => TrackingState::Starting {
                reason: StartReason::Refused(refusal),
            },
            Mode::Following { .. } => TrackingState::Lost {
                reason: LostReason::Refused(refusal),
            },
        }
    }

    fn start(&mut self, mut frame: Frame) -> Outcome {
        if let Some(tracked) = self.return_to_earlier(&mut frame) {
            return self.accept(frame, tracked);
        }
        let Mode::Starting(starter) = &mut self.mode else {
            unreachable!("called only while starting");
        };
        let captured_at = frame.captured_at;
        self.backfill.remember(&frame);
        let into = (&self.map, &mut self.workspace);
        match starter.advance(&self.optics, frame, into, &mut self.rng) {
            Err(reason) => Outcome::without_pose(TrackingState::Starting { reason }),
            Ok(map) => {
                self.map = map;
                self.begin(captured_at)
            }
        }
    }

    /// Follows the camera in a map that has just been made; the last keyframe is the frame.
    fn begin(&mut self, captured_at: Timestamp) -> Outcome {
        self.mapper.take_over(&self.map);
        let last = self
            .map
            .keyframes()
            .next_back()
            .expect("a new map has two keyframes");
        let (keyframe, camera_from_map) = (last.id(), *last.camera_from_map());
        let inlier_count = last.points().count();
        update_neighbours(&mut self.map, keyframe);
        let tracked = Tracked {
            camera_from_map,
            covariance: None,
            inlier_count,
            reference: keyframe,
        };
        let last = self
            .map
            .keyframe(keyframe)
            .expect("it was there a line ago");
        let start = TrackedFrame {
            captured_at,
            place: self
                .map
                .place(keyframe, &camera_from_map)
                .expect("the keyframe is in the map"),
            points: tracked_points(last.observations()),
        };
        self.backfill.begin(start.clone());
        let motion = Motion::starting_at(start);
        self.mode = Mode::Following {
            motion,
            clock: KeyframeClock {
                last_keyframe_at: captured_at,
            },
        };
        Outcome {
            state: TrackingState::Tracking,
            tracked: Some(tracked),
            insertion: Some(Insertion {
                keyframe,
                settled: Vec::new(),
            }),
        }
    }

    fn report(
        &mut self,
        captured_at: Timestamp,
        outcome: Outcome,
        keypoint_count: usize,
    ) -> FrameReport {
        let frame_idx = self.trajectory.len() as u64;
        let tracked = outcome.tracked;
        let place = tracked
            .as_ref()
            .and_then(|tracked| self.map.place(tracked.reference, &tracked.camera_from_map));
        self.trajectory.push(FrameRecord {
            captured_at,
            map_id: self.map.id(),
            place,
        });
        let pose = tracked
            .as_ref()
            .map(|tracked| tracked.camera_from_map.inverse());
        FrameReport {
            frame_idx,
            captured_at,
            map_id: self.map.id(),
            map_revision: self.map.revision(),
            state: outcome.state,
            map_from_camera: pose,
            pose_covariance: tracked.as_ref().and_then(|tracked| tracked.covariance),
            inlier_count: tracked.as_ref().map_or(0, |tracked| tracked.inlier_count),
            keypoint_count,
            new_keyframe: outcome
                .insertion
                .as_ref()
                .map(|insertion| insertion.keyframe),
            settled: outcome
                .insertion
                .map_or_else(Vec::new, |insertion| insertion.settled),
        }
    }
}

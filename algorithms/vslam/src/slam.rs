//! The machine: frames in, poses and a map out.

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
use crate::tracking::{
    KeyframeClock, Motion, Tracked, TrackedFrame, track, tracked_points, wants_keyframe,
};
use crate::trajectory::FrameRecord;
use crate::{
    FrameRefusal, FrameReport, KeyframeId, LostReason, MapId, PointId, StartReason, TrackingState,
    TrajectoryEntry, VslamMap, VslamSettings,
};

/// After so many frames without a pose the last motion says nothing any more.
const COASTED_MAX: u32 = 3;
/// A map with fewer keyframes is given up when it is lost.
const SMALL_MAP_KEYFRAMES: usize = 6;
/// How long a small map is looked for, frames.
const SMALL_MAP_PATIENCE: u32 = 10;
/// How long a map is looked for before a new one is begun beside it, seconds.
const PATIENCE_S: f64 = 5.0;

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
    /// The largest of the maps that were lost.
    earlier: Option<VslamMap>,
    trajectory: Vec<FrameRecord>,
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
            trajectory: Vec::new(),
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

    /// The map with the most keyframes so far: the one worth keeping at the end.
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
        let last = self.trajectory.last()?;
        (captured_at <= last.captured_at).then_some(FrameRefusal::OutOfOrder)
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

    fn start(&mut self, frame: Frame) -> Outcome {
        let Mode::Starting(starter) = &mut self.mode else {
            unreachable!("called only while starting");
        };
        let captured_at = frame.captured_at;
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
            covariance: nalgebra::Matrix6::zeros(),
            inlier_count,
            reference: keyframe,
        };
        let last = self
            .map
            .keyframe(keyframe)
            .expect("it was there a line ago");
        let motion = Motion::starting_at(TrackedFrame {
            captured_at,
            place: self
                .map
                .place(keyframe, &camera_from_map)
                .expect("the keyframe is in the map"),
            points: tracked_points(last.observations()),
        });
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

    fn follow(&mut self, mut frame: Frame) -> Outcome {
        let Mode::Following { motion, .. } = &mut self.mode else {
            unreachable!("called only while following");
        };
        let mut result = Err(LostReason::UnknownPlace);
        if motion.missed_count <= COASTED_MAX {
            result = track(
                &self.optics,
                &mut self.map,
                motion,
                &mut frame,
                &mut self.rng,
            );
        }
        let result = result.or_else(|reason| {
            frame.forget_points();
            self.relocaliser
                .locate(&self.optics, &mut self.map, &mut frame, &mut self.rng)
                .ok_or(reason)
        });
        match result {
            Ok(tracked) => self.accept(frame, tracked),
            Err(reason) => self.miss(&frame, reason),
        }
    }

    fn accept(&mut self, frame: Frame, mut tracked: Tracked) -> Outcome {
        let Mode::Following { motion, clock } = &mut self.mode else {
            unreachable!("called only while following");
        };
        let captured_at = frame.captured_at;
        let mut points = tracked_points(&frame.observations);
        let mut insertion = None;
        if wants_keyframe(&self.map, clock, &frame, &tracked) {
            let pose = (tracked.camera_from_map, tracked.reference);
            let inserted = self.mapper.insert(&self.optics, &mut self.map, frame, pose);
            let keyframe = self
                .map
                .keyframe(inserted.keyframe)
                .expect("the newest keyframe is never culled");
            points = tracked_points(keyframe.observations());
            tracked.camera_from_map = *keyframe.camera_from_map();
            tracked.reference = inserted.keyframe;
            clock.last_keyframe_at = captured_at;
            insertion = Some(inserted);
        }
        let place = self
            .map
            .place(tracked.reference, &tracked.camera_from_map)
            .expect("the reference is in the map");
        motion.advance(
            &self.map,
            TrackedFrame {
                captured_at,
                place,
                points,
            },
        );
        Outcome {
            state: TrackingState::Tracking,
            tracked: Some(tracked),
            insertion,
        }
    }

    fn miss(&mut self, frame: &Frame, reason: LostReason) -> Outcome {
        let Mode::Following { motion, .. } = &mut self.mode else {
            unreachable!("called only while following");
        };
        motion.missed_count += 1;
        let lost_s = frame.captured_at - motion.last.captured_at;
        let small = self.map.keyframe_count() < SMALL_MAP_KEYFRAMES;
        let give_up = (small && motion.missed_count >= SMALL_MAP_PATIENCE) || lost_s > PATIENCE_S;
        if give_up {
            self.restart();
        }
        Outcome::without_pose(TrackingState::Lost { reason })
    }

    /// Begins a new map; the largest of the old ones is kept.
    fn restart(&mut self) {
        let successor = self.map.successor();
        let old = std::mem::replace(&mut self.map, successor);
        let earlier_count = self.earlier.as_ref().map_or(0, VslamMap::keyframe_count);
        if old.keyframe_count() > earlier_count {
            self.earlier = Some(old);
        }
        self.mode = Mode::Starting(Starter::default());
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
            pose_covariance: tracked.as_ref().map(|tracked| tracked.covariance),
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

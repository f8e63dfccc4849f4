//! The machine: frames in, poses and a map out.

mod backfill;
mod finish;
mod follow;
mod front_end;
mod grow_map;
mod prior;
mod recall;
mod revisit;
mod state;
mod strays;
mod sureness;
#[cfg(test)]
mod tests;
mod waiting;

pub use front_end::{ExtractedFrame, FrontEnd};

use backfill::Backfill;
use camera::{CameraModel, Image};
use geometry::Timestamp;
use grow_map::Unmapped;
use prior::Ups;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use waiting::Waiting;

use crate::bundle::Workspace;
use crate::frame::Frame;
use crate::inertia::Inertia;
use crate::look::{Look, UsualLook};
use crate::loops::Loops;
use crate::mapping::{Mapper, update_neighbours};
use crate::optics::Optics;
use crate::places::Places;
use crate::relocalise::Relocaliser;
use crate::start::Starter;
use crate::tracking::{KeyframeClock, Motion, Tracked, TrackedFrame};
use crate::trajectory::FrameRecord;
use crate::{
    FrameReport, KeyframeId, MapId, MappingReport, PointId, TrackingState, TrajectoryEntry,
    VslamMap, VslamSettings,
};

/// Monocular simultaneous localisation and mapping.
///
/// A frame takes three steps: [`FrontEnd::extract`] needs no map and may run on another thread,
/// [`Vslam::track`] gives the pose, and [`Vslam::map_frame`] then does what the frame leaves to do
/// for the map. A frame is tracked when the one before it is mapped.
///
/// Deterministic: the same images give the same results, bit for bit, wherever they are extracted
/// and wherever [`VslamSettings::background`] runs.
#[derive(Debug)]
pub struct Vslam {
    optics: Optics,
    settings: VslamSettings,
    inertia: Inertia,
    ups: Ups,
    /// Of the newest frame, and of those in which the camera was found.
    look: Look,
    usual_look: UsualLook,
    front_end: FrontEnd,
    rng: ChaCha8Rng,
    workspace: Workspace,
    mode: Mode,
    mapper: Mapper,
    relocaliser: Relocaliser,
    /// Finds keyframes of all maps by their looks.
    places: Places,
    loops: Loops,
    map: VslamMap,
    /// The maps that were lost, small ones left out.
    earlier: Vec<VslamMap>,
    /// How often the camera was seen in one of them since the map began.
    seen_earlier_count: u32,
    /// What the newest frame leaves to do for the map.
    unmapped: Option<Unmapped>,
    /// Frames from before the map was born that are still to be found in it.
    backfill: Backfill,
    /// Frames that were lost, or are in a smaller map.
    waiting: Waiting,
    trajectory: Vec<FrameRecord>,
    newest_at: Option<Timestamp>,
    map_count: u32,
}

#[derive(Debug)]
enum Mode {
    Starting(Starter),
    /// There is a map of an earlier session, in which the camera was not found yet.
    Recalling {
        since: Option<Timestamp>,
    },
    Following {
        motion: Motion,
        clock: KeyframeClock,
    },
}

/// What a frame came to, before it is reported.
struct Outcome {
    state: TrackingState,
    tracked: Option<Tracked>,
}

impl Outcome {
    fn without_pose(state: TrackingState) -> Self {
        Self {
            state,
            tracked: None,
        }
    }
}

impl Vslam {
    pub fn new(camera: CameraModel, settings: VslamSettings) -> Self {
        Self {
            optics: Optics::new(camera.clone(), settings.keypoint_sigma_px),
            inertia: Inertia::default(),
            ups: Ups::default(),
            look: Look::default(),
            usual_look: UsualLook::default(),
            front_end: FrontEnd::new(camera, &settings),
            rng: ChaCha8Rng::seed_from_u64(settings.seed),
            workspace: Workspace::default(),
            mode: Mode::Starting(Starter::default()),
            mapper: Mapper::default(),
            relocaliser: Relocaliser::default(),
            places: Places::default(),
            loops: Loops::new(&settings),
            map: VslamMap::new(MapId(0), KeyframeId(0), PointId(0)),
            earlier: Vec::new(),
            seen_earlier_count: 0,
            unmapped: None,
            backfill: Backfill::default(),
            waiting: Waiting::default(),
            trajectory: Vec::new(),
            newest_at: None,
            map_count: 1,
            settings,
        }
    }

    /// Takes the next frame through all steps at once.
    pub fn process(
        &mut self,
        image: &Image,
        captured_at: Timestamp,
    ) -> (FrameReport, MappingReport) {
        let extracted = self.front_end.extract(image, captured_at);
        let report = self.track(extracted);
        (report, self.map_frame())
    }

    /// Finds the pose of the next frame.
    pub fn track(&mut self, extracted: ExtractedFrame) -> FrameReport {
        if self.unmapped.is_some() {
            self.map_frame();
        }
        let captured_at = extracted.captured_at;
        let look = extracted.look;
        let mut frame = match self.admit(extracted) {
            Ok(frame) => frame,
            Err(refusal) => {
                let outcome = Outcome::without_pose(self.refused(refusal));
                return self.report(captured_at, outcome, 0);
            }
        };
        self.look = look;
        let last_at = self.newest_at.replace(captured_at);
        self.ups.begin_frame(self.inertia.up_in_camera());
        frame.frame_idx = self.trajectory.len() as u64;
        let keypoint_count = frame.observations.len();
        self.give_up_hopeless();
        let mut outcome = match self.mode {
            Mode::Starting(_) => self.start(frame, last_at),
            Mode::Recalling { since } => self.recall(frame, since),
            Mode::Following { .. } => self.follow(frame),
        };
        outcome.state = self.explain(outcome.state);
        self.report(captured_at, outcome, keypoint_count)
    }

    /// Another front end for the same camera, for a thread of its own.
    pub fn front_end(&self) -> FrontEnd {
        FrontEnd::new(self.optics.camera.clone(), &self.settings)
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

    /// The map worth keeping at the end: the one that was continued, else the one with the most
    /// keyframes, lost small ones left out.
    pub fn largest_map(&self) -> &VslamMap {
        // Of equals the last one counts, which is the newest.
        let maps = self.earlier.iter().chain([&self.map]);
        maps.max_by_key(|map| map.rank()).unwrap_or(&self.map)
    }

    /// Every frame so far with its pose after all corrections; without one where it was found
    /// afterwards at a place from which the frames around it are not to be reached.
    pub fn trajectory(&self) -> Vec<TrajectoryEntry> {
        let mut entries: Vec<TrajectoryEntry> = (0..)
            .zip(&self.trajectory)
            .map(|(frame_idx, record)| record.entry(frame_idx, self.maps()))
            .collect();
        for map in self.maps() {
            strays::clear(map, &self.trajectory, &mut entries);
        }
        entries
    }

    fn start(&mut self, mut frame: Frame, last_at: Option<Timestamp>) -> Outcome {
        if let Some(tracked) = self.return_to_earlier(&mut frame) {
            return self.accept(frame, tracked);
        }
        let Mode::Starting(starter) = &mut self.mode else {
            unreachable!("called only while starting");
        };
        let captured_at = frame.captured_at;
        starter.turn = last_at.and_then(|last_at| self.inertia.turn(last_at, captured_at));
        let forgotten = self.backfill.remember(&frame);
        if let Some(forgotten) = forgotten {
            self.waiting.remember(&forgotten);
        }
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
        self.places.insert_all(&self.map);
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
            ranged_count: inlier_count,
            expected_count: inlier_count,
            is_placed: true,
            doubtful_misfit: None,
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
            observations: last.observations.clone(),
        };
        self.backfill.begin(start.clone());
        self.follow_from(start);
        self.unmapped = Some(Unmapped::Started(keyframe));
        Outcome {
            state: TrackingState::Tracking,
            tracked: Some(tracked),
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
            was_tracked: place.is_some(),
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
        }
    }
}

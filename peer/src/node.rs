//! One vehicle's mind: a state machine that opens nothing.
//!
//! `handle(event, now)` takes what a driver or the link brought and returns what is to be done.
//! The same code flies, replays a recording, and runs in simulated time.

mod anchor_role;
mod exchange;
mod frame;
mod handover;
mod outlet;
mod peer_role;
mod peer_tie;
mod places;
mod receive;
mod sharing;
mod shelf;
mod status;
mod surroundings;
mod tied_pose;

use std::collections::BTreeMap;
use std::sync::Arc;

use anchor::{AnchorSettings, PositionFix};
use camera::{Calibration, Image};
use geodesy::Datum;
use geometry::{Body, Camera, Enu, Map, Similarity, Timestamp, Transform};
use nalgebra::{Matrix3, Matrix6, Vector3};
use protocol::keys::Key;
use protocol::sync::SyncEvent;
use protocol::{ChunkCamera, VehicleId, VehicleState};
use vslam::{FrameReport, FrontEnd, Vslam, VslamSettings};

use crate::files::StampedPose;
use crate::link::{Class, RequestId};
use crate::store::{Kept, Reloaded};
use anchor_role::AnchorRole;
use exchange::Exchange;
use outlet::Outlet;
use peer_role::PeerRole;
use places::Places;
use shelf::Shelf;

pub use peer_role::observe;
pub use status::Status;

/// What the node may be told.
#[derive(Debug)]
pub enum Event {
    Frame {
        captured_at: Timestamp,
        image: Image,
    },
    /// The pose of the newest frame is out: what else it means is done now, for the own map and
    /// for all that follows it. The next frame makes up for it if it was left out.
    PoseOut,
    /// A position; comes before the frames that are newer than it.
    Fix(PositionFix),
    /// Somebody published this.
    Message {
        key: String,
        payload: Arc<[u8]>,
    },
    /// Somebody answered a request with this.
    Reply {
        request: RequestId,
        key: String,
        payload: Arc<[u8]>,
    },
    RequestEnded {
        request: RequestId,
    },
    NeighbourCame,
    NeighbourLeft,
    /// Time has passed.
    Tick,
}

/// What is to be done, in this order.
#[derive(Debug)]
pub enum Effect {
    /// Store it; what comes after may say that it is held.
    Keep(Kept),
    Publish {
        class: Class,
        key: Key,
        payload: Arc<[u8]>,
    },
    Request {
        request: RequestId,
        selector: String,
    },
    /// The frame has a pose or a reason, and that has been published.
    Posed(Box<FramePose>),
}

/// A frame's pose as it was published at that moment.
#[derive(Clone, Debug)]
pub struct FramePose {
    pub captured_at: Timestamp,
    pub state: VehicleState,
    /// Only while `Global`.
    pub global: Option<GlobalFramePose>,
    /// In the vehicle's own map, while tracking.
    pub map_from_camera: Option<Transform<Map, Camera>>,
    /// Of which map.
    pub map_id: vslam::MapId,
}

#[derive(Clone, Debug)]
pub struct GlobalFramePose {
    pub enu_from_camera: Transform<Enu, Camera>,
    /// Of the camera's position, in ENU (m²).
    pub position_covariance: Matrix3<f64>,
    pub enu_from_body: Transform<Enu, Body>,
    /// Of `enu_from_body`, `[ω; ν]`, right perturbation.
    pub body_covariance: Matrix6<f64>,
}

/// What may differ between vehicles.
#[derive(Clone, Debug)]
pub struct NodeSettings {
    pub id: VehicleId,
    pub stale_after_s: f64,
    pub global_sigma_m: Option<f64>,
    pub seed: u64,
    /// How the epochs of the own map are named.
    pub epoch_start: EpochStart,
    /// Where the map is adjusted as a whole; see [`VslamSettings::background`].
    pub background: Option<vslam::Background>,
}

/// Where an anchor's fixes come from.
#[derive(Clone, Debug)]
pub struct PositionSource {
    /// What the fixes are relative to; `None` for geodetic ones.
    pub datum: Option<Datum>,
    /// The lever arm: where the antenna is (m).
    pub antenna_in_body: Vector3<f64>,
}

/// The first epoch of a vehicle's map.
#[derive(Clone, Copy, Debug)]
pub struct EpochStart {
    /// One above the highest that is known.
    pub counter: u32,
    /// Makes the random part of epochs.
    pub seed: u64,
}

/// What went wrong or was odd, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct NodeCounters {
    pub chunks_received: u64,
    pub chunks_published: u64,
    /// Messages that are none, whatever their key.
    pub malformed: u64,
    /// Chunks that came again.
    pub duplicates: u64,
    /// Different bodies under one key; the first was kept.
    pub equivocations: u64,
    /// Messages in this vehicle's name, or about its map, that it never said.
    pub impersonations: u64,
    /// The global pose moved by more than its uncertainty explained.
    pub jumps: u64,
    /// Alignments that were wrong, and that keyframes which agree with each other have replaced.
    #[serde(default)]
    pub overruled: u64,
    /// Chunks that had to be asked for.
    pub chunks_pulled: u64,
    /// Chunks and placements that rest on this vehicle's own map, and are no evidence for it.
    #[serde(default)]
    pub circular: u64,
}

/// The vehicle's state machine.
pub struct Node {
    settings: NodeSettings,
    calibration: Calibration,
    front_end: FrontEnd,
    slam: Vslam,
    /// The newest frame, until it is mapped.
    unmapped: Option<FrameReport>,
    role: Role,
    shelf: Shelf,
    exchange: Exchange,
    counters: NodeCounters,
    status: Status,
    was_global: bool,
    pose_published_at: Option<Timestamp>,
}

/// What ties the own map to the Earth.
enum Role {
    Anchor(Box<AnchorRole>),
    Peer(Box<PeerRole>),
}

impl Node {
    /// A vehicle without a position source.
    pub fn peer(settings: NodeSettings, calibration: Calibration) -> Self {
        let anchor_settings = anchor_settings(&settings, &calibration);
        let shared = AnchorRole::registered(anchor_settings, settings.epoch_start);
        let role = PeerRole::new(settings.id.clone(), settings.seed, shared);
        Self::new(settings, calibration, Role::Peer(Box::new(role)))
    }

    /// A vehicle with a position source.
    pub fn anchor(
        settings: NodeSettings,
        calibration: Calibration,
        source: &PositionSource,
    ) -> Self {
        let mut anchor_settings = anchor_settings(&settings, &calibration);
        anchor_settings.datum = source.datum.clone();
        anchor_settings.georeference.antenna_in_body = source.antenna_in_body;
        let role = AnchorRole::new(anchor_settings, settings.epoch_start);
        Self::new(settings, calibration, Role::Anchor(Box::new(role)))
    }

    fn new(settings: NodeSettings, calibration: Calibration, role: Role) -> Self {
        let slam_settings = VslamSettings {
            seed: settings.seed,
            background: settings.background,
            ..VslamSettings::default()
        };
        Self {
            front_end: FrontEnd::new(calibration.camera.clone(), &slam_settings),
            slam: Vslam::new(calibration.camera.clone(), slam_settings),
            unmapped: None,
            exchange: Exchange::new(settings.id.clone()),
            settings,
            calibration,
            role,
            shelf: Shelf::default(),
            counters: NodeCounters::default(),
            status: Status::start(),
            was_global: false,
            pose_published_at: None,
        }
    }

    /// Takes what was held before a restart; nothing is counted or said to anybody.
    pub fn recall(&mut self, reloaded: Vec<Reloaded>) -> Vec<Kept> {
        let mut effects = Vec::new();
        for Reloaded { key, payload } in reloaded {
            let (key, payload) = (key.to_string(), Arc::from(payload));
            self.take_message(&key, &payload, Timestamp::default(), &mut effects);
        }
        self.counters = NodeCounters::default();
        let kept = effects.into_iter().filter_map(|effect| match effect {
            Effect::Keep(kept) => Some(kept),
            _ => None,
        });
        kept.collect()
    }

    /// Takes one event and says what is to be done about it.
    pub fn handle(&mut self, event: Event, now: Timestamp) -> Vec<Effect> {
        let mut effects = Vec::new();
        match event {
            Event::Frame { captured_at, image } => {
                self.take_frame(&image, captured_at, now, &mut effects);
            }
            Event::PoseOut => self.map_frame(now, &mut effects),
            Event::Message { key, payload } => {
                self.take_message(&key, &payload, now, &mut effects);
            }
            Event::Reply {
                request,
                key,
                payload,
            } => self.take_reply(request, &key, &payload, now, &mut effects),
            Event::RequestEnded { request } => {
                self.exchange.end_request(request, now, &mut effects);
            }
            Event::Fix(fix) => {
                if let Role::Anchor(role) = &mut self.role {
                    let mut outlet = Outlet {
                        shelf: &mut self.shelf,
                        exchange: &mut self.exchange,
                        counters: &mut self.counters,
                        effects: &mut effects,
                        now,
                    };
                    role.take_fix(fix, self.slam.map(), &mut outlet);
                }
            }
            Event::NeighbourCame => self.exchange.tell(SyncEvent::LinkUp, now, &mut effects),
            Event::NeighbourLeft => {}
            Event::Tick => self.exchange.tell(SyncEvent::Tick, now, &mut effects),
        }
        effects
    }

    /// A beacon at once, so that somebody new hears what is held here.
    pub fn greet(&mut self, now: Timestamp) -> Vec<Effect> {
        let mut effects = Vec::new();
        self.exchange.tell(SyncEvent::Tick, now, &mut effects);
        let spoken = |effect: &Effect| matches!(effect, Effect::Publish { .. });
        if !effects.iter().any(spoken) {
            self.exchange.repeat_beacon(&mut effects);
        }
        effects
    }

    pub fn status(&self) -> &Status {
        &self.status
    }

    pub fn counters(&self) -> NodeCounters {
        self.counters
    }

    pub fn role_name(&self) -> &'static str {
        match self.role {
            Role::Anchor(_) => "anchor",
            Role::Peer(_) => "peer",
        }
    }

    pub fn slam(&self) -> &Vslam {
        &self.slam
    }

    /// Requests that were sent and have not ended.
    pub fn open_request_count(&self) -> usize {
        self.exchange.open_request_count()
    }

    /// Where the own map stands, as known now.
    pub fn enu_from_map(&self, now: Timestamp) -> Option<Similarity<Enu, Map>> {
        match &self.role {
            Role::Anchor(role) => role.enu_from_map(),
            Role::Peer(role) => role.enu_from_map(now),
        }
    }

    /// Every frame of the own map that can be placed as well as `Global` asks for, after all
    /// corrections; where there is none, the single frames that were located.
    pub fn corrected_trajectory(&self) -> Vec<StampedPose<Enu>> {
        let places = self.places();
        let sigma_max_m = self.global_sigma_m();
        let map_id = self.slam.map().id();
        let entries = self.slam.trajectory().into_iter();
        let placed = entries.filter_map(|entry| {
            let map_from_camera = entry.map_from_camera.filter(|_| entry.map_id == map_id)?;
            Some(StampedPose {
                captured_at: entry.captured_at,
                target_from_camera: places.pose(
                    entry.captured_at,
                    &map_from_camera,
                    sigma_max_m,
                )?,
            })
        });
        let single = match &self.role {
            Role::Anchor(_) => None,
            Role::Peer(role) => Some(role.located_frames()),
        };
        // Of two poses of a frame the later one stays.
        let all = single.into_iter().flatten().chain(placed);
        let all: BTreeMap<_, _> = all.map(|pose| (pose.captured_at, pose)).collect();
        all.into_values().collect()
    }

    /// The points of the own map in the global frame, after all corrections.
    pub fn points_in_enu(&self) -> Vec<Vector3<f64>> {
        let places = self.places();
        let map = self.slam.map();
        let ranged = map.points().filter(|point| point.has_range());
        let placed = ranged.filter_map(|point| {
            let keyframe = map.keyframe(point.views().first()?.keyframe)?;
            places.point(keyframe.captured_at(), point.position_in_map())
        });
        placed.collect()
    }

    /// The position's sigma up to which a pose is `Global`.
    fn global_sigma_m(&self) -> f64 {
        let fix_sigma_m = match &self.role {
            Role::Anchor(role) => role.fix_sigma_m(),
            Role::Peer(role) => role.fix_sigma_m(),
        };
        let default_sigma_m = (2.0 * fix_sigma_m.unwrap_or(0.0)).max(0.5);
        self.settings.global_sigma_m.unwrap_or(default_sigma_m)
    }

    fn places(&self) -> Places {
        let map = self.slam.map();
        match &self.role {
            Role::Anchor(role) => role.places(map),
            Role::Peer(role) => role.places(map),
        }
    }

    /// The points of every anchor's map in the global frame.
    pub fn landmarks_in_enu(&self) -> Vec<Vector3<f64>> {
        match &self.role {
            Role::Anchor(_) => Vec::new(),
            Role::Peer(role) => role.landmarks_in_enu(),
        }
    }
}

fn anchor_settings(settings: &NodeSettings, calibration: &Calibration) -> AnchorSettings {
    let camera = &calibration.camera;
    let chunk_camera = ChunkCamera {
        focal_length_px: camera.focal_length_px() as f32,
        width_px: u16::try_from(camera.width()).unwrap_or(u16::MAX),
        height_px: u16::try_from(camera.height()).unwrap_or(u16::MAX),
    };
    let mut anchor_settings = AnchorSettings::new(settings.id.clone(), chunk_camera);
    anchor_settings.stale_after_s = settings.stale_after_s;
    anchor_settings.georeference.body_from_camera = calibration.body_from_camera;
    anchor_settings
}

//! The own map is shared with the team: tied to the Earth by a position source, or by what the
//! vehicle found itself in.

use std::collections::VecDeque;

use anchor::{
    Anchor, AnchorSettings, Effect as AnchorEffect, Event as AnchorEvent, FrameInput,
    KeyframeInput, KeyframePose, PositionFix, Registration, keyframe_poses,
};
use geometry::{Enu, Map, Matrix7, Similarity, Timestamp};
use protocol::{Epoch, MapId, VehicleState};
use vslam::{FrameReport, KeyframeId, MappingReport, VslamMap};

use super::EpochStart;
use super::outlet::Outlet;
use super::places::{Place, Places};
use super::status::{KnownTie, Tie};
use super::tied_pose::{TiedPose, pose_covariance, position_block, worst_sigma};

/// The anchor's state machine, fed from the own map.
pub struct AnchorRole {
    anchor: Anchor,
    /// Whether fixes tie the map; then every adjustment of a keyframe counts at once.
    has_fixes: bool,
    own_map: Option<vslam::MapId>,
    map_revision: u64,
    epoch_seed: u64,
    epoch_count: u64,
}

impl AnchorRole {
    pub fn new(settings: AnchorSettings, start: EpochStart) -> Self {
        Self::with(Anchor::new(settings, first_epoch(start)), true, start)
    }

    /// For a vehicle without a position source.
    pub fn registered(settings: AnchorSettings, start: EpochStart) -> Self {
        Self::with(
            Anchor::registered(settings, first_epoch(start)),
            false,
            start,
        )
    }

    fn with(anchor: Anchor, has_fixes: bool, start: EpochStart) -> Self {
        Self {
            anchor,
            has_fixes,
            own_map: None,
            map_revision: 0,
            epoch_seed: start.seed,
            epoch_count: 1,
        }
    }

    /// The map that is being published.
    pub fn map(&self) -> &MapId {
        self.anchor.map()
    }

    pub fn take_fix(&mut self, fix: PositionFix, map: &VslamMap, outlet: &mut Outlet<'_>) {
        self.drive(VecDeque::from([AnchorEvent::Fix(fix)]), map, outlet);
    }

    /// Where the map stands by registration, or that nobody can say.
    pub fn take_registration(
        &mut self,
        registration: Option<Registration>,
        map: &VslamMap,
        outlet: &mut Outlet<'_>,
    ) {
        let registered = AnchorEvent::Registered(registration.map(Box::new));
        self.drive(VecDeque::from([registered]), map, outlet);
    }

    /// Follows a correction of the map, which may stretch it: ahead of what is said of its place.
    pub fn correct_map(&mut self, map_revision: u64, map: &VslamMap, outlet: &mut Outlet<'_>) {
        self.map_revision = map_revision;
        let moved = AnchorEvent::KeyframesMoved(keyframe_poses(map));
        self.drive(VecDeque::from([moved]), map, outlet);
    }

    /// Poses are in this map from now on; another one than before begins an epoch.
    pub fn enter_map(&mut self, map_id: vslam::MapId, map: &VslamMap, outlet: &mut Outlet<'_>) {
        if self.own_map.is_some_and(|known| known != map_id) {
            let epoch_random = epoch_random(self.epoch_seed, self.epoch_count);
            self.epoch_count += 1;
            let restarted = AnchorEvent::MapRestarted { epoch_random };
            self.drive(VecDeque::from([restarted]), map, outlet);
        }
        self.own_map = Some(map_id);
    }

    /// Tells the anchor what a frame did to the own map, and carries out what it wants.
    pub fn follow_map(
        &mut self,
        (report, mapped): (&FrameReport, &MappingReport),
        map: &VslamMap,
        outlet: &mut Outlet<'_>,
    ) {
        let mut events = VecDeque::new();
        let new_keyframe = mapped.new_keyframe.and_then(|id| map.keyframe(id));
        if let Some(keyframe) = new_keyframe {
            let pose = KeyframePose::from(keyframe);
            events.push_back(AnchorEvent::KeyframeInserted(pose));
        }
        // By registration keyframes are placed one by one; only loops change more than that.
        let adjusted = self.has_fixes && new_keyframe.is_some();
        if adjusted || self.map_revision != mapped.map_revision {
            self.map_revision = mapped.map_revision;
            events.push_back(AnchorEvent::KeyframesMoved(keyframe_poses(map)));
        }
        // A keyframe without a pose of its frame was followed by directions: its place is not
        // measured.
        if let Some(tracked) = report.map_from_camera {
            let map_from_camera = mapped.map_from_keyframe.unwrap_or(tracked);
            events.push_back(AnchorEvent::Frame(FrameInput {
                captured_at: report.captured_at,
                map_from_camera,
                up_in_camera: None,
            }));
        }
        events.extend(mapped.settled.iter().filter_map(|id| settled(map, *id)));
        events.push_back(AnchorEvent::Tick);
        self.drive(events, map, outlet);
    }

    /// What the own pose is and rests on.
    pub fn tie(&self, report: &FrameReport, now: Timestamp) -> TiedPose {
        let datum = self.anchor.datum().cloned();
        let (state, reason) = self.anchor.state();
        let (Some(known), Some((enu_from_map, covariance))) =
            (self.anchor.georeference(), self.anchor.enu_from_map())
        else {
            return TiedPose {
                tie: Tie::None {
                    reason: reason.to_owned(),
                },
                pose: None,
                datum,
                jump_count: 0,
                overruled_count: 0,
            };
        };
        let pose = report.map_from_camera.as_ref().map(|map_from_camera| {
            let own = report.pose_covariance.as_ref();
            let covariance = pose_covariance(&enu_from_map, &covariance, map_from_camera, own);
            (enu_from_map.transform_pose(map_from_camera), covariance)
        });
        let tie = Tie::Known(KnownTie {
            age_s: now - known.newest_fix_at,
            position_sigma_m: pose
                .as_ref()
                .map(|(_, covariance)| worst_sigma(&position_block(covariance))),
            objection: (state != VehicleState::Global).then(|| reason.to_owned()),
            basis: reason.to_owned(),
        });
        TiedPose {
            tie,
            pose,
            datum,
            jump_count: 0,
            overruled_count: 0,
        }
    }

    /// The typical standard deviation of a fix (m).
    pub fn fix_sigma_m(&self) -> Option<f64> {
        Some(self.anchor.georeference()?.fix_sigma_m)
    }

    /// The one similarity that fits the whole map best.
    pub fn enu_from_map(&self) -> Option<Similarity<Enu, Map>> {
        Some(self.anchor.georeference()?.enu_from_map)
    }

    /// Where the map stood at each keyframe.
    pub(super) fn places(&self, map: &VslamMap) -> Places {
        let georeference = self.anchor.georeference();
        let placed = georeference.into_iter().flat_map(|georeference| {
            map.keyframes().filter_map(|keyframe| {
                let pose = keyframe.map_from_camera();
                let placed = georeference.keyframes.get(&keyframe.id())?;
                Some(Place {
                    captured_at: keyframe.captured_at(),
                    map_from_camera: pose,
                    enu_from_map: placed.enu_from_camera * pose.inverse(),
                    covariance: placed.covariance,
                    // Every keyframe since the first fix is placed.
                    drift_per_way: Matrix7::zeros(),
                })
            })
        });
        Places::new(placed)
    }

    fn drive(
        &mut self,
        mut events: VecDeque<AnchorEvent>,
        map: &VslamMap,
        outlet: &mut Outlet<'_>,
    ) {
        while let Some(event) = events.pop_front() {
            for effect in self.anchor.handle(event, outlet.now) {
                match effect {
                    AnchorEffect::RequestKeyframe(id) => events.extend(settled(map, id)),
                    other => outlet.publish(other),
                }
            }
        }
    }
}

fn settled(map: &VslamMap, id: KeyframeId) -> Option<AnchorEvent> {
    KeyframeInput::from_map(map, id).map(AnchorEvent::KeyframeSettled)
}

fn first_epoch(start: EpochStart) -> Epoch {
    Epoch {
        counter: start.counter,
        random: epoch_random(start.seed, 0),
    }
}

/// The random part of an epoch: SplitMix64 of seed and count.
fn epoch_random(seed: u64, count: u64) -> u32 {
    let mut mixed = seed.wrapping_add((count + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (mixed >> 32) as u32
}

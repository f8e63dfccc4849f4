//! The anchor's state machine: events in, effects out.

mod cutting;
mod placing;
mod registered;

use std::time::Duration;

use geodesy::Datum;
use geometry::{Enu, Map, Matrix7, Similarity, Timestamp};
use protocol::{Chunk, Epoch, Manifest, MapId, Placement, PlacementPage, Reference, VehicleState};
use vslam::KeyframeId;

use crate::georeference::LocalFix;
use crate::{
    AnchorSettings, FixCounts, FixPosition, FrameInput, Georeference, Georeferencer, KeyframeInput,
    KeyframePose, NotObservable, PositionFix,
};
use cutting::Cutter;
use placing::Placer;

pub use registered::Registration;

/// What happens to an anchor.
#[derive(Clone, Debug)]
pub enum Event {
    /// A frame was tracked. Frames come in the order of time.
    Frame(FrameInput),
    /// A frame became a keyframe; comes before its [`Event::Frame`].
    KeyframeInserted(KeyframePose),
    /// A keyframe left the window of local bundle adjustment, or was asked for by
    /// [`Effect::RequestKeyframe`]. For a keyframe that is a chunk already, as after a loop
    /// closure, the chunk is replaced if its points moved.
    KeyframeSettled(KeyframeInput),
    /// Keyframes stand elsewhere, by local adjustment or by a loop closure. All that still exist
    /// are named; the others move with them.
    KeyframesMoved(Vec<KeyframePose>),
    Fix(PositionFix),
    /// Where a map stands that has no fixes of its own, or `None` while nobody can say; only for
    /// [`Anchor::registered`].
    Registered(Option<Box<Registration>>),
    /// Time passed; a few times a second.
    Tick,
    /// Another map took the place of this one, be it new or an earlier one that was found again:
    /// a new epoch, with this random part.
    MapRestarted {
        epoch_random: u32,
    },
}

/// What the anchor wants done.
#[expect(
    clippy::large_enum_variant,
    reason = "there are a few effects a second"
)]
#[derive(Clone, Debug)]
pub enum Effect {
    /// Answer with [`Event::KeyframeSettled`], or not at all if the keyframe was culled.
    RequestKeyframe(KeyframeId),
    /// Store and put these bytes; they never change.
    PublishChunk {
        chunk: Chunk,
        bytes: Vec<u8>,
    },
    PublishPlacement(Placement),
    PublishPage(PlacementPage),
    /// `holder` and `held` are the anchor itself and all of its chunks.
    PublishManifest(Manifest),
    StateChanged {
        state: VehicleState,
        reason: String,
    },
}

/// What was left out, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub fixes: FixCounts,
    /// Points that are not finite, or that the layout of chunks cannot hold.
    pub points_dropped: u64,
    pub chunks_cut: u64,
    pub chunks_replaced: u64,
}

/// A vehicle whose map others use: one with a position source, or one that is registered to the
/// maps of others and says so.
#[derive(Debug)]
pub struct Anchor {
    settings: AnchorSettings,
    /// How the map comes to its place.
    reference: Reference,
    map: MapId,
    datum: Option<Datum>,
    georeferencer: Georeferencer,
    georeference: Option<Georeference>,
    /// All chunks stand where the georeference says, as far as it speaks of them.
    chunks_were_told: bool,
    cutter: Cutter,
    placer: Placer,
    state: VehicleState,
    reason: String,
    last_fix_at: Option<Timestamp>,
    next_solve_at: Option<Timestamp>,
    next_placement_at: Option<Timestamp>,
    counts: Counts,
}

impl Anchor {
    /// An anchor without a map. `epoch` is one above the highest that is known.
    pub fn new(settings: AnchorSettings, epoch: Epoch) -> Self {
        Self::with_reference(settings, epoch, Reference::Fixed)
    }

    fn with_reference(settings: AnchorSettings, epoch: Epoch, reference: Reference) -> Self {
        let map = MapId {
            anchor: settings.vehicle.clone(),
            epoch,
        };
        Self {
            georeferencer: Georeferencer::new(settings.georeference.clone()),
            georeference: None,
            chunks_were_told: false,
            cutter: Cutter::default(),
            placer: Placer::new(reference),
            reference,
            state: VehicleState::NoMap,
            reason: "no keyframe yet".to_owned(),
            last_fix_at: None,
            next_solve_at: None,
            next_placement_at: None,
            counts: Counts::default(),
            datum: settings.datum.clone(),
            settings,
            map,
        }
    }

    /// Takes an event. `now` is of the clock that stamps frames and fixes.
    pub fn handle(&mut self, event: Event, now: Timestamp) -> Vec<Effect> {
        let mut effects = Vec::new();
        match event {
            Event::Frame(frame) if self.is_fixed() => self.georeferencer.insert_frame(&frame),
            Event::KeyframeInserted(pose) => {
                if self.is_fixed() {
                    self.georeferencer.insert_keyframe(pose);
                }
                self.cutter.insert(pose, now);
                self.forget_unplaced();
            }
            Event::KeyframeSettled(keyframe) => {
                if let Some(depth) = keyframe.median_depth() {
                    self.georeferencer.insert_depth(keyframe.pose.id, depth);
                }
                self.cut(&keyframe, &mut effects);
            }
            Event::KeyframesMoved(poses) => {
                self.georeferencer.move_keyframes(&poses);
                if self.placer.move_keyframes(&poses) {
                    // What was solved is in units that no longer hold.
                    self.next_solve_at = None;
                    if !self.is_fixed() {
                        self.georeference = None;
                    }
                }
            }
            Event::Fix(fix) if self.is_fixed() => self.take_fix(fix),
            Event::Registered(registration) => {
                self.take_registration(registration, now, &mut effects);
            }
            // A map without fixes of its own asks for no ties to them.
            Event::Frame(_) | Event::Fix(_) | Event::Tick => {}
            Event::MapRestarted { epoch_random } => self.restart(epoch_random),
        }
        if self.may_cut() {
            let mut cutter = std::mem::take(&mut self.cutter);
            let due = cutter.due(now, &self.settings.cut, |id| self.is_placed(id));
            self.cutter = cutter;
            effects.extend(due.into_iter().map(Effect::RequestKeyframe));
        }
        if self.is_fixed() && self.next_solve_at.is_none_or(|next| now >= next) {
            self.solve(now, &mut effects);
        }
        if self.next_placement_at.is_none_or(|next| now >= next) {
            self.place(now, &mut effects);
        }
        effects
    }

    pub fn state(&self) -> (VehicleState, &str) {
        (self.state, &self.reason)
    }

    pub fn map(&self) -> &MapId {
        &self.map
    }

    pub fn datum(&self) -> Option<&Datum> {
        self.datum.as_ref()
    }

    /// The newest georeference; it may be stale, as the state says.
    pub fn georeference(&self) -> Option<&Georeference> {
        self.georeference.as_ref()
    }

    /// The similarity that holds at the newest keyframes, and its covariance: for the vehicle's
    /// own pose.
    pub fn enu_from_map(&self) -> Option<(Similarity<Enu, Map>, Matrix7)> {
        let georeference = self.georeference.as_ref()?;
        let (id, _) = georeference.keyframes.last_key_value()?;
        let pose = self.georeferencer.keyframe(*id)?;
        georeference.enu_from_map_near(*id, &pose.map_from_camera)
    }

    pub fn counts(&self) -> Counts {
        let (used, without_pose) = self.georeferencer.fix_counts();
        let mut counts = self.counts;
        counts.fixes.used += used;
        counts.fixes.without_pose += without_pose;
        counts
    }

    fn take_fix(&mut self, fix: PositionFix) {
        let counts = &mut self.counts.fixes;
        if !fix.is_well_formed() {
            counts.malformed += 1;
            return;
        }
        if self.last_fix_at.is_some_and(|last| fix.captured_at <= last) {
            counts.out_of_order += 1;
            return;
        }
        let antenna_in_enu = match (&fix.position, &self.datum) {
            (FixPosition::Geodetic(position), None) => {
                self.datum = Some(Datum::Wgs84(*position));
                Some(nalgebra::Vector3::zeros())
            }
            (FixPosition::Geodetic(position), Some(datum)) => {
                datum.point_in_enu(position, &self.settings.surveys).ok()
            }
            (FixPosition::Local(point), Some(_)) => Some(*point),
            (FixPosition::Local(_), None) => None,
        };
        let Some(antenna_in_enu) = antenna_in_enu else {
            counts.foreign_datum += 1;
            return;
        };
        self.last_fix_at = Some(fix.captured_at);
        self.georeferencer.insert_fix(LocalFix {
            captured_at: fix.captured_at,
            antenna_in_enu,
            covariance: fix.covariance,
            heading: fix.heading,
        });
    }

    fn restart(&mut self, epoch_random: u32) {
        let counts = self.counts();
        self.map.epoch = Epoch {
            counter: self.map.epoch.counter.saturating_add(1),
            random: epoch_random,
        };
        self.georeferencer = Georeferencer::new(self.settings.georeference.clone());
        self.georeference = None;
        self.cutter = Cutter::default();
        self.placer = Placer::new(self.reference);
        self.next_solve_at = None;
        self.next_placement_at = None;
        self.counts = counts;
        if !self.is_fixed() {
            self.state = VehicleState::NoMap;
        }
    }

    /// What may be said now, from the newest attempt to solve.
    fn judge(&self, attempt: Option<NotObservable>, now: Timestamp) -> (VehicleState, String) {
        if self.georeferencer.newest_keyframe().is_none() {
            return (VehicleState::NoMap, "no keyframe yet".to_owned());
        }
        let Some(georeference) = &self.georeference else {
            let reason = attempt.map_or_else(String::new, |why| why.to_string());
            return (VehicleState::LocalUnscaled, reason);
        };
        let stale_after_s = self.settings.stale_after_s;
        if now - georeference.newest_fix_at > stale_after_s {
            let reason = format!("no accepted fix for more than {stale_after_s} s");
            return (VehicleState::GlobalStale, reason);
        }
        if let Some(why) = attempt {
            return (VehicleState::GlobalStale, why.to_string());
        }
        (VehicleState::Global, "position fixes".to_owned())
    }

    fn solve(&mut self, now: Timestamp, effects: &mut Vec<Effect>) {
        let interval = Duration::from_secs_f64(self.settings.solve_interval_s);
        self.next_solve_at = Some(now.after(interval));
        let attempt = match self.georeferencer.solve() {
            Ok(georeference) => {
                self.georeference = Some(georeference);
                None
            }
            Err(why) => Some(why),
        };
        let judged = self.judge(attempt, now);
        self.enter(judged, effects);
    }

    fn enter(&mut self, (state, reason): (VehicleState, String), effects: &mut Vec<Effect>) {
        if (state, &reason) != (self.state, &self.reason) {
            if state == VehicleState::Global && !self.placer.is_placed() {
                // Others wait for nothing else.
                self.next_placement_at = None;
            }
            self.state = state;
            self.reason = reason.clone();
            effects.push(Effect::StateChanged { state, reason });
        }
    }

    fn place(&mut self, now: Timestamp, effects: &mut Vec<Effect>) {
        let interval = Duration::from_secs_f64(self.settings.placement_interval_s);
        self.next_placement_at = Some(now.after(interval));
        let global = self.state == VehicleState::Global;
        let solved = self.georeference.as_ref().filter(|_| global);
        effects.extend(
            self.placer
                .publish(solved, &self.map, self.datum.as_ref(), &self.settings),
        );
        self.chunks_were_told |= global;
    }
}

#[cfg(test)]
mod tests;

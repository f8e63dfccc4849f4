//! What happens to the map when a frame becomes a keyframe.

mod adjust;
mod bridge;
mod cull_keyframes;
mod cull_points;
mod directions;
mod fuse;
mod grow;
mod settling;

use geometry::{Camera, Map, Transform};

pub(crate) use adjust::{Selection, adjust_all, adjust_local, renew_point, stretches};
pub(crate) use fuse::fuse;

pub(crate) use settling::Settling;

use crate::bundle::Workspace;
use crate::frame::Frame;
use crate::optics::Optics;
use crate::{KeyframeId, PointId, VslamMap};

/// Neighbours that a keyframe remembers.
const NEIGHBOURS_MAX: usize = 12;
/// A keyframe counts as a neighbour if it shares this many points.
const SHARED_MIN: u32 = 15;
/// A keyframe is settled at the latest when this many newer ones were inserted.
const UNSETTLED_MAX: usize = 10;

/// The mapper: what it must remember from keyframe to keyframe.
#[derive(Debug, Default)]
pub(crate) struct Mapper {
    /// Points that still have to prove themselves, oldest first.
    recent: Vec<PointId>,
    /// Keyframes that were not yet reported as settled, oldest first.
    unsettled: Vec<KeyframeId>,
    settling: Settling,
    workspace: Workspace,
}

/// What inserting a keyframe did.
#[derive(Clone, Debug)]
pub(crate) struct Insertion {
    pub(crate) keyframe: KeyframeId,
    pub(crate) settled: Vec<KeyframeId>,
}

impl Mapper {
    /// Starts over with a map that has just been made.
    pub(crate) fn take_over(&mut self, map: &VslamMap) {
        self.recent.clear();
        self.unsettled = map.keyframes().map(crate::Keyframe::id).collect();
        self.settling = Settling::default();
    }

    /// Goes on with a map that was left. Those of its keyframes that were not yet reported as
    /// settled never are: reports have been of another map since.
    pub(crate) fn resume(&mut self) {
        self.recent.clear();
        self.unsettled.clear();
        self.settling = Settling::default();
    }

    /// Forgets what adjustments said of a map that is another one now.
    pub(crate) fn settle_anew(&mut self) {
        self.settling = Settling::default();
    }

    /// What the last adjustments say of the map around the camera.
    pub(crate) fn settling(&self) -> &Settling {
        &self.settling
    }

    /// Makes a keyframe of a tracked frame and brings the map around it up to date.
    pub(crate) fn insert(
        &mut self,
        optics: &Optics,
        map: &mut VslamMap,
        frame: Frame,
        (camera_from_map, reference): (Transform<Camera, Map>, KeyframeId),
    ) -> Insertion {
        let id = map.add_keyframe(frame, camera_from_map);
        if let Some(keyframe) = map.keyframe_mut(id) {
            keyframe.parent = Some(reference);
        }
        refresh_points_of(map, id);
        cull_points::cull(map, &mut self.recent, id);
        self.recent.extend(grow::triangulate_new(optics, map, id));
        update_neighbours(map, id);
        fuse::fuse_with_neighbours(optics, map, id);
        refresh_points_of(map, id);
        let directions = directions::add_directions(optics, map, id);
        self.recent.extend(directions);
        update_neighbours(map, id);
        let (window, shift) = self.adjust(map, id);
        self.settling.note(map, id, shift);
        directions::settle_directions(map, &window);
        cull_keyframes::cull(map, id);
        self.unsettled.push(id);
        let settled = self.settle(map, &window);
        Insertion {
            keyframe: id,
            settled,
        }
    }

    /// Adjusts the map around the newest keyframe; returns the keyframes that could move, and how
    /// far the newest would have.
    fn adjust(&mut self, map: &mut VslamMap, newest: KeyframeId) -> (Vec<KeyframeId>, f64) {
        let bridged = bridge::bridge(map, newest, &mut self.workspace);
        bridged.unwrap_or_else(|| adjust::adjust_local(map, newest, &mut self.workspace))
    }

    /// Takes the keyframes that the last local adjustment no longer moved, or that are old.
    fn settle(&mut self, map: &VslamMap, window: &[KeyframeId]) -> Vec<KeyframeId> {
        self.unsettled.retain(|id| map.keyframe(*id).is_some());
        let old_count = self.unsettled.len().saturating_sub(UNSETTLED_MAX);
        let mut settled = Vec::new();
        let mut position = 0;
        self.unsettled.retain(|id| {
            position += 1;
            let stays = position > old_count && window.contains(id);
            if !stays {
                settled.push(*id);
            }
            stays
        });
        settled
    }
}

fn refresh_points_of(map: &mut VslamMap, id: KeyframeId) {
    let points: Vec<PointId> = map
        .keyframe(id)
        .map(|keyframe| keyframe.points().collect())
        .unwrap_or_default();
    for point in points {
        map.refresh_point(point);
    }
}

/// Renews the memory of who is near, for a keyframe and those near it.
pub(crate) fn update_neighbours(map: &mut VslamMap, id: KeyframeId) {
    let nearest = nearest_keyframes(map, id);
    for &neighbour in &nearest {
        let theirs = nearest_keyframes(map, neighbour);
        if let Some(keyframe) = map.keyframe_mut(neighbour) {
            keyframe.neighbours = theirs;
        }
    }
    if let Some(keyframe) = map.keyframe_mut(id) {
        keyframe.neighbours = nearest;
    }
}

fn nearest_keyframes(map: &VslamMap, id: KeyframeId) -> Vec<KeyframeId> {
    let covisible = map.covisible(id);
    covisible
        .iter()
        .enumerate()
        .take(NEIGHBOURS_MAX)
        // The nearest one counts however little it shares.
        .filter(|(rank, one)| *rank == 0 || one.shared_count >= SHARED_MIN)
        .map(|(_, one)| one.keyframe)
        .collect()
}

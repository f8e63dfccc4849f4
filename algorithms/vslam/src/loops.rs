//! Places that come into view again: loops are closed, maps joined.
//!
//! What a camera returns to is first suspected by its looks ([`crate::places`]), then proved by
//! geometry ([`mod@recognise`]), and only then is the map bent ([`mod@close`], [`mod@graph`]).

mod align;
mod close;
mod global;
mod graph;
mod join;
mod pending;
mod recognise;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use geometry::{Map, Similarity};
use rand_chacha::ChaCha8Rng;

pub(crate) use join::{Joined, find_in};

use crate::bundle::Workspace;
use crate::optics::Optics;
use crate::places::Places;
use crate::settings::Background;
use crate::{Keyframe, KeyframeId, VslamMap, VslamSettings};
use pending::Pending;
use recognise::{Query, Recognition, recognise};

/// The newest keyframes are no loop.
const RECENT_KEYFRAMES: usize = 10;
/// Keyframes between two closed loops.
const PAUSE_KEYFRAMES: u32 = 5;
/// Closed loops that are remembered; the oldest are forgotten first.
const LINKS_MAX: usize = 64;
/// How far a map may have drifted: as a share of the way since, and depths of what is seen.
const DRIFT_SHARE_MAX: f64 = 0.25;
const DRIFT_DEPTHS_MAX: f64 = 0.3;
const DRIFT_RAD_MAX: f64 = 0.8;
const DRIFT_LOG_SCALE_MAX: f64 = 1.1;
/// With less drift than this (rad, ln, shares of the depth) there is nothing to correct.
const DRIFT_MIN: f64 = 0.004;

/// Closes loops: what must be remembered from keyframe to keyframe.
#[derive(Debug, Default)]
pub(crate) struct Loops {
    /// The ends of the loops that were closed.
    links: Vec<(KeyframeId, KeyframeId)>,
    last_closed_at: Option<KeyframeId>,
    adjusted_keyframes_max: usize,
    background: Option<Background>,
    /// What a loop or a join set off, until it counts.
    adjustment: Option<Pending>,
    workspace: Workspace,
}

impl Loops {
    pub(crate) fn new(settings: &VslamSettings) -> Self {
        Self {
            adjusted_keyframes_max: settings.global_adjustment_keyframes_max,
            background: settings.background,
            ..Self::default()
        }
    }

    /// Goes on with the adjustment of the whole map that a loop or a join set off; whether that
    /// takes this frame's time.
    pub(crate) fn adjust_further(&mut self, map: &mut VslamMap) -> bool {
        // One of a map that was left since would take time in vain.
        let adjustment = self.adjustment.take().filter(|one| one.is_of(map));
        let Some(mut adjustment) = adjustment else {
            return false;
        };
        let lends = adjustment.pass_frame();
        if adjustment.is_due() {
            adjustment.finish(map);
        } else {
            self.adjustment = Some(adjustment);
        }
        lends
    }

    /// Adjusts the whole map at once.
    pub(crate) fn adjust_all(&mut self, map: &mut VslamMap) {
        self.adjustment = None;
        if self.affords(map) {
            Pending::new(map, None).finish(map);
        }
    }

    fn begin_adjustment(&mut self, map: &VslamMap) {
        let affordable = self.affords(map);
        self.adjustment = affordable.then(|| Pending::new(map, self.background));
    }

    /// Maps with more keyframes are not adjusted as a whole.
    fn affords(&self, map: &VslamMap) -> bool {
        map.keyframe_count() <= self.adjusted_keyframes_max
    }

    /// Looks whether a new keyframe shows a place that the map has already but does not know to be
    /// the same, and corrects the map if so; by how much lengths around the keyframe grew.
    pub(crate) fn close_at(
        &mut self,
        (optics, places): (&Optics, &Places),
        map: &mut VslamMap,
        id: KeyframeId,
        rng: &mut ChaCha8Rng,
    ) -> Option<f64> {
        let resting = |last: KeyframeId| id.0 < last.0 + PAUSE_KEYFRAMES;
        if self.last_closed_at.is_some_and(resting) {
            return None;
        }
        let near = near(map, id);
        if near.len() >= map.keyframe_count() {
            return None;
        }
        let keyframe = map.keyframe(id)?;
        let descriptors = keyframe.observations.iter().map(|one| &one.descriptor);
        let alike = places.look_alikes(descriptors);
        let query = Query { map, keyframe };
        let usable = |other: KeyframeId| !near.contains(&other);
        let found = recognise(optics, query, map, &alike, usable, rng)?;
        let drift = Drift::of(map, keyframe, &found)?;
        if !drift.is_plausible() {
            return None;
        }
        self.last_closed_at = Some(id);
        if drift.is_negligible() {
            let moved = close::companions(map, id);
            close::join_points(optics, map, &found, &moved);
            close::mend(optics, map, &found, &moved, &mut self.workspace);
            return None;
        }
        close::close(optics, map, &found, &self.links, &mut self.workspace);
        self.begin_adjustment(map);
        if self.links.len() == LINKS_MAX {
            self.links.remove(0);
        }
        self.links.push((found.place, found.keyframe));
        Some(found.target_from_source.scale())
    }
}

/// Keyframes that cannot be the far end of a loop: the newest, those that share points with the
/// keyframe, and their neighbours.
fn near(map: &VslamMap, id: KeyframeId) -> BTreeSet<KeyframeId> {
    let newest = map.keyframes().rev().take(RECENT_KEYFRAMES);
    let mut near: BTreeSet<KeyframeId> = newest.map(Keyframe::id).collect();
    near.insert(id);
    for one in map.covisible(id) {
        near.insert(one.keyframe);
        let theirs = map.keyframe(one.keyframe).map(|one| &one.neighbours);
        near.extend(theirs.into_iter().flatten().copied());
    }
    near.retain(|id| map.keyframe(*id).is_some());
    near
}

/// By how much the map must have drifted for a place to be where it was recognised.
#[derive(Clone, Copy, Debug)]
struct Drift {
    /// How far the keyframe would move, and the way that the camera made since the place.
    distance: f64,
    way: f64,
    depth: f64,
    turn_rad: f64,
    log_scale: f64,
}

impl Drift {
    fn of(map: &VslamMap, keyframe: &Keyframe, found: &Recognition) -> Option<Self> {
        let target_from_source: &Similarity<Map, Map> = &found.target_from_source;
        let since = map.keyframes().skip_while(|one| one.id < found.place);
        let centres: Vec<_> = since.map(Keyframe::centre_in_map).collect();
        let steps = centres.windows(2).map(|pair| (pair[1] - pair[0]).norm());
        let centre = keyframe.centre_in_map();
        Some(Self {
            distance: (*target_from_source * centre - centre).norm(),
            way: steps.sum(),
            depth: map.median_depth(keyframe.id)?,
            turn_rad: target_from_source.rotation().angle(),
            log_scale: target_from_source.scale().ln(),
        })
    }

    /// Two places that only look the same are as far apart as the way between them; drift is much
    /// less.
    fn is_plausible(&self) -> bool {
        self.distance <= DRIFT_SHARE_MAX * self.way + DRIFT_DEPTHS_MAX * self.depth
            && self.turn_rad <= DRIFT_RAD_MAX
            && self.log_scale.abs() <= DRIFT_LOG_SCALE_MAX
    }

    fn is_negligible(&self) -> bool {
        let most = self.turn_rad.max(self.log_scale.abs());
        most.max(self.distance / self.depth) <= DRIFT_MIN
    }
}

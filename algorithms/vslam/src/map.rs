//! The sparse map: keyframes, points, and who sees what.

mod arena;
mod correct;
mod covisibility;
mod edit;
mod ids;
mod keyframe;
mod merge;
mod parts;
mod place;
mod point;

use std::collections::BTreeMap;

pub use ids::{KeyframeId, MapId, PointId};
pub use keyframe::{Keyframe, Observation};
pub use parts::{KeyframeParts, KeypointParts, MapParts, MapPartsError, PointParts, ViewParts};
pub(crate) use point::ExpectedRange;
pub use point::{MapPoint, View};

use arena::Arena;
pub(crate) use correct::Moves;
pub(crate) use edit::NewPoint;
use place::CulledKeyframe;
pub(crate) use place::Place;

/// Keyframes and points in one frame of reference of unknown scale.
#[derive(Clone, Debug)]
pub struct VslamMap {
    id: MapId,
    revision: u64,
    keyframes: Arena<Keyframe>,
    points: Arena<MapPoint>,
    /// Where culled keyframes stand, relative to the keyframe that took over.
    culled: BTreeMap<KeyframeId, CulledKeyframe>,
    /// Whether it was there before this session, which is to go on in it.
    continued: bool,
}

impl VslamMap {
    pub(crate) fn new(id: MapId, first_keyframe: KeyframeId, first_point: PointId) -> Self {
        Self {
            id,
            revision: 0,
            keyframes: Arena::starting_at(first_keyframe.0),
            points: Arena::starting_at(first_point.0),
            culled: BTreeMap::new(),
            continued: false,
        }
    }

    /// An empty map whose ids follow those of this one.
    pub(crate) fn successor(&self, id: MapId) -> Self {
        Self::new(
            id,
            KeyframeId(self.keyframes.next_id()),
            PointId(self.points.next_id()),
        )
    }

    /// Leaves out the ids that a younger map has used, so that they stay unique.
    pub(crate) fn reserve_ids_before(&mut self, younger: &Self) {
        self.keyframes.skip_to(younger.keyframes.next_id());
        self.points.skip_to(younger.points.next_id());
    }

    /// How much the map is worth against others: the one that is to be continued is worth most,
    /// else the number of keyframes counts.
    pub(crate) fn rank(&self) -> (bool, usize) {
        (self.continued, self.keyframe_count())
    }

    pub(crate) fn set_continued(&mut self) {
        self.continued = true;
    }

    pub fn id(&self) -> MapId {
        self.id
    }

    /// Grows whenever settled keyframes were moved, as by a loop closure.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// All keyframes, oldest first.
    pub fn keyframes(&self) -> impl DoubleEndedIterator<Item = &Keyframe> {
        self.keyframes.iter()
    }

    pub fn keyframe_count(&self) -> usize {
        self.keyframes.len()
    }

    /// The keyframe with this id, unless it was culled or is of another map.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.keyframes.get(id.0)
    }

    pub(crate) fn keyframe_mut(&mut self, id: KeyframeId) -> Option<&mut Keyframe> {
        self.keyframes.get_mut(id.0)
    }

    /// All points, oldest first.
    pub fn points(&self) -> impl DoubleEndedIterator<Item = &MapPoint> {
        self.points.iter()
    }

    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// The point with this id, unless it was culled or is of another map.
    pub fn point(&self, id: PointId) -> Option<&MapPoint> {
        self.points.get(id.0)
    }

    pub(crate) fn point_mut(&mut self, id: PointId) -> Option<&mut MapPoint> {
        self.points.get_mut(id.0)
    }
}

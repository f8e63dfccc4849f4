//! The sparse map: keyframes, points, and who sees what.

mod arena;
mod covisibility;
mod edit;
mod ids;
mod keyframe;
mod point;

use std::collections::BTreeMap;

pub use ids::{KeyframeId, MapId, PointId};
pub use keyframe::{Keyframe, Observation};
pub use point::{MapPoint, View};

use arena::Arena;
pub(crate) use edit::NewPoint;
use geometry::{Camera, Map, Transform};

/// Keyframes and points in one frame of reference of unknown scale.
#[derive(Clone, Debug)]
pub struct VslamMap {
    id: MapId,
    revision: u64,
    keyframes: Arena<Keyframe>,
    points: Arena<MapPoint>,
    /// Where culled keyframes stand, relative to the keyframe that took over.
    culled: BTreeMap<KeyframeId, CulledKeyframe>,
}

#[derive(Clone, Copy, Debug)]
struct CulledKeyframe {
    heir: KeyframeId,
    camera_from_heir: Transform<Camera, Camera>,
}

impl VslamMap {
    pub(crate) fn new(id: MapId, first_keyframe: KeyframeId, first_point: PointId) -> Self {
        Self {
            id,
            revision: 0,
            keyframes: Arena::starting_at(first_keyframe.0),
            points: Arena::starting_at(first_point.0),
            culled: BTreeMap::new(),
        }
    }

    /// An empty map whose ids follow those of this one.
    pub(crate) fn successor(&self) -> Self {
        Self::new(
            MapId(self.id.0 + 1),
            KeyframeId(self.keyframes.next_id()),
            PointId(self.points.next_id()),
        )
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

    /// The keyframe that stands for this one: itself, or its heir if it was culled, and where the
    /// camera was relative to that.
    pub(crate) fn resolve(
        &self,
        id: KeyframeId,
    ) -> Option<(KeyframeId, Transform<Camera, Camera>)> {
        let mut holder = id;
        let mut camera_from_holder = Transform::identity();
        while self.keyframe(holder).is_none() {
            let culled = self.culled.get(&holder)?;
            camera_from_holder = camera_from_holder * culled.camera_from_heir;
            holder = culled.heir;
        }
        Some((holder, camera_from_holder))
    }

    /// The pose of a camera that is known relative to a keyframe, culled or not.
    pub(crate) fn camera_from_map(
        &self,
        id: KeyframeId,
        camera_from_keyframe: &Transform<Camera, Camera>,
    ) -> Option<Transform<Camera, Map>> {
        let (holder, keyframe_from_holder) = self.resolve(id)?;
        let holder_from_map = self.keyframe(holder)?.camera_from_map;
        Some(*camera_from_keyframe * keyframe_from_holder * holder_from_map)
    }
}

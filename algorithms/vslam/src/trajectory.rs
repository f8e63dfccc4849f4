//! What is remembered of each frame.

use geometry::Timestamp;

use crate::loops::Joined;
use crate::map::Place;
use crate::{MapId, TrajectoryEntry, VslamMap};

/// A frame's place relative to a keyframe, so that it follows corrections of the map.
#[derive(Clone, Debug)]
pub(crate) struct FrameRecord {
    pub(crate) captured_at: Timestamp,
    pub(crate) map_id: MapId,
    pub(crate) place: Option<Place>,
    /// Whether it had a pose at once; otherwise it was found afterwards, if at all.
    pub(crate) was_tracked: bool,
}

impl FrameRecord {
    /// Takes note of a place that was found afterwards.
    pub(crate) fn find(&mut self, map_id: MapId, place: Place) {
        self.map_id = map_id;
        self.place = Some(place);
        self.was_tracked = false;
    }

    /// Takes note that two maps have become one.
    pub(crate) fn follow(&mut self, joined: &Joined) {
        if self.map_id == joined.from {
            self.map_id = joined.into;
        }
    }

    /// The entry with the pose of now, if one of the maps still has the frame.
    pub(crate) fn entry<'a>(
        &self,
        frame_idx: u64,
        mut maps: impl Iterator<Item = &'a VslamMap>,
    ) -> TrajectoryEntry {
        let map = maps.find(|map| map.id() == self.map_id);
        let camera_from_map = self
            .place
            .zip(map)
            .and_then(|(place, map)| map.pose(&place));
        TrajectoryEntry {
            frame_idx,
            captured_at: self.captured_at,
            map_id: self.map_id,
            map_from_camera: camera_from_map.map(|pose| pose.inverse()),
        }
    }
}

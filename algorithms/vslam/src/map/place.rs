//! Where cameras stand that are not part of the map.

use geometry::{Camera, Map, Transform};

use super::VslamMap;
use crate::KeyframeId;

/// A camera's pose relative to a keyframe, so that it follows corrections of the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) keyframe: KeyframeId,
    camera_from_keyframe: Transform<Camera, Camera>,
    /// The keyframe's unit at the time.
    unit: f64,
}

/// Where a culled keyframe stands, and what its unit was.
#[derive(Clone, Copy, Debug)]
pub(super) struct CulledKeyframe {
    pub(super) place: Place,
    pub(super) unit: f64,
}

impl VslamMap {
    /// Notes a pose relative to a keyframe of the map.
    pub(crate) fn place(
        &self,
        keyframe: KeyframeId,
        camera_from_map: &Transform<Camera, Map>,
    ) -> Option<Place> {
        let reference = self.keyframe(keyframe)?;
        Some(Place {
            keyframe,
            camera_from_keyframe: *camera_from_map * reference.camera_from_map.inverse(),
            unit: reference.unit,
        })
    }

    /// The pose of now of a place that was noted earlier.
    pub(crate) fn pose(&self, place: &Place) -> Option<Transform<Camera, Map>> {
        Some(self.pose_and_scale(place)?.0)
    }

    /// The pose, and by how much lengths have grown since it was noted.
    fn pose_and_scale(&self, place: &Place) -> Option<(Transform<Camera, Map>, f64)> {
        let (keyframe_from_map, unit) = match self.keyframe(place.keyframe) {
            Some(keyframe) => (keyframe.camera_from_map, keyframe.unit),
            None => {
                let culled = self.culled.get(&place.keyframe)?;
                let (pose, scale) = self.pose_and_scale(&culled.place)?;
                (pose, culled.unit * scale)
            }
        };
        let scale = unit / place.unit;
        let relative = &place.camera_from_keyframe;
        let scaled: Transform<Camera, Camera> =
            Transform::new(*relative.rotation(), relative.translation() * scale);
        Some((scaled * keyframe_from_map, scale))
    }

    /// The keyframe itself, or the one that took over where it was culled.
    pub(crate) fn holder(&self, id: KeyframeId) -> Option<KeyframeId> {
        let mut holder = id;
        while self.keyframe(holder).is_none() {
            holder = self.culled.get(&holder)?.place.keyframe;
        }
        Some(holder)
    }
}

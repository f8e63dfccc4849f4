//! Changes of where settled parts of the map are.

use std::collections::BTreeMap;

use geometry::{Map, Similarity};

use super::{MapPoint, VslamMap};
use crate::{KeyframeId, PointId};

/// Where keyframes and what they see go, each in the scale of its surroundings.
pub(crate) type Moves = BTreeMap<KeyframeId, Similarity<Map, Map>>;

impl VslamMap {
    /// Moves keyframes, and each point with the oldest of those that see it.
    pub(crate) fn correct(&mut self, moves: &Moves) {
        self.revision += 1;
        for (id, new_from_old) in moves {
            if let Some(keyframe) = self.keyframes.get_mut(id.0) {
                let map_from_camera = keyframe.map_from_camera();
                let moved = new_from_old.transform_pose(&map_from_camera);
                keyframe.camera_from_map = moved.inverse();
                keyframe.unit *= new_from_old.scale();
            }
        }
        let all: Vec<PointId> = self.points.iter().map(|point| point.id).collect();
        for id in all {
            let Some(point) = self.points.get_mut(id.0) else {
                continue;
            };
            let mover = point.views.iter().find_map(|one| moves.get(&one.keyframe));
            if let Some(new_from_old) = mover {
                point.transform(new_from_old);
            }
        }
    }
}

impl MapPoint {
    fn transform(&mut self, new_from_old: &Similarity<Map, Map>) {
        let linear = new_from_old.linear_matrix();
        self.position_in_map = *new_from_old * self.position_in_map;
        self.covariance_in_map = linear * self.covariance_in_map * linear.transpose();
        self.viewing_direction = new_from_old.rotation() * self.viewing_direction;
        self.finest_distance *= new_from_old.scale();
        if let Some(expected) = &mut self.expected_range {
            expected.inverse_range /= new_from_old.scale();
            expected.sigma /= new_from_old.scale();
        }
    }
}

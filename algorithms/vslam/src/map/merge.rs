//! One map of two.

use geometry::{Map, Similarity};

use super::{Moves, VslamMap};
use crate::KeyframeId;

impl VslamMap {
    /// Moves everything at once.
    pub(crate) fn transform(&mut self, new_from_old: &Similarity<Map, Map>) {
        let all = self.keyframes.iter().map(|one| (one.id, *new_from_old));
        let moves: Moves = all.collect();
        self.correct(&moves);
    }

    /// Takes over all of a map that stands in this one's frame of reference. What began that map
    /// becomes a child of `parent`. Ids stay.
    pub(crate) fn absorb(&mut self, other: Self, parent: KeyframeId) {
        self.revision += 1;
        self.reserve_ids_before(&other);
        for mut keyframe in other.keyframes.into_values() {
            keyframe.parent = keyframe.parent.or(Some(parent));
            self.keyframes.insert(keyframe.id.0, keyframe);
        }
        for point in other.points.into_values() {
            self.points.insert(point.id.0, point);
        }
        self.culled.extend(other.culled);
    }
}

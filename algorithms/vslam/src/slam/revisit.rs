//! What follows when a new keyframe shows a place that was seen before.

use rand_chacha::ChaCha8Rng;

use crate::loops::Loops;
use crate::optics::Optics;
use crate::places::Places;
use crate::trajectory::FrameRecord;
use crate::{KeyframeId, VslamMap};

/// What of the machine takes part.
pub(super) struct Revisit<'a> {
    pub(super) optics: &'a Optics,
    pub(super) places: &'a mut Places,
    pub(super) loops: &'a mut Loops,
    pub(super) earlier: &'a mut Vec<VslamMap>,
    pub(super) trajectory: &'a mut [FrameRecord],
}

impl Revisit<'_> {
    /// Closes the loop that a new keyframe ends, or joins the map that it comes back to; by how
    /// much lengths around it grew.
    pub(super) fn by(self, id: KeyframeId, map: &mut VslamMap, rng: &mut ChaCha8Rng) -> f64 {
        let index = (self.optics, &*self.places);
        let joined = self.loops.join_at(index, map, self.earlier, id, rng);
        let stretch = match joined {
            Some(joined) => {
                for record in self.trajectory {
                    record.follow(&joined);
                }
                joined.stretch
            }
            None => self.loops.close_at(index, map, id, rng).unwrap_or(1.0),
        };
        if let Some(keyframe) = map.keyframe(id) {
            self.places.insert(keyframe);
        }
        stretch
    }
}

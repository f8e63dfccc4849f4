//! What follows when a new keyframe shows a place that was seen before.

use rand_chacha::ChaCha8Rng;

use crate::loops::Loops;
use crate::optics::Optics;
use crate::places::Places;
use crate::{KeyframeId, VslamMap};

/// Closes the loop that a new keyframe ends, if it ends one.
pub(super) fn revisit(
    (optics, places, loops): (&Optics, &mut Places, &mut Loops),
    map: &mut VslamMap,
    id: KeyframeId,
    rng: &mut ChaCha8Rng,
) {
    loops.close_at((optics, places), map, id, rng);
    if let Some(keyframe) = map.keyframe(id) {
        places.insert(keyframe);
    }
}

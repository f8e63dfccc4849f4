//! Makes one map of two that show the same place.

use rand_chacha::ChaCha8Rng;

use super::recognise::{Query, Recognition, recognise};
use super::{Loops, close};
use crate::optics::Optics;
use crate::places::Places;
use crate::{KeyframeId, MapId, VslamMap};

/// Two maps have become one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Joined {
    /// The map that is no more.
    pub(crate) from: MapId,
    /// The larger one, which took it over.
    pub(crate) into: MapId,
    /// By how much lengths grew around the camera.
    pub(crate) stretch: f64,
}

impl Loops {
    /// Looks whether a new keyframe shows a place of an earlier map, and makes one map of the two
    /// if so. The larger one keeps its name and its frame of reference.
    pub(crate) fn join_at(
        &mut self,
        (optics, places): (&Optics, &Places),
        map: &mut VslamMap,
        earlier: &mut Vec<VslamMap>,
        id: KeyframeId,
        rng: &mut ChaCha8Rng,
    ) -> Option<Joined> {
        if earlier.is_empty() {
            return None;
        }
        let keyframe = map.keyframe(id)?;
        let descriptors = keyframe.observations.iter().map(|one| &one.descriptor);
        let alike = places.look_alikes(descriptors);
        let query = Query { map, keyframe };
        let (idx, found) = earlier.iter().enumerate().find_map(|(idx, target)| {
            let found = recognise(optics, query, target, &alike, |_| true, rng)?;
            Some((idx, found))
        })?;
        let joined = unite(map, earlier.remove(idx), &found);
        self.last_closed_at = Some(id);
        let moved = close::companions(map, id);
        close::join_points(optics, map, &found, &moved);
        close::mend(optics, map, &found, &moved, &mut self.workspace);
        Some(joined)
    }
}

/// Moves the smaller map into the larger.
fn unite(map: &mut VslamMap, mut other: VslamMap, found: &Recognition) -> Joined {
    let other_from_map = &found.target_from_source;
    let other_is_larger = other.keyframe_count() >= map.keyframe_count();
    if !other_is_larger {
        other.transform(&other_from_map.inverse());
        let from = other.id();
        map.absorb(other, found.keyframe);
        return Joined {
            from,
            into: map.id(),
            stretch: 1.0,
        };
    }
    map.transform(other_from_map);
    std::mem::swap(map, &mut other);
    let from = other.id();
    map.absorb(other, found.place);
    Joined {
        from,
        into: map.id(),
        stretch: other_from_map.scale(),
    }
}

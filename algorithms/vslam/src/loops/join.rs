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
    /// if so.
    pub(crate) fn join_at(
        &mut self,
        (optics, places): (&Optics, &Places),
        map: &mut VslamMap,
        earlier: &mut Vec<VslamMap>,
        id: KeyframeId,
        rng: &mut ChaCha8Rng,
    ) -> Option<Joined> {
        let (idx, found) = earlier.iter().enumerate().find_map(|(idx, target)| {
            let found = find_in((optics, places), target, (map, id), rng)?;
            Some((idx, found))
        })?;
        Some(self.join(optics, map, earlier.remove(idx), &found))
    }

    /// Makes one map of two, of which a keyframe of the first was recognised in the other. The
    /// larger one keeps its name and its frame of reference.
    pub(crate) fn join(
        &mut self,
        optics: &Optics,
        map: &mut VslamMap,
        other: VslamMap,
        found: &Recognition,
    ) -> Joined {
        let joined = unite(map, other, found);
        self.last_closed_at = Some(found.keyframe);
        let moved = close::companions(map, found.keyframe);
        close::join_points(optics, map, found, &moved);
        close::mend(optics, map, found, &moved, &mut self.workspace);
        self.begin_adjustment(map);
        joined
    }
}

/// Looks for a keyframe of one map in another.
pub(crate) fn find_in(
    (optics, places): (&Optics, &Places),
    target: &VslamMap,
    (map, id): (&VslamMap, KeyframeId),
    rng: &mut ChaCha8Rng,
) -> Option<Recognition> {
    let keyframe = map.keyframe(id)?;
    let descriptors = keyframe.observations.iter().map(|one| &one.descriptor);
    let alike = places.look_alikes(descriptors);
    recognise(
        optics,
        Query { map, keyframe },
        target,
        &alike,
        |_| true,
        rng,
    )
}

/// Moves the smaller map into the larger.
fn unite(map: &mut VslamMap, mut other: VslamMap, found: &Recognition) -> Joined {
    let other_from_map = &found.target_from_source;
    let other_is_larger = other.rank() >= map.rank();
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

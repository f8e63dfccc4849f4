//! Which part of one map looks like an image.

use std::collections::BTreeMap;

use super::{LookAlike, sort};
use crate::{KeyframeId, VslamMap};

/// The keyframes of this map that look most like the image together with their neighbours, the
/// best first; of keyframes that are each other's neighbours only the best.
///
/// A culled keyframe counts as the one that took over. Keyframes for which `usable` does not hold
/// are left out, and support nobody.
pub(crate) fn rank(
    map: &VslamMap,
    alike: &[LookAlike],
    usable: impl Fn(KeyframeId) -> bool,
) -> Vec<LookAlike> {
    let mut own: BTreeMap<KeyframeId, LookAlike> = BTreeMap::new();
    for one in alike {
        let Some(keyframe) = map.holder(one.keyframe).filter(|id| usable(*id)) else {
            continue;
        };
        let known = own
            .entry(keyframe)
            .or_insert(LookAlike { keyframe, ..*one });
        known.score = known.score.max(one.score);
        known.shared_count = known.shared_count.max(one.shared_count);
    }
    let mut ranked: Vec<LookAlike> = own
        .values()
        .map(|one| LookAlike {
            score: one.score + support(map, one.keyframe, &own),
            ..*one
        })
        .collect();
    sort(&mut ranked);
    let mut chosen: Vec<LookAlike> = Vec::new();
    for one in ranked {
        let near = |other: &LookAlike| are_neighbours(map, one.keyframe, other.keyframe);
        if !chosen.iter().any(near) {
            chosen.push(one);
        }
    }
    chosen
}

/// What the neighbours add to a keyframe's score.
fn support(map: &VslamMap, id: KeyframeId, own: &BTreeMap<KeyframeId, LookAlike>) -> f32 {
    let neighbours = map.keyframe(id).map(|one| one.neighbours.as_slice());
    neighbours
        .unwrap_or_default()
        .iter()
        .filter_map(|neighbour| own.get(neighbour))
        .map(|neighbour| neighbour.score)
        .sum()
}

fn are_neighbours(map: &VslamMap, one: KeyframeId, other: KeyframeId) -> bool {
    let knows = |id: KeyframeId, other: KeyframeId| {
        map.keyframe(id)
            .is_some_and(|keyframe| keyframe.neighbours.contains(&other))
    };
    knows(one, other) || knows(other, one)
}

//! Makes one place of two that turned out to be the same.

use std::collections::{BTreeMap, BTreeSet};

use geometry::{Map, Similarity};

use super::graph::{self, Poses, Relation};
use super::recognise::Recognition;
use crate::bundle::Workspace;
use crate::map::Moves;
use crate::mapping::{adjust_local, fuse, update_neighbours};
use crate::optics::Optics;
use crate::{KeyframeId, PointId, View, VslamMap};

/// Keyframes whose points are looked for around the keyframe that came back.
const SURROUNDINGS_MAX: usize = 20;
/// A keyframe goes along with the one that came back if it shares this many points with it.
const SHARED_MIN: u32 = 15;

/// The keyframe and those near it, which are corrected by one similarity.
pub(super) fn companions(map: &VslamMap, id: KeyframeId) -> Vec<KeyframeId> {
    let near = map.covisible(id).into_iter();
    let near = near.filter(|one| one.shared_count >= SHARED_MIN);
    let mut companions: Vec<KeyframeId> = near.map(|one| one.keyframe).collect();
    companions.push(id);
    companions
}

/// Corrects the map such that the keyframe stands where it was recognised.
pub(super) fn close(
    optics: &Optics,
    map: &mut VslamMap,
    found: &Recognition,
    links: &[(KeyframeId, KeyframeId)],
    workspace: &mut Workspace,
) {
    let moved = companions(map, found.keyframe);
    let before = graph::poses(map);
    let mut relations = graph::relations(map, &before, links);
    let depth = map.median_depth(found.place).unwrap_or(1.0);
    let fixed = found.place;

    let first_moves: Moves = moved
        .iter()
        .map(|id| (*id, found.target_from_source))
        .collect();
    map.correct(&first_moves);
    let corrected = apply(&before, &first_moves);
    relations.extend(relations_of_loop(map, found, &moved, &corrected));
    join_points(optics, map, found, &moved);
    let moves = graph::settle(&corrected, &relations, fixed, depth);
    map.correct(&moves);
    mend(optics, map, found, &moved, workspace);
}

fn apply(poses: &Poses, moves: &BTreeMap<KeyframeId, Similarity<Map, Map>>) -> Poses {
    let moved = |(id, pose): (&KeyframeId, &_)| match moves.get(id) {
        Some(new_from_old) => (*id, *new_from_old * *pose),
        None => (*id, *pose),
    };
    poses.iter().map(moved).collect()
}

/// How the corrected keyframes stand to those of the place.
fn relations_of_loop(
    map: &VslamMap,
    found: &Recognition,
    moved: &[KeyframeId],
    corrected: &Poses,
) -> Vec<Relation> {
    let weight = found.matches.len() as f64;
    let ends = found
        .surroundings
        .iter()
        .map(|first| (*first, found.keyframe));
    let others = moved.iter().map(|second| (found.place, *second));
    let pairs: BTreeSet<(KeyframeId, KeyframeId)> = ends.chain(others).collect();
    pairs
        .into_iter()
        .filter(|(first, second)| {
            first != second && map.keyframe(*first).is_some() && !moved.contains(first)
        })
        .filter_map(|(first, second)| {
            Some(Relation {
                first,
                second,
                first_from_second: corrected.get(&first)?.inverse() * *corrected.get(&second)?,
                weight,
            })
        })
        .collect()
}

/// Makes one point of two where both sides see the same thing.
pub(super) fn join_points(
    optics: &Optics,
    map: &mut VslamMap,
    found: &Recognition,
    moved: &[KeyframeId],
) {
    for &(observation_idx, point) in &found.matches {
        let occupant = map
            .keyframe(found.keyframe)
            .and_then(|keyframe| keyframe.observations[observation_idx as usize].point);
        match occupant {
            Some(occupant) => map.merge_points(point, occupant),
            None => map.link(
                point,
                View {
                    keyframe: found.keyframe,
                    observation_idx,
                },
            ),
        }
        map.refresh_point(point);
    }
    let points = map.points_of(&wider(map, &found.surroundings));
    for &id in moved {
        fuse(optics, map, &points, id);
    }
}

/// Brings the seam up to date.
pub(super) fn mend(
    optics: &Optics,
    map: &mut VslamMap,
    found: &Recognition,
    moved: &[KeyframeId],
    workspace: &mut Workspace,
) {
    for &id in moved {
        update_neighbours(map, id);
    }
    adjust_local(map, found.keyframe, workspace);
    let points: Vec<PointId> = map.points_of(&wider(map, &found.surroundings));
    fuse(optics, map, &points, found.keyframe);
    update_neighbours(map, found.keyframe);
    adjust_local(map, found.place, workspace);
}

/// These keyframes and neighbours of theirs.
fn wider(map: &VslamMap, keyframes: &[KeyframeId]) -> Vec<KeyframeId> {
    let mut all = keyframes.to_vec();
    for id in keyframes {
        let neighbours = map.keyframe(*id).map(|one| one.neighbours.as_slice());
        for neighbour in neighbours.unwrap_or_default() {
            if all.len() < SURROUNDINGS_MAX && !all.contains(neighbour) {
                all.push(*neighbour);
            }
        }
    }
    all
}

//! Spreads what a loop says over the keyframes in between.

use std::collections::BTreeMap;

use geometry::{Camera, Map, Matrix7, Similarity};

use crate::map::Moves;
use crate::pose_graph::{PoseEdge, PoseGraph, PoseGraphSettings, PoseNode, optimise};
use crate::{KeyframeId, VslamMap};

/// Edges from each keyframe to those that share most with it.
const NEIGHBOURS_MAX: usize = 5;
/// Such a keyframe shares this many points.
const SHARED_MIN: u32 = 30;
/// What a step from one keyframe to the next counts if they share nothing.
const STEP_WEIGHT: f64 = 5.0;

/// Where keyframes stand, with the scale of what they see.
pub(super) type Poses = BTreeMap<KeyframeId, Similarity<Map, Camera>>;

/// What holds between two keyframes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relation {
    pub(super) first: KeyframeId,
    pub(super) second: KeyframeId,
    pub(super) first_from_second: Similarity<Camera, Camera>,
    /// How many points the two share.
    pub(super) weight: f64,
}

/// All keyframes as they are.
pub(super) fn poses(map: &VslamMap) -> Poses {
    map.keyframes()
        .map(|one| (one.id, one.map_from_camera().into()))
        .collect()
}

/// How keyframes stand to each other by what they share, before anything is corrected: the
/// most covisible ones, the parent, and the one before. `links` are pairs that earlier loops
/// joined.
pub(super) fn relations(
    map: &VslamMap,
    poses: &Poses,
    links: &[(KeyframeId, KeyframeId)],
) -> Vec<Relation> {
    let mut weights: BTreeMap<(KeyframeId, KeyframeId), f64> = BTreeMap::new();
    let mut join = |one: KeyframeId, other: KeyframeId, weight: f64| {
        if one != other {
            let known = weights.entry((one.min(other), one.max(other))).or_default();
            *known = known.max(weight);
        }
    };
    let mut before = None;
    for keyframe in map.keyframes() {
        let id = keyframe.id;
        let near = map.covisible(id);
        for (rank, one) in near.iter().take(NEIGHBOURS_MAX).enumerate() {
            if rank == 0 || one.shared_count >= SHARED_MIN {
                join(id, one.keyframe, f64::from(one.shared_count));
            }
        }
        let parent = keyframe.parent.and_then(|parent| map.holder(parent));
        for other in parent.into_iter().chain(before) {
            join(id, other, STEP_WEIGHT);
        }
        before = Some(id);
    }
    for (one, other) in links {
        if let (Some(one), Some(other)) = (map.holder(*one), map.holder(*other)) {
            join(one, other, f64::from(SHARED_MIN));
        }
    }
    let related = |((first, second), weight): ((KeyframeId, KeyframeId), f64)| {
        Some(Relation {
            first,
            second,
            first_from_second: poses.get(&first)?.inverse() * *poses.get(&second)?,
            weight,
        })
    };
    weights.into_iter().filter_map(related).collect()
}

/// Where the keyframes should go so that all relations fit best; `fixed` stays.
///
/// - `start`: where they are now.
/// - `depth`: the typical distance of what they see, by which turns are made comparable to ways.
pub(super) fn settle(
    start: &Poses,
    relations: &[Relation],
    fixed: KeyframeId,
    depth: f64,
) -> Moves {
    let idx_of: BTreeMap<KeyframeId, usize> = start.keys().copied().zip(0..).collect();
    let mut graph = PoseGraph {
        nodes: start
            .iter()
            .map(|(id, pose)| PoseNode {
                map_from_camera: *pose,
                fixed: *id == fixed,
            })
            .collect(),
        edges: Vec::with_capacity(relations.len()),
    };
    for relation in relations {
        let (Some(first_idx), Some(second_idx)) =
            (idx_of.get(&relation.first), idx_of.get(&relation.second))
        else {
            continue;
        };
        let mut information = Matrix7::identity() * relation.weight;
        for axis in 3..6 {
            information[(axis, axis)] /= depth * depth;
        }
        graph.edges.push(PoseEdge {
            first_idx: *first_idx,
            second_idx: *second_idx,
            first_from_second: relation.first_from_second,
            information,
        });
    }
    optimise(&mut graph, &PoseGraphSettings::default());
    start
        .iter()
        .zip(&graph.nodes)
        .map(|((id, old), node)| (*id, node.map_from_camera * old.inverse()))
        .collect()
}

//! Which point of the one cloud belongs to which of the other.

use geometry::Similarity;
use nalgebra::Vector3;

use crate::alignment::{Source, Target};
use crate::cloud::{ShapedCloud, to_single};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub source_idx: u32,
    pub target_idx: u32,
    /// In the target's unit.
    pub distance_squared: f32,
}

/// The nearest target point of each source point, and with `both_ways` the nearest source point
/// of each target point too, within `gate`.
pub(crate) fn find_pairs(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    gate: f64,
    both_ways: bool,
    pairs: &mut Vec<Pair>,
) {
    pairs.clear();
    let limit = (gate * gate) as f32;
    for (source_idx, point) in source.points.iter().enumerate() {
        let query = to_single(&(*target_from_source * *point));
        if let Some(found) = target.tree.nearest(query, limit) {
            pairs.push(Pair {
                source_idx: source_idx as u32,
                target_idx: found.idx,
                distance_squared: found.distance_squared,
            });
        }
    }
    if !both_ways {
        return;
    }
    let source_from_target = target_from_source.inverse();
    let scale_squared = (target_from_source.scale() * target_from_source.scale()) as f32;
    for (target_idx, point) in target.points.iter().enumerate() {
        let query = to_single(&(source_from_target * *point));
        if let Some(found) = source.tree.nearest(query, limit / scale_squared) {
            pairs.push(Pair {
                source_idx: found.idx,
                target_idx: target_idx as u32,
                distance_squared: found.distance_squared * scale_squared,
            });
        }
    }
}

/// The shares of the source and of the target that have a partner within `distance`; of the
/// target only what lies in the box around the aligned source.
pub(crate) fn overlaps(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    distance: f64,
) -> (f64, f64) {
    let limit = (distance * distance) as f32;
    let scale_squared = (target_from_source.scale() * target_from_source.scale()) as f32;
    let mut lowest = Vector3::repeat(f64::INFINITY);
    let mut highest = Vector3::repeat(f64::NEG_INFINITY);
    let mut source_count = 0_usize;
    for point in &source.points {
        let moved = *target_from_source * *point;
        lowest = lowest.inf(&moved);
        highest = highest.sup(&moved);
        source_count += usize::from(target.tree.nearest(to_single(&moved), limit).is_some());
    }
    let source_from_target = target_from_source.inverse();
    let (mut target_count, mut boxed_count) = (0_usize, 0_usize);
    for point in &target.points {
        if (0..3).any(|axis| point[axis] < lowest[axis] || point[axis] > highest[axis]) {
            continue;
        }
        boxed_count += 1;
        let query = to_single(&(source_from_target * *point));
        target_count += usize::from(source.tree.nearest(query, limit / scale_squared).is_some());
    }
    (
        source_count as f64 / source.points.len().max(1) as f64,
        target_count as f64 / boxed_count.max(1) as f64,
    )
}

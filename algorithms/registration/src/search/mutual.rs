//! Which items of two lists are among each other's nearest.

use super::nearest_few::NearestFew;

/// Each may be the partner of so many others: alike shapes differ by little, and consensus finds
/// the right one among several.
const RANK_COUNT: usize = 4;

/// Pairs that are both among each other's nearest few.
pub(crate) fn mutual<D>(
    source: &[D],
    target: &[D],
    distance: impl Fn(&D, &D) -> f32,
) -> Vec<(usize, usize)> {
    let mut of_source = vec![NearestFew::<f32, RANK_COUNT>::new(f32::INFINITY); source.len()];
    let mut of_target = vec![NearestFew::<f32, RANK_COUNT>::new(f32::INFINITY); target.len()];
    for (source_idx, in_source) in source.iter().enumerate() {
        for (target_idx, in_target) in target.iter().enumerate() {
            let distance = distance(in_source, in_target);
            of_source[source_idx].offer(distance, target_idx as u32);
            of_target[target_idx].offer(distance, source_idx as u32);
        }
    }
    let mut pairs = Vec::new();
    for (source_idx, ranking) in of_source.iter().enumerate() {
        for target_idx in ranking.known() {
            if of_target[target_idx].known().any(|idx| idx == source_idx) {
                pairs.push((source_idx, target_idx));
            }
        }
    }
    pairs
}

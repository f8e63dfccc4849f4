//! Which items of two lists are among each other's nearest.

/// Each may be the partner of so many others: alike shapes differ by little, and consensus finds
/// the right one among several.
const RANK_COUNT: usize = 4;

/// Pairs that are both among each other's nearest few.
pub(crate) fn mutual<D>(
    source: &[D],
    target: &[D],
    distance: impl Fn(&D, &D) -> f32,
) -> Vec<(usize, usize)> {
    let mut of_source = vec![Ranking::default(); source.len()];
    let mut of_target = vec![Ranking::default(); target.len()];
    for (source_idx, in_source) in source.iter().enumerate() {
        for (target_idx, in_target) in target.iter().enumerate() {
            let distance = distance(in_source, in_target);
            of_source[source_idx].offer(target_idx, distance);
            of_target[target_idx].offer(source_idx, distance);
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

/// The nearest so far, nearest first; the first offered wins a tie.
#[derive(Clone, Copy)]
struct Ranking([(f32, u32); RANK_COUNT]);

impl Default for Ranking {
    fn default() -> Self {
        Self([(f32::INFINITY, u32::MAX); RANK_COUNT])
    }
}

impl Ranking {
    fn offer(&mut self, idx: usize, distance: f32) {
        if distance >= self.0[RANK_COUNT - 1].0 {
            return;
        }
        let mut place = RANK_COUNT - 1;
        while place > 0 && self.0[place - 1].0 > distance {
            self.0[place] = self.0[place - 1];
            place -= 1;
        }
        self.0[place] = (distance, idx as u32);
    }

    fn known(&self) -> impl Iterator<Item = usize> {
        let known = self.0.iter().filter(|(_, idx)| *idx != u32::MAX);
        known.map(|(_, idx)| *idx as usize)
    }
}

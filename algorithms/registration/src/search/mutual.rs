//! Which items of two lists are each other's nearest.

/// Pairs that are each other's nearest, and clearly nearer than the second from both sides.
pub(crate) fn mutual<D>(
    source: &[D],
    target: &[D],
    ratio_max: f64,
    distance: impl Fn(&D, &D) -> f64,
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
    let clear = |ranking: &Ranking| ranking.best_distance <= ratio_max * ranking.second_distance;
    let candidates = of_source.iter().enumerate();
    candidates
        .filter(|(_, ranking)| clear(ranking) && ranking.best_idx < target.len())
        .map(|(source_idx, ranking)| (source_idx, ranking.best_idx))
        .filter(|(source_idx, target_idx)| {
            let back = &of_target[*target_idx];
            back.best_idx == *source_idx && clear(back)
        })
        .collect()
}

#[derive(Clone, Copy)]
struct Ranking {
    best_idx: usize,
    best_distance: f64,
    second_distance: f64,
}

impl Default for Ranking {
    fn default() -> Self {
        Self {
            best_idx: usize::MAX,
            best_distance: f64::INFINITY,
            second_distance: f64::INFINITY,
        }
    }
}

impl Ranking {
    fn offer(&mut self, idx: usize, distance: f64) {
        if distance < self.best_distance {
            self.second_distance = self.best_distance;
            (self.best_idx, self.best_distance) = (idx, distance);
        } else {
            self.second_distance = self.second_distance.min(distance);
        }
    }
}

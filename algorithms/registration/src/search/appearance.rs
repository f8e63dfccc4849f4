//! Kinds of descriptors, and which points of two clouds they take for the same.

use features::Descriptor;
use features::matching::DescriptorColumns;
use nalgebra::Vector3;

use super::nearest_few::NearestFew;

/// What a point looks like, so that two clouds can be compared.
pub trait Appearance: Copy {
    /// The nearest must be nearer than this share of the second nearest that is another thing.
    const RATIO_MAX: f64;

    /// How unlike two are, for the ratio test.
    fn distance(&self, other: &Self) -> f64;

    /// Bits for a quick look, of both lists by one rule: the fewer of them differ, the less
    /// unlike the two are likely to be.
    fn sketches(first: &[Self], second: &[Self]) -> [Vec<Descriptor>; 2];
}

/// 256 bits by Hamming distance; they are their own sketch.
impl Appearance for Descriptor {
    const RATIO_MAX: f64 = 0.9;

    fn distance(&self, other: &Self) -> f64 {
        f64::from(Descriptor::distance(self, other))
    }

    fn sketches(first: &[Self], second: &[Self]) -> [Vec<Descriptor>; 2] {
        [first.to_vec(), second.to_vec()]
    }
}

/// Gradient histograms of 128 bytes by Euclidean distance; two bits for each bin say which third
/// of what the bin holds elsewhere it is in.
impl Appearance for [u8; 128] {
    const RATIO_MAX: f64 = 0.85;

    fn distance(&self, other: &Self) -> f64 {
        let pairs = self.iter().zip(other);
        let squares = pairs.map(|(a, b)| {
            let difference = i32::from(*a) - i32::from(*b);
            difference * difference
        });
        f64::from(squares.sum::<i32>()).sqrt()
    }

    fn sketches(first: &[Self], second: &[Self]) -> [Vec<Descriptor>; 2] {
        let thresholds = bin_thirds(second);
        [first, second].map(|list| list.iter().map(|one| sketch(one, &thresholds)).collect())
    }
}

/// Histograms that the thirds are taken from, at most.
const THRESHOLD_SAMPLE_COUNT: usize = 1000;

/// The bounds between the thirds of each bin's values.
fn bin_thirds(histograms: &[[u8; 128]]) -> [[u8; 2]; 128] {
    let step = histograms.len().div_ceil(THRESHOLD_SAMPLE_COUNT).max(1);
    let mut values = Vec::with_capacity(THRESHOLD_SAMPLE_COUNT);
    std::array::from_fn(|bin| {
        values.clear();
        values.extend(histograms.iter().step_by(step).map(|one| one[bin]));
        values.sort_unstable();
        [1, 2].map(|third| values.get(values.len() * third / 3).copied().unwrap_or(0))
    })
}

fn sketch(histogram: &[u8; 128], thresholds: &[[u8; 2]; 128]) -> Descriptor {
    let mut words = [0_u64; 4];
    for (bin, (value, bounds)) in histogram.iter().zip(thresholds).enumerate() {
        for (half, bound) in bounds.iter().enumerate() {
            let bit = 2 * bin + half;
            words[bit / 64] |= u64::from(value > bound) << (bit % 64);
        }
    }
    Descriptor(words)
}

/// One cloud's points and what they look like.
pub(crate) struct Seen<'a, D> {
    pub points: &'a [Vector3<f64>],
    pub descriptors: &'a [D],
    /// Points nearer to each other than this are one thing, twice mapped.
    pub twin_distance: f64,
}

impl<D> Clone for Seen<'_, D> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<D> Copy for Seen<'_, D> {}

/// Sketches that are compared in full.
const CANDIDATE_COUNT: usize = 8;
/// Sketches that are looked at in one go, 32 KB: they stay in the nearest cache.
const BLOCK_SIZE: usize = 1024;

/// Indices into source and target of what is each other's nearest, and clearly nearer than the
/// next other thing from both sides.
///
/// A quick look at all sketches leaves eight candidates for each point; those are compared in
/// full. Cost: source × target sketches.
pub(crate) fn match_mutual<D: Appearance>(
    source: Seen<'_, D>,
    target: Seen<'_, D>,
) -> Vec<(usize, usize)> {
    let [of_source, of_target] = D::sketches(source.descriptors, target.descriptors);
    let there = nearest_in(source.descriptors, &of_source, &of_target, target);
    // Only what was found is looked at from the other side.
    let found: Vec<(usize, usize)> = there
        .iter()
        .enumerate()
        .filter_map(|(source_idx, target_idx)| Some((source_idx, (*target_idx)?)))
        .collect();
    let (queries, sketches): (Vec<D>, Vec<Descriptor>) = found
        .iter()
        .map(|(_, target_idx)| (target.descriptors[*target_idx], of_target[*target_idx]))
        .unzip();
    let back = nearest_in(&queries, &sketches, &of_source, source);
    let pairs = found.into_iter().zip(back);
    pairs
        .filter(|((source_idx, _), back)| *back == Some(*source_idx))
        .map(|(pair, _)| pair)
        .collect()
}

/// For each query the nearest, if it is clearly nearer than the next other thing.
fn nearest_in<D: Appearance>(
    queries: &[D],
    query_sketches: &[Descriptor],
    sketches: &[Descriptor],
    among: Seen<'_, D>,
) -> Vec<Option<usize>> {
    let mut candidates = vec![Candidates::new(u16::MAX); queries.len()];
    let mut distances = Vec::with_capacity(BLOCK_SIZE);
    for (block_idx, block) in sketches.chunks(BLOCK_SIZE).enumerate() {
        let columns = DescriptorColumns::new(block);
        for (sketch, candidates) in query_sketches.iter().zip(&mut candidates) {
            columns.distances(sketch, &mut distances);
            offer_all(candidates, &distances, (block_idx * BLOCK_SIZE) as u32);
        }
    }
    let pairs = queries.iter().zip(&candidates);
    pairs
        .map(|(query, candidates)| clearly_nearest(query, candidates, among))
        .collect()
}

fn clearly_nearest<D: Appearance>(
    query: &D,
    candidates: &Candidates,
    among: Seen<'_, D>,
) -> Option<usize> {
    let full = candidates
        .known()
        .map(|idx| (query.distance(&among.descriptors[idx]), idx));
    let (distance, best) = full.clone().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let is_other = |idx: usize| {
        let apart = among.points[idx] - among.points[best];
        idx != best && apart.norm() > among.twin_distance
    };
    let others = full.filter(|(_, idx)| is_other(*idx));
    let second = others.map(|other| other.0).fold(f64::INFINITY, f64::min);
    (distance < D::RATIO_MAX * second).then_some(best)
}

type Candidates = NearestFew<u16, CANDIDATE_COUNT>;

/// - `first_idx`: of what the first distance belongs to.
fn offer_all(candidates: &mut Candidates, distances: &[u16], first_idx: u32) {
    const LANES: usize = 32;
    for (chunk_idx, chunk) in distances.chunks(LANES).enumerate() {
        // Most have nothing near: one pass without branches says so.
        let nearest = chunk.iter().fold(u16::MAX, |low, one| low.min(*one));
        if nearest >= candidates.limit() {
            continue;
        }
        let chunk_first_idx = first_idx + (chunk_idx * LANES) as u32;
        for (idx, distance) in (chunk_first_idx..).zip(chunk) {
            candidates.offer(*distance, idx);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn histograms(count: usize, rng: &mut impl Rng) -> Vec<[u8; 128]> {
        let byte = |rng: &mut _| (RngExt::random::<f64>(rng).powi(3) * 160.0) as u8;
        (0..count)
            .map(|_| std::array::from_fn(|_| byte(rng)))
            .collect()
    }

    fn places(count: usize) -> Vec<Vector3<f64>> {
        (0..count)
            .map(|idx| Vector3::new(idx as f64, 0.0, 0.0))
            .collect()
    }

    fn seen<'a, D>(points: &'a [Vector3<f64>], descriptors: &'a [D]) -> Seen<'a, D> {
        Seen {
            points,
            descriptors,
            twin_distance: 0.5,
        }
    }

    /// Goal: the quick look loses nothing that is clear. Method: noise on half of a list, against
    /// a comparison of all with all.
    #[test]
    fn noisy_histograms_find_their_own() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let target = histograms(1000, &mut rng);
        let mut source: Vec<[u8; 128]> = target[200..700].to_vec();
        for value in source.iter_mut().flatten() {
            *value = value.saturating_add_signed(rng.random_range(-30..=30));
        }
        let points = places(1000);
        let found = match_mutual(seen(&points[..500], &source), seen(&points, &target));
        let right = found.iter().filter(|(from, to)| from + 200 == *to).count();
        assert!(
            right == found.len() && right > 490,
            "{right} {}",
            found.len()
        );
    }

    #[test]
    fn twins_are_no_rivals_and_things_elsewhere_are() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut target: Vec<Descriptor> = (0..100)
            .map(|_| Descriptor(std::array::from_fn(|_| rng.random())))
            .collect();
        let source = target[..2].to_vec();
        target[50] = source[0];
        target[51] = source[1];
        let mut points = places(100);
        points[50] = points[0] + Vector3::new(0.1, 0.0, 0.0);
        let own = places(2);
        let found = match_mutual(seen(&own, &source), seen(&points, &target));
        assert_eq!(found, [(0, 0)]);
    }

    #[test]
    fn nothing_matches_nothing() {
        let none: [Descriptor; 0] = [];
        let one = [Descriptor([1; 4])];
        let points = places(1);
        assert!(match_mutual(seen(&[], &none), seen(&points, &one)).is_empty());
        assert!(match_mutual(seen(&points, &one), seen(&[], &none)).is_empty());
    }
}

//! All against all, both ways in one pass.

use super::Nearest;
use super::hamming::WordColumns;
use crate::Descriptor;
use crate::simd::{InstructionSet, multiversion};

/// More than any distance.
const NONE: u16 = u16::MAX;

/// The two nearest queries of each train descriptor so far.
#[derive(Default)]
pub(crate) struct Columns {
    best: Vec<u16>,
    second: Vec<u16>,
    query_idx: Vec<u32>,
}

/// The two nearest of a row: distance in the upper half, index in the lower.
#[derive(Clone, Copy)]
pub(crate) struct Row {
    best: u32,
    second: u32,
}

/// Descriptors of the train set that are looked at in one go: their columns stay in the cache,
/// and an index fits in 16 bits.
const BLOCK: usize = 4096;

/// Each query's nearest with that one's nearest query, where they are each other's.
pub(super) fn search(
    instructions: InstructionSet,
    query: &[Descriptor],
    train: &[Descriptor],
) -> impl Iterator<Item = (Nearest, Nearest)> {
    let mut forward: Vec<Option<Nearest>> = vec![None; query.len()];
    let mut backward: Vec<Nearest> = Vec::with_capacity(train.len());
    let mut distances = vec![0; train.len().min(BLOCK)];
    for (block_idx, block) in train.chunks(BLOCK).enumerate() {
        let words = WordColumns::new(block);
        let distances = &mut distances[..block.len()];
        let mut columns = Columns {
            best: vec![NONE; block.len()],
            second: vec![NONE; block.len()],
            query_idx: vec![0; block.len()],
        };
        for (query_idx, one) in query.iter().enumerate() {
            words.distances(instructions, one, distances);
            let mut row = Row {
                best: u32::MAX,
                second: u32::MAX,
            };
            reduce_row(instructions, distances, &mut row);
            update_columns(instructions, distances, query_idx as u32, &mut columns);
            let found = row.nearest((block_idx * BLOCK) as u32);
            forward[query_idx] = Some(match forward[query_idx] {
                Some(before) => before.merge(found),
                None => found,
            });
        }
        backward.extend((0..block.len()).map(|idx| columns.nearest(idx)));
    }
    forward
        .into_iter()
        .enumerate()
        .filter_map(move |(query_idx, forward)| {
            let forward = forward?;
            let back = backward[forward.train_idx as usize];
            (back.train_idx as usize == query_idx).then_some((forward, back))
        })
}

fn distance(key: u16) -> u32 {
    if key == NONE {
        u32::MAX
    } else {
        u32::from(key)
    }
}

impl Row {
    fn nearest(self, first_idx: u32) -> Nearest {
        Nearest {
            train_idx: first_idx + (self.best & 0xffff),
            distance: self.best >> 16,
            second_distance: distance((self.second >> 16) as u16),
        }
    }
}

impl Columns {
    fn nearest(&self, idx: usize) -> Nearest {
        Nearest {
            train_idx: self.query_idx[idx],
            distance: distance(self.best[idx]),
            second_distance: distance(self.second[idx]),
        }
    }
}

impl Nearest {
    /// Of two searches among different descriptors; `self` has the lower indices and wins a tie.
    fn merge(self, other: Self) -> Self {
        let (best, loser) = if other.distance < self.distance {
            (other, self)
        } else {
            (self, other)
        };
        let second_distance = best.second_distance.min(loser.distance);
        Self {
            second_distance,
            ..best
        }
    }
}

multiversion! {
    fn reduce_row(distances: &[u16], row: &mut Row) = reduce_row_body
}

#[inline(always)]
fn reduce_row_body(distances: &[u16], row: &mut Row) {
    const LANES: usize = 16;
    let (mut best, mut second) = ([u32::MAX; LANES], [u32::MAX; LANES]);
    let (chunks, rest) = distances.as_chunks::<LANES>();
    for (chunk_idx, chunk) in chunks.iter().enumerate() {
        let first = (chunk_idx * LANES) as u32;
        for lane in 0..LANES {
            let key = u32::from(chunk[lane]) << 16 | (first + lane as u32);
            second[lane] = second[lane].min(best[lane].max(key));
            best[lane] = best[lane].min(key);
        }
    }
    let mut add = |key: u32| {
        row.second = row.second.min(row.best.max(key));
        row.best = row.best.min(key);
    };
    best.into_iter().chain(second).for_each(&mut add);
    for (idx, distance) in rest.iter().enumerate() {
        add(u32::from(*distance) << 16 | (chunks.len() * LANES + idx) as u32);
    }
}

multiversion! {
    fn update_columns(distances: &[u16], query_idx: u32, columns: &mut Columns)
        = update_columns_body
}

#[inline(always)]
fn update_columns_body(distances: &[u16], query_idx: u32, columns: &mut Columns) {
    let count = distances.len();
    let best = &mut columns.best[..count];
    let second = &mut columns.second[..count];
    let query_indices = &mut columns.query_idx[..count];
    for idx in 0..count {
        let (distance, before) = (distances[idx], best[idx]);
        second[idx] = second[idx].min(before.max(distance));
        best[idx] = before.min(distance);
        query_indices[idx] = if distance < before {
            query_idx
        } else {
            query_indices[idx]
        };
    }
}

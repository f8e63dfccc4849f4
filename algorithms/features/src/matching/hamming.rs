//! Hamming distances, many at a time.

use crate::Descriptor;
use crate::simd::InstructionSet;

/// Descriptors by word: all first words, then all second words, and so on. Neighbours in a word
/// are then neighbours in a vector, and no sum runs across lanes.
#[derive(Clone, Debug, Default)]
pub(crate) struct WordColumns {
    words: [Vec<u64>; 4],
}

impl WordColumns {
    pub(crate) fn new(descriptors: &[Descriptor]) -> Self {
        let column = |word: usize| descriptors.iter().map(|one| one.0[word]).collect();
        Self {
            words: std::array::from_fn(column),
        }
    }

    /// Writes the distance from the query to each descriptor.
    pub(crate) fn distances(
        &self,
        instructions: InstructionSet,
        query: &Descriptor,
        distances: &mut [u16],
    ) {
        let columns = self.words.each_ref().map(Vec::as_slice);
        #[cfg(target_arch = "x86_64")]
        {
            if instructions.has_avx512_popcount() {
                // SAFETY: the instructions were detected.
                return unsafe { distances_avx512(&columns, query, distances) };
            }
            if instructions.has_avx2() {
                // SAFETY: the instructions were detected.
                return unsafe { distances_avx2(&columns, query, distances) };
            }
        }
        let _ = instructions;
        distances_body(&columns, query, distances);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx512vpopcntdq")]
fn distances_avx512(columns: &[&[u64]; 4], query: &Descriptor, distances: &mut [u16]) {
    distances_body(columns, query, distances);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,popcnt")]
fn distances_avx2(columns: &[&[u64]; 4], query: &Descriptor, distances: &mut [u16]) {
    distances_body(columns, query, distances);
}

#[inline(always)]
fn distances_body(columns: &[&[u64]; 4], query: &Descriptor, distances: &mut [u16]) {
    let count = distances.len();
    let [a, b, c, d] = columns.map(|column| &column[..count]);
    let [e, f, g, h] = query.0;
    for idx in 0..count {
        let bits = (a[idx] ^ e).count_ones()
            + (b[idx] ^ f).count_ones()
            + (c[idx] ^ g).count_ones()
            + (d[idx] ^ h).count_ones();
        distances[idx] = bits as u16;
    }
}

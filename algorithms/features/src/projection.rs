//! From a histogram to bits.

use crate::Descriptor;
use crate::histogram::{BIN_COUNT, Histogram};
use crate::simd::InstructionSet;

const BIT_COUNT: usize = Descriptor::BIT_COUNT as usize;
/// Outputs that are summed at once.
const BLOCK: usize = 64;
/// Bins in this unit are whole numbers.
const UNIT: f32 = 4096.0;

/// One hyperplane a bit: `weights · histogram > threshold`.
struct Projection {
    /// By blocks of bits, then pairs of bins, then the bit of the block and the bin of the pair.
    weights: [[[[i8; 2]; BLOCK]; BIN_COUNT / 2]; BIT_COUNT / BLOCK],
    thresholds: [i32; BIT_COUNT],
}

static PROJECTION: Projection = load(include_bytes!("projection.bin"));

const fn load(bytes: &[u8; BIN_COUNT * BIT_COUNT + 4 * BIT_COUNT]) -> Projection {
    let mut projection = Projection {
        weights: [[[[0; 2]; BLOCK]; BIN_COUNT / 2]; BIT_COUNT / BLOCK],
        thresholds: [0; BIT_COUNT],
    };
    let mut idx = 0;
    while idx < BIN_COUNT * BIT_COUNT {
        let (bin, bit) = (idx / BIT_COUNT, idx % BIT_COUNT);
        projection.weights[bit / BLOCK][bin / 2][bit % BLOCK][bin % 2] = bytes[idx] as i8;
        idx += 1;
    }
    let mut bit = 0;
    while bit < BIT_COUNT {
        let at = BIN_COUNT * BIT_COUNT + 4 * bit;
        projection.thresholds[bit] =
            i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        bit += 1;
    }
    projection
}

/// On which side of each hyperplane the histogram lies.
pub(crate) fn binarise(instructions: InstructionSet, histogram: &Histogram) -> Descriptor {
    let mut bins = [[0_i16; 2]; BIN_COUNT / 2];
    for (pair, values) in bins.iter_mut().zip(histogram.as_chunks::<2>().0) {
        *pair = values.map(|value| (value * UNIT + 0.5) as i16);
    }
    #[cfg(target_arch = "x86_64")]
    if instructions.has_avx2() {
        // SAFETY: AVX2 was detected.
        return unsafe { avx2::binarise(&bins) };
    }
    let _ = instructions;
    binarise_portable(&bins)
}

fn binarise_portable(bins: &[[i16; 2]; BIN_COUNT / 2]) -> Descriptor {
    let mut words = [0; 4];
    for (block, word) in words.iter_mut().enumerate() {
        let mut sums = [0_i32; BLOCK];
        for (pair, weights) in bins.iter().zip(&PROJECTION.weights[block]) {
            let [first, second] = pair.map(i32::from);
            for (sum, weights) in sums.iter_mut().zip(weights) {
                *sum += first * i32::from(weights[0]) + second * i32::from(weights[1]);
            }
        }
        let thresholds = &PROJECTION.thresholds[block * BLOCK..][..BLOCK];
        for (bit, (sum, threshold)) in sums.iter().zip(thresholds).enumerate() {
            *word |= u64::from(sum > threshold) << bit;
        }
    }
    Descriptor(words)
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;
    use std::mem::transmute;

    use super::{BIN_COUNT, BLOCK, PROJECTION};
    use crate::Descriptor;

    const LANES: usize = 8;

    // Vectors are copied by value: the load instructions' functions check their pointers in debug
    // builds, which the demo runs in.
    #[target_feature(enable = "avx2")]
    pub(super) fn binarise(bins: &[[i16; 2]; BIN_COUNT / 2]) -> Descriptor {
        let mut words = [0; 4];
        for (block, word) in words.iter_mut().enumerate() {
            let mut sums = [_mm256_setzero_si256(); BLOCK / LANES];
            for (pair, weights) in bins.iter().zip(&PROJECTION.weights[block]) {
                let both = u32::from(pair[0] as u16) | u32::from(pair[1] as u16) << 16;
                let pair = _mm256_set1_epi32(both as i32);
                for (sum, weights) in sums.iter_mut().zip(weights.as_chunks::<LANES>().0) {
                    // SAFETY: any 16 bytes are a vector.
                    let bytes = unsafe { transmute::<[[i8; 2]; LANES], __m128i>(*weights) };
                    let product = _mm256_madd_epi16(_mm256_cvtepi8_epi16(bytes), pair);
                    *sum = _mm256_add_epi32(*sum, product);
                }
            }
            let thresholds = PROJECTION.thresholds[block * BLOCK..]
                .as_chunks::<LANES>()
                .0;
            for (idx, (sum, limits)) in sums.iter().zip(thresholds).enumerate() {
                // SAFETY: any 32 bytes are a vector.
                let limit = unsafe { transmute::<[i32; LANES], __m256i>(*limits) };
                let above = _mm256_castsi256_ps(_mm256_cmpgt_epi32(*sum, limit));
                let bits = _mm256_movemask_ps(above) as u32;
                *word |= u64::from(bits) << (LANES * idx);
            }
        }
        Descriptor(words)
    }
}

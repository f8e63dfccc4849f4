//! Binary descriptors.

/// 256 comparisons of brightness around a keypoint, turned with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Descriptor(pub [u64; 4]);

impl Descriptor {
    pub const BIT_COUNT: u32 = 256;

    /// The number of bits that differ (Hamming), 0 to 256.
    #[inline]
    pub fn distance(&self, other: &Self) -> u32 {
        #[cfg(all(target_arch = "x86_64", not(target_feature = "popcnt")))]
        if is_x86_feature_detected!("popcnt") {
            // SAFETY: the instruction was detected.
            return unsafe { distance_popcnt(&self.0, &other.0) };
        }
        distance_body(&self.0, &other.0)
    }

    /// The words in order, each little-endian: bit `i` is bit `i % 8` of byte `i / 8`.
    pub fn to_bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        for (chunk, word) in bytes.chunks_exact_mut(8).zip(self.0) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// Undoes [`Descriptor::to_bytes`].
    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        let mut words = [0; 4];
        for (word, chunk) in words.iter_mut().zip(bytes.chunks_exact(8)) {
            *word = u64::from_le_bytes(chunk.try_into().expect("chunks of 8 bytes"));
        }
        Self(words)
    }
}

/// The baseline of x86-64 has no instruction that counts bits; nearly every machine has.
#[cfg(all(target_arch = "x86_64", not(target_feature = "popcnt")))]
#[target_feature(enable = "popcnt")]
fn distance_popcnt(first: &[u64; 4], second: &[u64; 4]) -> u32 {
    distance_body(first, second)
}

#[inline(always)]
fn distance_body([a, b, c, d]: &[u64; 4], [e, f, g, h]: &[u64; 4]) -> u32 {
    (a ^ e).count_ones() + (b ^ f).count_ones() + (c ^ g).count_ones() + (d ^ h).count_ones()
}

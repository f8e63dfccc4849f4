//! One source, several instruction sets.
//!
//! A loop over bytes is written once and compiled twice: for the target's baseline and, on x86-64,
//! for AVX2, which is chosen at run time. Both do the same integer arithmetic, so the results are
//! identical; the tests run both.

/// An instruction set that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct InstructionSet(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512Popcount,
}

impl InstructionSet {
    /// Any machine has this one.
    #[cfg(test)]
    pub(crate) const BASELINE: Self = Self(Kind::Baseline);

    /// The fastest of this machine.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt");
            let popcount = is_x86_feature_detected!("avx512vpopcntdq")
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl");
            match (avx2, popcount) {
                (true, true) => return Self(Kind::Avx512Popcount),
                (true, false) => return Self(Kind::Avx2),
                (false, _) => {}
            }
        }
        Self(Kind::Baseline)
    }

    /// All that this machine has.
    #[cfg(test)]
    pub(crate) fn all() -> Vec<Self> {
        let best = Self::detect();
        let mut all = vec![Self::BASELINE];
        #[cfg(target_arch = "x86_64")]
        {
            if best.has_avx2() {
                all.push(Self(Kind::Avx2));
            }
        }
        if !all.contains(&best) {
            all.push(best);
        }
        all
    }

    pub(crate) fn has_avx2(self) -> bool {
        self.0 != Kind::Baseline
    }

    #[cfg(target_arch = "x86_64")]
    pub(crate) fn has_avx512_popcount(self) -> bool {
        self.0 == Kind::Avx512Popcount
    }
}

/// Declares `fn name(instructions, ...)`, which runs the inline function `body` compiled for the
/// given instruction set.
macro_rules! multiversion {
    ($(#[$doc:meta])* fn $name:ident($($argument:ident: $type:ty),* $(,)?) = $body:path) => {
        $(#[$doc])*
        pub(crate) fn $name(
            instructions: $crate::simd::InstructionSet,
            $($argument: $type),*
        ) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2($($argument: $type),*) {
                    $body($($argument),*);
                }
                if instructions.has_avx2() {
                    // SAFETY: `InstructionSet` only says AVX2 where it was detected.
                    return unsafe { avx2($($argument),*) };
                }
            }
            let _ = instructions;
            $body($($argument),*);
        }
    };
}
pub(crate) use multiversion;

/// Bytes that the loops of this crate take at once.
pub(crate) const BLOCK: usize = 32;

/// Starts of blocks of [`BLOCK`] that cover `0..count`, the last overlapping the one before, so
/// that no remainder is left for slow code; none if the range is shorter than a block.
#[inline(always)]
pub(crate) fn block_starts(count: usize) -> impl Iterator<Item = usize> {
    let last = count.checked_sub(BLOCK);
    let block_count = if last.is_some() {
        count.div_ceil(BLOCK)
    } else {
        0
    };
    (0..block_count).map(move |idx| (idx * BLOCK).min(last.unwrap_or(0)))
}

/// The block that starts here.
#[inline(always)]
pub(crate) fn block_at(row: &[u8], start: usize) -> [u8; BLOCK] {
    *row[start..]
        .first_chunk()
        .expect("blocks end inside the range they cover")
}

//! A set of chunk numbers, small because the numbers come in runs.

use std::collections::BTreeMap;

use crate::ChunkNumber;

/// A set of chunk numbers as disjoint runs.
///
/// Memory grows with the number of runs, not of numbers. Nothing in here takes longer than
/// linear in the runs, so that ranges off the wire cannot keep a vehicle busy.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ranges {
    /// First number of a run → its last. Runs neither touch nor overlap.
    runs: BTreeMap<u32, u32>,
}

impl Ranges {
    /// The empty set.
    pub fn new() -> Self {
        Self::default()
    }

    /// The numbers from `first` to `last`, both included; empty if turned around.
    pub fn run(first: ChunkNumber, last: ChunkNumber) -> Self {
        let mut ranges = Self::new();
        ranges.insert_run(first, last);
        ranges
    }

    /// Adds a number; whether it was new.
    pub fn insert(&mut self, number: ChunkNumber) -> bool {
        if self.contains(number) {
            return false;
        }
        self.insert_run(number, number);
        true
    }

    /// Adds the numbers from `first` to `last`, both included.
    pub fn insert_run(&mut self, first: ChunkNumber, last: ChunkNumber) {
        let (mut first, mut last) = (first.0, last.0);
        if first > last {
            return;
        }
        if let Some((&start, &end)) = self.runs.range(..=first).next_back()
            && end >= first.saturating_sub(1)
        {
            first = start;
            last = last.max(end);
        }
        let reach = last.saturating_add(1);
        let swallowed: Vec<u32> = self.runs.range(first..=reach).map(|(&s, _)| s).collect();
        for start in swallowed {
            let end = self.runs.remove(&start).unwrap_or(last);
            last = last.max(end);
        }
        self.runs.insert(first, last);
    }

    /// Takes a number out; whether it was there.
    pub fn remove(&mut self, number: ChunkNumber) -> bool {
        let number = number.0;
        let Some((&start, &end)) = self.runs.range(..=number).next_back() else {
            return false;
        };
        if end < number {
            return false;
        }
        self.runs.remove(&start);
        if start < number {
            self.runs.insert(start, number - 1);
        }
        if number < end {
            self.runs.insert(number + 1, end);
        }
        true
    }

    /// Adds all of `other`.
    pub fn unite(&mut self, other: &Self) {
        for (first, last) in other.runs() {
            self.insert_run(first, last);
        }
    }

    /// The numbers of this set that are not in `other`.
    pub fn without(&self, other: &Self) -> Self {
        let mut rest = Self::new();
        for (&first, &last) in &self.runs {
            let mut next = Some(first);
            let before = other.runs.range(..first).next_back();
            let inside = other.runs.range(first..=last);
            for (&start, &end) in before.into_iter().chain(inside) {
                let Some(from) = next else { break };
                if start > from {
                    rest.runs.insert(from, start - 1);
                }
                if end >= from {
                    next = end.checked_add(1);
                }
            }
            if let Some(from) = next.filter(|from| *from <= last) {
                rest.runs.insert(from, last);
            }
        }
        rest
    }

    /// Whether the number is in the set.
    pub fn contains(&self, number: ChunkNumber) -> bool {
        let run = self.runs.range(..=number.0).next_back();
        run.is_some_and(|(_, &end)| end >= number.0)
    }

    /// How many numbers there are.
    pub fn count(&self) -> u64 {
        let length = |(&first, &last): (&u32, &u32)| u64::from(last - first) + 1;
        self.runs.iter().map(length).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// The highest number.
    pub fn highest(&self) -> Option<ChunkNumber> {
        self.runs.last_key_value().map(|(_, &end)| ChunkNumber(end))
    }

    /// The runs `(first, last)`, both included, in ascending order.
    pub fn runs(&self) -> impl DoubleEndedIterator<Item = (ChunkNumber, ChunkNumber)> + '_ {
        let pair = |(&first, &last): (&u32, &u32)| (ChunkNumber(first), ChunkNumber(last));
        self.runs.iter().map(pair)
    }

    /// How many runs there are: what the set costs in memory and on the wire.
    pub fn run_count(&self) -> usize {
        self.runs.len()
    }

    /// The numbers from the highest down.
    pub fn newest_first(&self) -> impl Iterator<Item = ChunkNumber> + '_ {
        self.runs()
            .rev()
            .flat_map(|(first, last)| (first.0..=last.0).rev().map(ChunkNumber))
    }

    /// Forgets the oldest runs until at most `run_count_max` are left.
    pub fn truncate_runs(&mut self, run_count_max: usize) {
        while self.runs.len() > run_count_max {
            self.runs.pop_first();
        }
    }

    /// A 64-bit digest: equal for equal sets, different for different ones but for chance.
    ///
    /// It guards against accidents, not against an adversary, who can lie about it anyway.
    pub fn digest(&self) -> u64 {
        self.runs.iter().fold(0, |digest, (&first, &last)| {
            mix(digest ^ mix(u64::from(first) << 32 | u64::from(last)))
        })
    }
}

impl FromIterator<ChunkNumber> for Ranges {
    fn from_iter<I: IntoIterator<Item = ChunkNumber>>(numbers: I) -> Self {
        let mut ranges = Self::new();
        for number in numbers {
            ranges.insert(number);
        }
        ranges
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014), offset so that zero moves.
pub(crate) fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests;

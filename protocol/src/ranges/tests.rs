//! The set against the standard library's.

use std::collections::BTreeSet;

use proptest::prelude::*;

use super::Ranges;
use crate::ChunkNumber;

fn numbers() -> impl Strategy<Value = Vec<u32>> {
    let number = prop_oneof![0..60_u32, (u32::MAX - 20)..=u32::MAX];
    prop::collection::vec(number, 0..80)
}

fn ranges(numbers: &[u32]) -> Ranges {
    numbers.iter().map(|number| ChunkNumber(*number)).collect()
}

fn listed(ranges: &Ranges) -> Vec<u32> {
    ranges
        .runs()
        .flat_map(|(first, last)| first.0..=last.0)
        .collect()
}

proptest! {
    #[test]
    fn behaves_as_a_set(a in numbers(), removed in numbers(), b in numbers()) {
        let mut set: BTreeSet<u32> = a.iter().copied().collect();
        let mut ours = ranges(&a);
        for number in &removed {
            prop_assert_eq!(ours.remove(ChunkNumber(*number)), set.remove(number));
        }
        prop_assert_eq!(listed(&ours), set.iter().copied().collect::<Vec<_>>());
        prop_assert_eq!(ours.count(), set.len() as u64);
        prop_assert_eq!(ours.highest().map(|n| n.0), set.last().copied());
        let descending: Vec<u32> = ours.newest_first().map(|n| n.0).collect();
        prop_assert_eq!(descending, set.iter().rev().copied().collect::<Vec<_>>());

        let other: BTreeSet<u32> = b.iter().copied().collect();
        let theirs = ranges(&b);
        let difference: Vec<u32> = other.difference(&set).copied().collect();
        prop_assert_eq!(listed(&theirs.without(&ours)), difference);
        let mut union = ours.clone();
        union.unite(&theirs);
        prop_assert_eq!(listed(&union), set.union(&other).copied().collect::<Vec<_>>());
        for number in 0..70 {
            prop_assert_eq!(ours.contains(ChunkNumber(number)), set.contains(&number));
        }
    }

    #[test]
    fn runs_neither_touch_nor_overlap_and_the_digest_is_of_the_set(
        a in numbers(),
        first in 0..50_u32,
        length in 0..30_u32,
    ) {
        let mut ours = ranges(&a);
        ours.insert_run(ChunkNumber(first), ChunkNumber(first + length));
        let runs: Vec<_> = ours.runs().collect();
        prop_assert!(runs.windows(2).all(|pair| pair[0].1.0 + 1 < pair[1].0.0));
        let rebuilt = ranges(&listed(&ours));
        prop_assert_eq!(rebuilt.digest(), ours.digest());
        prop_assert_eq!(&rebuilt, &ours);
        let mut changed = ours.clone();
        changed.remove(ChunkNumber(first));
        prop_assert_ne!(changed.digest(), ours.digest());
    }
}

#[test]
fn keeps_its_newest_runs_when_truncated() {
    let mut ours = ranges(&[1, 3, 5, 7]);
    ours.truncate_runs(2);
    assert_eq!(listed(&ours), [5, 7]);
}

#[test]
fn a_run_of_all_numbers_costs_nothing() {
    let all = Ranges::run(ChunkNumber(0), ChunkNumber(u32::MAX));
    assert_eq!((all.count(), all.run_count()), (1 << 32, 1));
    assert!(all.without(&all).is_empty());
    assert_ne!(all.digest(), 0);
    assert_eq!(Ranges::new().digest(), 0);
}

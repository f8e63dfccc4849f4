use proptest::prelude::*;

use super::*;

fn descriptors(count: usize) -> impl Strategy<Value = Vec<Descriptor>> {
    // Few distinct words, so that ties and duplicates are common.
    let word = prop_oneof![Just(0), Just(u64::MAX), Just(0xff00), any::<u64>()];
    prop::collection::vec(prop::array::uniform4(word).prop_map(Descriptor), 0..count)
}

/// Two loops, as in the definition.
fn nearest_by_sort(query: &Descriptor, train: &[Descriptor]) -> Option<Nearest> {
    let mut order: Vec<(u32, u32)> = (0..train.len())
        .map(|idx| (query.distance(&train[idx]), idx as u32))
        .collect();
    order.sort_unstable();
    let &(distance, train_idx) = order.first()?;
    Some(Nearest {
        train_idx,
        distance,
        second_distance: order.get(1).map_or(u32::MAX, |second| second.0),
    })
}

proptest! {
    #[test]
    fn nearest_is_the_first_in_order(train in descriptors(40), query in descriptors(3)) {
        for one in &query {
            prop_assert_eq!(nearest(one, &train), nearest_by_sort(one, &train));
        }
    }

    #[test]
    fn mutual_matches_follow_the_definition(
        query in descriptors(45),
        train in descriptors(45),
        ratio_max in 0.5_f32..1.0,
    ) {
        let settings = MatchSettings { distance_max: 100, ratio_max };
        let expected: Vec<Match> = query.iter().enumerate().filter_map(|(query_idx, one)| {
            let forward = nearest_by_sort(one, &train)?;
            let backward = nearest_by_sort(&train[forward.train_idx as usize], &query)?;
            let mutual = backward.train_idx as usize == query_idx;
            (mutual && forward.passes(&settings) && backward.passes(&settings)).then_some(Match {
                query_idx: query_idx as u32,
                train_idx: forward.train_idx,
                distance: forward.distance,
            })
        }).collect();
        prop_assert_eq!(match_mutual(&query, &train, &settings), expected);
    }

    #[test]
    fn all_instruction_sets_agree(query in descriptors(20), train in descriptors(200)) {
        let found = |instructions| mutual::search(instructions, &query, &train).collect::<Vec<_>>();
        let expected = found(InstructionSet::BASELINE);
        for instructions in InstructionSet::all() {
            prop_assert_eq!(&found(instructions), &expected);
        }
    }

    #[test]
    fn columns_give_each_distance(query in descriptors(3), train in descriptors(40)) {
        let columns = DescriptorColumns::new(&train);
        let mut found = vec![1; 50];
        for one in &query {
            columns.distances(one, &mut found);
            let expected = train.iter().map(|other| one.distance(other) as u16);
            prop_assert_eq!(&found, &expected.collect::<Vec<_>>());
        }
    }

    #[test]
    fn bytes_keep_the_bits(words in any::<[u64; 4]>()) {
        let descriptor = Descriptor(words);
        let bytes = descriptor.to_bytes();
        prop_assert_eq!(Descriptor::from_bytes(bytes), descriptor);
        let ones: u32 = bytes.iter().map(|byte| byte.count_ones()).sum();
        prop_assert_eq!(descriptor.distance(&Descriptor::default()), ones);
    }
}

#[test]
fn large_sets_are_searched_in_blocks() {
    // Goal: indices beyond a block of 4096 survive. Each query is its train twin with one bit off.
    let mut state = 1_u64;
    let mut word = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        state ^ (state >> 29)
    };
    let train: Vec<Descriptor> = (0..9000)
        .map(|_| Descriptor(std::array::from_fn(|_| word())))
        .collect();
    let twins = [8999, 0, 4095, 4096, 8192];
    let query = twins.map(|idx| {
        let mut one = train[idx];
        one.0[2] ^= 1 << 17;
        one
    });
    let matches = match_mutual(&query, &train, &MatchSettings::default());
    let expected: Vec<Match> = (0..)
        .zip(twins)
        .map(|(query_idx, twin)| Match {
            query_idx,
            train_idx: twin as u32,
            distance: 1,
        })
        .collect();
    assert_eq!(matches, expected);
}

#[test]
fn candidates_outside_the_set_are_passed_over() {
    let train = [
        Descriptor([0; 4]),
        Descriptor([1, 0, 0, 0]),
        Descriptor([3, 0, 0, 0]),
    ];
    let query = Descriptor([3, 0, 0, 0]);
    let found = nearest_of(&query, &train, [0, 7, 1]).unwrap();
    assert_eq!(
        (found.train_idx, found.distance, found.second_distance),
        (1, 1, 2)
    );
    assert_eq!(nearest_of(&query, &train, [9]), None);
    assert_eq!(nearest_of(&query, &train, []), None);
}

#[test]
fn odd_turns_are_dropped() {
    let keypoint = |angle_rad: f32| Keypoint {
        position_px: nalgebra::Vector2::zeros(),
        level: 0,
        angle_rad,
        response: 0.0,
    };
    // Ten keypoints turn by 3 rad (over the wrap), one by 1 rad less, one is not there.
    let query: Vec<Keypoint> = (0..11)
        .map(|idx| keypoint(idx as f32 * 0.5 - 3.0))
        .collect();
    let mut train: Vec<Keypoint> = query
        .iter()
        .map(|one| keypoint(one.angle_rad + 3.0))
        .collect();
    train[4].angle_rad -= 1.0;
    let one = |idx: u32| Match {
        query_idx: idx,
        train_idx: idx,
        distance: 0,
    };
    let mut matches: Vec<Match> = (0..12).map(one).collect();
    // One of ten is a tenth of the strongest bin and stays; make the bin stronger.
    matches.extend((0..10).filter(|idx| *idx != 4).map(one));
    keep_consistent_turns(&mut matches, &query, &train);
    assert!(
        matches
            .iter()
            .all(|one| one.query_idx != 4 && one.query_idx != 11)
    );
    assert_eq!(matches.len(), 19);
}

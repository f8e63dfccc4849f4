//! Components of runs against a flood fill.

use proptest::prelude::*;

use crate::markers::runs::{RunJoiner, TooManyRuns, bright_runs};

const WIDTH: usize = 17;
const HEIGHT: usize = 13;

/// Area and bounding box of each 8-connected component, in the order of its first pixel.
fn flood(mask: &[u8]) -> Vec<(u32, [usize; 4])> {
    let mut rest = mask.to_vec();
    let mut components = Vec::new();
    for start in 0..rest.len() {
        if rest[start] == 0 {
            continue;
        }
        let mut open = vec![start];
        rest[start] = 0;
        let (mut area, mut bounds) = (0, [WIDTH, HEIGHT, 0, 0]);
        while let Some(idx) = open.pop() {
            let (x, y) = (idx % WIDTH, idx / WIDTH);
            area += 1;
            bounds[0] = bounds[0].min(x);
            bounds[1] = bounds[1].min(y);
            bounds[2] = bounds[2].max(x);
            bounds[3] = bounds[3].max(y);
            for near_y in y.saturating_sub(1)..=(y + 1).min(HEIGHT - 1) {
                for near_x in x.saturating_sub(1)..=(x + 1).min(WIDTH - 1) {
                    let near = near_y * WIDTH + near_x;
                    if std::mem::take(&mut rest[near]) != 0 {
                        open.push(near);
                    }
                }
            }
        }
        components.push((area, bounds));
    }
    components
}

fn join(mask: &[u8], joiner: &mut RunJoiner) -> Result<(), TooManyRuns> {
    joiner.clear();
    for y in 0..HEIGHT {
        for run in bright_runs(&mask[y * WIDTH..(y + 1) * WIDTH], y, 1) {
            joiner.push(run)?;
        }
    }
    Ok(())
}

proptest! {
    #[test]
    fn runs_join_to_the_components_of_a_flood_fill(
        mask in proptest::collection::vec(
            prop_oneof![3 => Just(0_u8), 2 => Just(1)],
            WIDTH * HEIGHT,
        ),
    ) {
        let mut joiner = RunJoiner::with_run_count_max(1024);
        join(&mask, &mut joiner).unwrap();
        let mut joined: Vec<(u32, [usize; 4])> = joiner
            .components()
            .iter()
            .map(|c| (c.area_px, [c.left, c.top, c.right, c.bottom].map(usize::from)))
            .collect();
        let mut expected = flood(&mask);
        joined.sort_unstable();
        expected.sort_unstable();
        prop_assert_eq!(joined, expected);
    }
}

#[test]
fn more_runs_than_there_is_room_for_are_refused() {
    let checkers: Vec<u8> = (0..WIDTH * HEIGHT).map(|idx| (idx % 2) as u8).collect();
    let mut joiner = RunJoiner::with_run_count_max(20);
    assert_eq!(join(&checkers, &mut joiner), Err(TooManyRuns));
    let mut joiner = RunJoiner::with_run_count_max(200);
    assert_eq!(join(&checkers, &mut joiner), Ok(()));
    assert_eq!(joiner.components().len(), 1);
}

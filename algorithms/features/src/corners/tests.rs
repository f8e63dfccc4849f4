use proptest::prelude::*;

use super::*;

const RING: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

fn pixel(plane: &Plane, x: usize, y: usize) -> i32 {
    i32::from(plane.row(y)[x])
}

/// The largest threshold that the segment test passes: over all arcs, the least contrast in it.
fn score_by_definition(plane: &Plane, x: usize, y: usize) -> u8 {
    let centre = pixel(plane, x, y);
    let ring = RING.map(|(dx, dy)| {
        pixel(plane, x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)) - centre
    });
    let arc = |start: usize, sign: i32| (0..9).map(move |idx| sign * ring[(start + idx) % 16]);
    (0..16)
        .flat_map(|start| [arc(start, 1), arc(start, -1)])
        .map(|arc| arc.min().expect("an arc has nine pixels"))
        .max()
        .map_or(0, |score| score.max(0) as u8)
}

fn corners_by_definition(plane: &Plane, margin_px: usize, threshold: u8) -> Vec<(u16, u16, u8)> {
    let mut corners = Vec::new();
    for y in margin_px..plane.height() - margin_px {
        for x in margin_px..plane.width() - margin_px {
            let score = score_by_definition(plane, x, y);
            let around = [
                (0, -1),
                (1, -1),
                (2, -1),
                (0, 0),
                (2, 0),
                (0, 1),
                (1, 1),
                (2, 1),
            ];
            let highest = around.iter().enumerate().all(|(idx, &(dx, dy))| {
                let y = y.wrapping_add_signed(dy);
                let other = score_by_definition(plane, x + dx - 1, y);
                if idx < 4 {
                    score > other
                } else {
                    score >= other
                }
            });
            if score > threshold && highest {
                corners.push((x as u16, y as u16, score));
            }
        }
    }
    corners
}

fn plane(width: usize, height: usize, pixels: &[u8]) -> Plane {
    let mut plane = Plane::default();
    plane.resize(width, height, width + 3);
    for y in 0..height {
        plane
            .row_mut(y)
            .copy_from_slice(&pixels[y * width..][..width]);
    }
    plane
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn finds_what_the_definition_says(
        width in 11_usize..60,
        height in 11_usize..20,
        coarseness in 1_usize..6,
        seed in any::<u64>(),
        threshold in 0_u8..60,
    ) {
        // Blocks of few grey values: arcs, plateaus and ties are then common.
        let pixels: Vec<u8> = (0..width * height).map(|idx| {
            let (x, y) = (idx % width / coarseness, idx / width / coarseness);
            let hash = (x as u64 * 0x9e37_79b9 + y as u64 * 0x85eb_ca6b + seed)
                .wrapping_mul(0xd6e8_feb8_6659_fd93);
            (hash >> 60) as u8 * 17
        }).collect();
        let plane = plane(width, height, &pixels);
        let expected = corners_by_definition(&plane, 5, threshold);
        for instructions in InstructionSet::all() {
            let mut corners = Vec::new();
            CornerFinder::default().find(instructions, &plane, 5, threshold, &mut corners);
            let found: Vec<_> =
                corners.iter().map(|one| (one.x, one.y, one.score())).collect();
            prop_assert_eq!(&found, &expected);
            for corner in &corners {
                for (v, row) in corner.scores.iter().enumerate() {
                    for (u, score) in row.iter().enumerate() {
                        let (x, y) = (usize::from(corner.x) + u - 2, usize::from(corner.y) + v - 2);
                        prop_assert_eq!(*score, score_by_definition(&plane, x, y));
                    }
                }
            }
        }
    }
}

#[test]
fn the_top_of_a_paraboloid_is_found() {
    for (x, y) in [(0.0, 0.0), (0.4, -0.3), (-0.49, 0.5)] {
        let scores = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let (u, v) = (column as f64 - 2.0 - x, row as f64 - 2.0 - y);
                (220.0 - 12.0 * u * u - 9.0 * v * v - 5.0 * u * v).round() as u8
            })
        });
        let shift_px = Corner { x: 9, y: 9, scores }.shift_px();
        // Rounding to whole scores moves the top by about 0.3 / (2 × 9) px.
        assert!(
            (shift_px - Vector2::new(x, y)).norm() < 0.03,
            "{shift_px} {x} {y}"
        );
    }
    let flat = Corner {
        x: 9,
        y: 9,
        scores: [[30; 5]; 5],
    };
    assert_eq!(flat.shift_px(), Vector2::zeros());
}

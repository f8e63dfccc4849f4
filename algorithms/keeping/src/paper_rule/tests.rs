use proptest::prelude::*;

use super::*;

/// Everybody's velocity; all head along x.
fn velocities(rule: &PaperRule, positions: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    positions
        .iter()
        .map(|own| {
            let others = positions.iter().filter(|other| *other != own);
            rule.correction(others.map(|other| {
                let offset = other - own;
                Placed {
                    direction: offset.normalize(),
                    range_m: offset.norm(),
                }
            }))
        })
        .collect()
}

fn unlimited() -> PaperRule {
    PaperRule::new(PaperRuleSettings {
        visible_m: f64::INFINITY,
        ..PaperRuleSettings::default()
    })
}

struct Reference {
    start: [[f64; 3]; 3],
    last: [[f64; 3]; 3],
    first_velocities: [[f64; 3]; 3],
}

/// R1 to R3: 60 s in steps of 0.1 s from the start, heading and nominal velocity zero.
const REFERENCES: [Reference; 3] = [
    Reference {
        start: [[0.0, 0.0, 0.0], [1.0, 4.0, 0.5], [-3.0, -3.5, -1.0]],
        last: [
            [-0.2954, -0.5513, -1.3627],
            [-0.9548, 1.3639, 0.6607],
            [-2.03, -1.6009, 0.6712],
        ],
        first_velocities: [
            [-0.04924, 0.01792, 0.0],
            [-0.04924, -0.13529, -0.12856],
            [0.04924, 0.05868, 0.06428],
        ],
    },
    Reference {
        start: [[0.0, 0.0, 0.0], [5.0, 0.5, 0.2], [-1.0, 2.0, 1.0]],
        last: [
            [1.0593, -0.4246, 0.0129],
            [5.0, 0.5, 0.2],
            [1.3802, 2.4246, 0.1965],
        ],
        first_velocities: [
            [0.12584, -0.05868, 0.0],
            [0.0, 0.0, 0.0],
            [0.02736, 0.05868, 0.0],
        ],
    },
    Reference {
        start: [[0.0, 0.0, 0.0], [-4.0, 0.2, 0.5], [-2.5, -3.0, -0.5]],
        last: [
            [-0.2364, -0.2817, -0.1671],
            [-3.8971, 0.0592, 0.3586],
            [-2.3818, -2.5775, -0.1786],
        ],
        first_velocities: [
            [-0.04924, -0.05868, -0.06428],
            [0.04924, -0.05868, -0.06428],
            [0.0, 0.11736, 0.12856],
        ],
    },
];

fn assert_near(found: &[Vector3<f64>], expected: &[[f64; 3]; 3], tolerance: f64) {
    for (found, expected) in found.iter().zip(expected) {
        let error = (found - Vector3::from(*expected)).amax();
        assert!(error <= tolerance, "{found:?} instead of {expected:?}");
    }
}

/// The references are printed to 1e-4 m and 1e-5 m/s; the other half of the tolerance is rounding.
#[test]
fn well_conditioned_references_are_met() {
    let rule = unlimited();
    for reference in &REFERENCES {
        let mut positions = reference.start.map(Vector3::from);
        let first = velocities(&rule, &positions);
        assert_near(&first, &reference.first_velocities, 1e-5);
        for _ in 0..600 {
            let step = velocities(&rule, &positions);
            for (position, velocity) in positions.iter_mut().zip(&step) {
                *position += velocity * 0.1;
            }
        }
        assert_near(&positions, &reference.last, 1e-4);
    }
}

/// R4 and R5 start on the border between upper and lower sectors; they pin which side has it.
#[test]
fn level_neighbours_belong_to_the_upper_sectors() {
    let rule = unlimited();
    let starts = [
        [[0.0, 0.0, 0.0], [0.0, 1.2, 0.0], [0.0, -1.5, 0.0]],
        [[0.0, 0.0, 0.0], [0.2, 0.1, 2.0], [0.0, 3.0, 0.0]],
    ];
    let expected = [
        [
            [0.0, 0.0, -0.12856],
            [0.0, 0.0766, -0.06428],
            [0.0, -0.0766, -0.06428],
        ],
        [[0.0, 0.0, 0.0], [0.0, 0.0766, -0.06428], [0.0, 0.0, 0.0]],
    ];
    for (start, expected) in starts.iter().zip(&expected) {
        assert_near(
            &velocities(&rule, &start.map(Vector3::from)),
            expected,
            1e-5,
        );
    }
}

proptest! {
    /// Fourteen sectors, eight axes: no more than that many corrections add up.
    #[test]
    fn corrections_are_bounded_and_ignore_the_order(
        raw in proptest::collection::vec(
            (-6.0_f64..6.0, -6.0_f64..6.0, -6.0_f64..6.0), 0..20),
    ) {
        let rule = PaperRule::new(PaperRuleSettings::default());
        let placed: Vec<Placed> = raw
            .iter()
            .map(|(x, y, z)| Vector3::new(*x, *y, *z))
            .filter(|offset| offset.norm() > 0.1)
            .map(|offset| Placed { direction: offset.normalize(), range_m: offset.norm() })
            .collect();
        let forward = rule.correction(placed.iter().copied());
        let backward = rule.correction(placed.iter().rev().copied());
        prop_assert_eq!(forward, backward);
        prop_assert!(forward.norm() <= 0.8 + 1e-12);
    }
}

//! Goal: an alignment allocates for its clouds, not for its iterations.
//! Method: a counting allocator; few iterations against many.

#[path = "../../test_support/counting_allocator.rs"]
mod counting_allocator;

use geometry::Similarity;
use nalgebra::{UnitQuaternion, Vector3};
use registration::{Cloud, Metric, Outcome, RegisterSettings, ShapedCloud, Start, align};

use counting_allocator::allocation_count;

/// Three walls of a corner with a step, in rows that do not repeat.
fn corner(count: usize) -> Vec<Vector3<f64>> {
    let share = |idx: usize, factor: f64| (idx as f64 * factor).fract();
    (0..count)
        .map(|idx| {
            let (a, b) = (3.0 * share(idx, 0.618_034), 2.0 * share(idx, 0.414_214));
            match idx % 4 {
                0 => Vector3::new(a, b, 0.0),
                1 => Vector3::new(a, 0.0, b),
                2 => Vector3::new(0.0, a, b),
                _ => Vector3::new(1.5 + 0.3 * a, 0.5 + 0.2 * b, 0.4),
            }
        })
        .collect()
}

#[test]
fn iterations_cost_no_allocation() {
    let source = ShapedCloud::new(&Cloud::from_points(corner(1300)), None);
    let shift = Vector3::new(0.013, -0.021, 0.017);
    let target = corner(2000).into_iter().map(|point| point + shift);
    let target = ShapedCloud::new(&Cloud::from_points(target.collect()), None);
    for metric in [Metric::Point, Metric::Plane, Metric::Gicp] {
        for with_scale in [false, true] {
            // From near and from far the same end is reached, by more iterations.
            let costs = [0.0, 0.12].map(|angle_rad| {
                let turn =
                    UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -0.5, 0.5) * angle_rad);
                let settings = RegisterSettings {
                    metric,
                    with_scale,
                    start: Start::Given(Similarity::new(1.0, turn, Vector3::zeros())),
                    ..RegisterSettings::default()
                };
                let before = allocation_count();
                let outcome = align(&source, &target, &settings);
                let allocation_count = self::allocation_count() - before;
                let Outcome::Accepted(alignment) = outcome else {
                    panic!("{metric:?}, scale {with_scale}: {outcome:?}");
                };
                (alignment.quality.iteration_count, allocation_count)
            });
            let [(few, first), (many, second)] = costs;
            assert!(
                many > few,
                "{metric:?}, scale {with_scale}: {few} and {many}"
            );
            assert_eq!(first, second, "{metric:?}, scale {with_scale}");
        }
    }
}

//! Metamorphic tests on generated clouds, and refusals.

use geometry::Similarity;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::Metric;

const NOISE_M: f64 = 0.005;

/// Points of a room's corner of 3 m with a box and a ball in it, drawn anew by each generator.
fn corner(point_count: usize, rng: &mut impl Rng) -> Vec<Vector3<f64>> {
    (0..point_count)
        .map(|_| {
            let (a, b) = (rng.random::<f64>(), rng.random::<f64>());
            let point = match rng.random_range(0..10) {
                0..3 => Vector3::new(3.0 * a, 3.0 * b, 0.0),
                3..5 => Vector3::new(3.0 * a, 0.0, 2.0 * b),
                5..7 => Vector3::new(0.0, 3.0 * a, 2.0 * b),
                7 => Vector3::new(1.0 + 0.8 * a, 1.5, 0.7 * b),
                8 => Vector3::new(1.8, 1.5 + 0.6 * a, 0.7 * b),
                _ => {
                    let (longitude, height) = (std::f64::consts::TAU * a, 2.0 * b - 1.0);
                    let ring = (1.0 - height * height).sqrt();
                    let direction =
                        Vector3::new(ring * longitude.cos(), ring * longitude.sin(), height);
                    Vector3::new(2.2, 0.8, 1.2) + direction * 0.4
                }
            };
            let mut noise = || NOISE_M * 1.7 * (2.0 * rng.random::<f64>() - 1.0);
            point + Vector3::new(noise(), noise(), noise())
        })
        .collect()
}

fn moved(points: &[Vector3<f64>], by: &Similarity<Target, Source>) -> Cloud {
    let inverse = by.inverse();
    Cloud::from_points(points.iter().map(|point| inverse * *point).collect())
}

fn truth(angle_rad: f64, distance_m: f64, scale: f64) -> Similarity<Target, Source> {
    let axis = Vector3::new(0.4, -0.5, 0.75).normalize();
    let rotation = UnitQuaternion::from_scaled_axis(axis * angle_rad);
    Similarity::new(scale, rotation, Vector3::new(0.6, 0.0, -0.8) * distance_m)
}

/// Source and target are drawn apart, so that no point of the one is a point of the other.
fn clouds(truth: &Similarity<Target, Source>, seed: u64) -> (Cloud, Cloud) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let target = Cloud::from_points(corner(4000, &mut rng));
    (moved(&corner(3000, &mut rng), truth), target)
}

fn accepted(outcome: Outcome) -> Alignment {
    match outcome {
        Outcome::Accepted(alignment) => *alignment,
        Outcome::Refused { reason, quality } => panic!("refused: {reason}, {quality:?}"),
    }
}

/// The largest error over the corner (m): noise of 5 mm over hundreds of points on each plane
/// ends within a millimetre or two; points alone slide by a share of their spacing of 7 cm.
fn assert_near(found: &Similarity<Target, Source>, truth: &Similarity<Target, Source>, limit: f64) {
    for corner in [
        Vector3::zeros(),
        Vector3::new(3.0, 3.0, 0.0),
        Vector3::new(0.0, 3.0, 2.0),
    ] {
        let error = (*found * (truth.inverse() * corner) - corner).norm();
        assert!(error < limit, "{error} m at {corner:?}, {found:?}");
    }
}

mod honesty;

const METRICS: [(Metric, f64); 3] = [
    (Metric::Point, 0.03),
    (Metric::Plane, 0.006),
    (Metric::Gicp, 0.006),
];

#[test]
fn every_metric_finds_a_small_motion_and_swapping_finds_its_inverse() {
    let truth = truth(0.15, 0.2, 1.0);
    let (source, target) = clouds(&truth, 1);
    for (metric, limit) in METRICS {
        let settings = RegisterSettings {
            metric,
            ..RegisterSettings::default()
        };
        let forward = accepted(register(&source, &target, &settings));
        assert_near(&forward.target_from_source, &truth, limit);
        let backward = accepted(register(&target, &source, &settings));
        let inverse = backward.target_from_source.inverse().relabel();
        assert_near(&inverse, &truth, limit);
    }
}

#[test]
fn every_metric_finds_the_scale() {
    let truth = truth(0.1, 0.1, 1.08);
    let (source, target) = clouds(&truth, 2);
    for (metric, limit) in METRICS {
        let settings = RegisterSettings {
            metric,
            with_scale: true,
            ..RegisterSettings::default()
        };
        let alignment = accepted(register(&source, &target, &settings));
        assert_near(&alignment.target_from_source, &truth, 1.5 * limit);
        assert!(alignment.covariance[(6, 6)] > 0.0);
    }
}

#[test]
fn a_noisy_guess_ends_in_the_same_place() {
    let truth = truth(2.0, 5.0, 1.0);
    let (source, target) = clouds(&truth, 3);
    for sign in [-1.0, 1.0] {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.05, -0.1) * sign);
        let guess = Similarity::new(
            1.0,
            turn * truth.rotation(),
            truth.translation() + Vector3::new(0.1, -0.1, 0.05) * sign,
        );
        let settings = RegisterSettings {
            start: Start::Given(guess),
            ..RegisterSettings::default()
        };
        let alignment = accepted(register(&source, &target, &settings));
        assert_near(&alignment.target_from_source, &truth, 0.006);
    }
}

/// Goal: the answer does not depend on where the frames have their origins, however far.
#[test]
fn shifted_clouds_give_the_shifted_answer() {
    let truth = truth(0.1, 0.1, 1.0);
    let (source, target) = clouds(&truth, 4);
    let shift = Vector3::new(5000.0, -3000.0, 100.0);
    let shifted = |cloud: &Cloud| {
        Cloud::from_points(cloud.points().iter().map(|point| point + shift).collect())
    };
    let settings = RegisterSettings::default();
    let here = accepted(register(&source, &target, &settings)).target_from_source;
    // Identity of the unshifted frames, as a guess between the shifted ones.
    let there = accepted(register(&shifted(&source), &shifted(&target), &settings));
    let mean = source.points().iter().sum::<Vector3<f64>>() / source.points().len() as f64;
    let error = there.target_from_source * (mean + shift) - (here * mean + shift);
    assert!(error.norm() < 1e-4, "{error}");
    // A covariance at an origin far away is large, but that at the cloud is not.
    assert!(
        there.covariance[(3, 3)]
            > accepted(register(&source, &target, &settings)).covariance[(3, 3)]
    );
}

#[test]
fn search_finds_any_rotation_and_scale() {
    for (seed, scale) in [(5, 1.0), (6, 0.7)] {
        let truth = truth(2.6, 8.0, scale);
        let (source, target) = clouds(&truth, seed);
        let settings = RegisterSettings {
            with_scale: scale != 1.0,
            start: Start::Search,
            ..RegisterSettings::default()
        };
        let alignment = accepted(register(&source, &target, &settings));
        assert_near(&alignment.target_from_source, &truth, 0.01);
    }
}

fn refusal(source: &Cloud, target: &Cloud, settings: &RegisterSettings) -> Refusal {
    match register(source, target, settings) {
        Outcome::Accepted(alignment) => panic!("accepted {alignment:?}"),
        Outcome::Refused { reason, .. } => reason,
    }
}

#[test]
fn a_plane_and_a_corridor_are_named_as_weak() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut plane = || -> Cloud {
        let points = (0..2000)
            .map(|_| Vector3::new(4.0 * rng.random::<f64>(), 4.0 * rng.random::<f64>(), 0.0));
        Cloud::from_points(points.collect())
    };
    let (source, target) = (plane(), plane());
    let Refusal::WeakGeometry { directions } =
        refusal(&source, &target, &RegisterSettings::default())
    else {
        panic!("a plane is weak");
    };
    // Two translations along it and the rotation about its normal.
    assert_eq!(directions.len(), 3, "{directions:?}");
    assert_eq!(directions[0], "rotation about (0.00, 0.00, 1.00)");

    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut corridor = || -> Cloud {
        let points = (0..6000).map(|idx| {
            let (along, across) = (20.0 * rng.random::<f64>(), 2.0 * rng.random::<f64>());
            match idx % 3 {
                0 => Vector3::new(along, 0.0, across),
                1 => Vector3::new(along, 2.0, across),
                _ => Vector3::new(along, across, 0.0),
            }
        });
        Cloud::from_points(points.collect())
    };
    let (source, target) = (corridor(), corridor());
    assert_eq!(
        refusal(&source, &target, &RegisterSettings::default()),
        Refusal::WeakGeometry {
            directions: vec!["translation along (1.00, 0.00, 0.00)".to_owned()]
        }
    );
}

/// Goal: a pole with rings fixes where it stands, and nothing along and about it. Method: points
/// on a cylinder a tenth as thick as long.
#[test]
fn a_single_pole_is_named_as_weak() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let mut pole = || {
        cloud_of(3000, || {
            let angle = std::f64::consts::TAU * rng.random::<f64>();
            Vector3::new(
                0.2 * angle.cos(),
                0.2 * angle.sin(),
                4.0 * rng.random::<f64>(),
            )
        })
    };
    let (source, target) = (pole(), pole());
    for (metric, _) in METRICS {
        for with_scale in [false, true] {
            let settings = RegisterSettings {
                metric,
                with_scale,
                ..RegisterSettings::default()
            };
            let reason = refusal(&source, &target, &settings);
            let Refusal::WeakGeometry { directions } = reason else {
                panic!("a pole is weak: {reason}");
            };
            let expected = [
                "rotation about (0.00, 0.00, 1.00)",
                "translation along (0.00, 0.00, 1.00)",
            ];
            assert!(
                expected
                    .iter()
                    .all(|name| directions.iter().any(|one| one == name)),
                "{directions:?}"
            );
        }
    }
}

#[test]
fn unrelated_and_tiny_clouds_are_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let target = Cloud::from_points(corner(3000, &mut rng));
    let mut fog = || Vector3::from_fn(|_, _| 3.0 * rng.random::<f64>());
    let fog = Cloud::from_points((0..3000).map(|_| fog()).collect());
    for start in [Start::Identity, Start::Search] {
        for with_scale in [false, true] {
            let settings = RegisterSettings {
                start,
                with_scale,
                ..RegisterSettings::default()
            };
            refusal(&fog, &target, &settings);
        }
    }
    let dot = Cloud::from_points(vec![Vector3::zeros(); 500]);
    refusal(&dot, &target, &RegisterSettings::default());
    refusal(&target, &dot, &RegisterSettings::default());
    let broken = Cloud::from_points(vec![Vector3::repeat(f64::NAN); 500]);
    assert_eq!(
        refusal(&broken, &target, &RegisterSettings::default()),
        Refusal::TooFewPoints {
            source_count: 0,
            target_count: 3000
        }
    );
}

/// Goal: clouds in units a million times apart are refused, where a trial step that moves the
/// source by the target's spacing would stretch it beyond all numbers.
#[test]
fn a_cloud_smaller_than_the_gaps_of_the_other_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let target = Cloud::from_points(corner(800, &mut rng));
    let tiny = corner(400, &mut rng).into_iter().map(|point| point * 1e-6);
    let tiny = Cloud::from_points(tiny.collect());
    for settings in free_scale_by_each_metric() {
        refusal(&tiny, &target, &settings);
    }
}

fn free_scale_by_each_metric() -> impl Iterator<Item = RegisterSettings> {
    METRICS.iter().map(|(metric, _)| RegisterSettings {
        metric: *metric,
        with_scale: true,
        ..RegisterSettings::default()
    })
}

fn cloud_of(count: usize, mut point: impl FnMut() -> Vector3<f64>) -> Cloud {
    Cloud::from_points((0..count).map(|_| point()).collect())
}

/// Goal: a map that takes chunk after chunk serves as well as one that is made of all at once.
#[test]
fn a_map_that_grew_serves_as_one_made_at_once() {
    let truth = truth(0.1, 0.1, 1.0);
    let (source, target) = clouds(&truth, 15);
    let source = ShapedCloud::new(&source, None);
    let settings = RegisterSettings::default();
    let chunks: Vec<Cloud> = target
        .points()
        .chunks(250)
        .map(|chunk| Cloud::from_points(chunk.to_vec()))
        .collect();
    let mut grown = ShapedCloud::new(&chunks[0], None);
    for chunk in &chunks[1..] {
        grown.extend(chunk);
    }
    let whole = accepted(align(&source, &ShapedCloud::new(&target, None), &settings));
    let grown = accepted(align(&source, &grown, &settings));
    assert_near(&grown.target_from_source, &truth, 0.006);
    let apart = whole.target_from_source.inverse() * grown.target_from_source;
    assert!(apart.log().norm() < 1e-3, "{apart:?}");
}

/// Goal: points that are known badly pull less. Method: a third of the target is off by half a
/// spacing to one side, and says so.
#[test]
fn points_with_large_covariances_pull_less() {
    let truth = truth(0.05, 0.05, 1.0);
    let (source, target) = clouds(&truth, 16);
    let disturbed = |known: bool| {
        let points = target.points().iter().enumerate().map(|(idx, point)| {
            let is_off = idx % 3 == 0;
            let sigma_m = if is_off && known { 0.05 } else { NOISE_M };
            let shift = Vector3::new(0.04, 0.04, 0.04) * f64::from(u8::from(is_off));
            (
                point + shift,
                nalgebra::Matrix3::identity() * sigma_m * sigma_m,
            )
        });
        Cloud::with_covariances(points)
    };
    for metric in [Metric::Plane, Metric::Gicp] {
        let errors_m = [true, false].map(|known| {
            let settings = RegisterSettings {
                metric,
                ..RegisterSettings::default()
            };
            let found = accepted(register(&source, &disturbed(known), &settings));
            let error = truth.inverse() * found.target_from_source;
            error.translation().norm()
        });
        assert!(errors_m[0] < 0.8 * errors_m[1], "{metric:?}: {errors_m:?}");
    }
    let broken = Cloud::with_covariances([
        (Vector3::zeros(), nalgebra::Matrix3::identity()),
        (Vector3::zeros(), nalgebra::Matrix3::repeat(f64::NAN)),
        (Vector3::repeat(f64::NAN), nalgebra::Matrix3::identity()),
    ]);
    assert_eq!((broken.points().len(), broken.dropped_count()), (1, 2));
}

/// Goal: clouds of equal extent and wholly different shape are refused, whichever is moved.
#[test]
fn different_shapes_are_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut unit = || 2.0 * rng.random::<f64>() - 1.0;
    let mut centred = || Vector3::from_fn(|_, _| unit());
    // A sum of uniform draws is nearly normal.
    let blob = |spread: f64, count, draw: &mut dyn FnMut() -> Vector3<f64>| {
        cloud_of(count, || (draw() + draw() + draw()) * spread)
    };
    let grid = |step: f64| {
        let count = (1.0 / step) as usize;
        let mut idx = 0;
        cloud_of(count * count, || {
            idx += 1;
            let (row, column) = ((idx - 1) / count, (idx - 1) % count);
            Vector3::new(row as f64 * step - 0.5, column as f64 * step - 0.5, 0.0)
        })
    };
    let on_sphere = cloud_of(2000, || centred().normalize() * 0.5);
    let on_box = cloud_of(2000, || {
        let point = centred();
        point / point.amax() * 0.45
    });
    let noise: Vec<Cloud> = [1500, 1500, 5000]
        .map(|count| cloud_of(count, &mut centred))
        .into();
    let few = cloud_of(400, &mut || centred() * 0.5);
    let boxed = cloud_of(400, &mut || {
        let point = centred();
        point / point.amax() * 0.45
    });
    let small_noise = cloud_of(5000, &mut || centred() * 0.5);
    let (dense, sparse) = (blob(0.3, 8000, &mut centred), blob(0.3, 2000, &mut centred));
    let pairs = [
        ("grid, blob", grid(0.025), sparse.clone()),
        ("coarse grid, blob", grid(0.05), dense.clone()),
        ("sphere, box", on_sphere, on_box),
        ("noise, noise", noise[0].clone(), noise[1].clone()),
        ("noise, denser noise", noise[0].clone(), noise[2].clone()),
        ("few, dense blob", few, blob(0.2, 5000, &mut centred)),
        ("box, noise", boxed, small_noise),
        ("blob, blob", sparse, dense),
    ];
    for (name, first, second) in &pairs {
        for (source, target) in [(first, second), (second, first)] {
            for (metric, _) in METRICS {
                for with_scale in [false, true] {
                    let settings = RegisterSettings {
                        metric,
                        with_scale,
                        ..RegisterSettings::default()
                    };
                    let outcome = register(source, target, &settings);
                    let refused = matches!(outcome, Outcome::Refused { .. });
                    assert!(refused, "{name}, {metric:?}: {outcome:?}");
                }
            }
        }
    }
}

/// Goal: what is true is accepted, however rough. Method: noise as large as the spacing of the
/// points, a source that shows half of the target, few points, and a volume whose single points
/// recur.
#[test]
fn rough_but_true_pairs_are_accepted() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let mut rough = |points: Vec<Vector3<f64>>, noise_m: f64| -> Vec<Vector3<f64>> {
        let mut noise = || noise_m * 1.7 * (2.0 * rng.random::<f64>() - 1.0);
        points
            .into_iter()
            .map(|point| point + Vector3::new(noise(), noise(), noise()))
            .collect()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let truth = truth(0.03, 0.05, 1.0);
    let mut half = corner(4000, &mut rng);
    half.retain(|point| point.x < 1.6);
    let fog: Vec<Vector3<f64>> = (0..2000)
        .map(|_| Vector3::from_fn(|_, _| rng.random::<f64>()))
        .collect();
    let pairs = [
        (rough(corner(3000, &mut rng), 0.045), corner(4000, &mut rng)),
        (half, corner(4000, &mut rng)),
        (corner(400, &mut rng), corner(500, &mut rng)),
        (rough(fog[..1000].to_vec(), 0.005), fog),
    ];
    for (source, target) in pairs {
        let source = moved(&source, &truth);
        let target = Cloud::from_points(target);
        for (metric, _) in METRICS {
            let settings = RegisterSettings {
                metric,
                ..RegisterSettings::default()
            };
            let alignment = accepted(register(&source, &target, &settings));
            assert_near(&alignment.target_from_source, &truth, 0.08);
        }
    }
}

/// Goal: a free scale does not shrink the cloud to fit better. Method: a source five times too
/// large, which fits perfectly inside one target point when shrunken.
#[test]
fn a_cloud_that_would_have_to_collapse_is_refused() {
    let truth = truth(0.0, 0.0, 0.2);
    let (source, target) = clouds(&truth, 10);
    for settings in free_scale_by_each_metric() {
        refusal(&source, &target, &settings);
    }
}

/// Goal: a file that has each point twice is the cloud that has it once.
#[test]
fn points_given_twice_do_no_harm() {
    let truth = truth(0.1, 0.1, 1.0);
    let (source, target) = clouds(&truth, 11);
    let [source, target] = [source, target].map(|cloud| {
        let twice = cloud.points().iter().flat_map(|point| [*point; 2]);
        Cloud::from_points(twice.collect())
    });
    for (metric, limit) in METRICS {
        let settings = RegisterSettings {
            metric,
            ..RegisterSettings::default()
        };
        let alignment = accepted(register(&source, &target, &settings));
        assert_near(&alignment.target_from_source, &truth, limit);
    }
}

/// Goal: a room that shares some things is not the room. Method: two looks at one corner of a room,
/// and the same with other looks wherever both do not share them; the shapes fit alike.
#[test]
fn a_room_that_shares_some_things_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let points = corner(3000, &mut rng);
    let mut look = || features::Descriptor(std::array::from_fn(|_| rng.random()));
    let looks: Vec<_> = points.iter().map(|_| look()).collect();
    let others: Vec<_> = points.iter().map(|_| look()).collect();
    let truth = truth(2.0, 1.0, 1.5);
    let target = Cloud::new(points.clone(), Descriptors::Binary(looks.clone())).unwrap();
    let settings = RegisterSettings {
        with_scale: true,
        start: Start::Search,
        ..RegisterSettings::default()
    };
    let cube = |along_m: f64| (along_m / 0.5).floor() as i64;
    let is_shared = |point: &Vector3<f64>| {
        (cube(point.x) + 2 * cube(point.y) + cube(point.z)).rem_euclid(5) == 0
    };
    for is_room in [true, false] {
        let seen = points.iter().zip(looks.iter().zip(&others));
        let seen = seen.map(|(point, (look, other))| {
            let is_known = is_room || is_shared(point);
            if is_known { *look } else { *other }
        });
        let there = moved(&points, &truth).points().to_vec();
        let source = Cloud::new(there, Descriptors::Binary(seen.collect())).unwrap();
        match register(&source, &target, &settings) {
            Outcome::Accepted(alignment) => {
                let likeness = alignment.quality.likeness.unwrap();
                assert!(is_room && likeness.extent > 0.9, "{likeness:?}");
            }
            Outcome::Refused { reason, .. } => {
                assert!(
                    !is_room && matches!(reason, Refusal::AnotherPlace { .. }),
                    "{reason}"
                );
            }
        }
    }
}

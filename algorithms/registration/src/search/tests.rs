//! Clouds with descriptors, found or refused.

use features::Descriptor;
use geometry::Similarity;
use nalgebra::{UnitQuaternion, UnitVector3};
use rand::{Rng, RngExt};

use super::*;
use crate::gravity::Gravity;
use crate::{Cloud, Outcome, Start, register};

fn settings() -> RegisterSettings {
    RegisterSettings {
        with_scale: true,
        start: Start::Search,
        ..RegisterSettings::default()
    }
}

fn descriptor(rng: &mut impl Rng) -> Descriptor {
    Descriptor(std::array::from_fn(|_| rng.random()))
}

/// Points on three walls and the floor of a room of 4 m × 3 m × 2 m, each of its own looks.
fn room(count: usize, rng: &mut impl Rng) -> Vec<(Vector3<f64>, Descriptor)> {
    let point = |idx: usize, rng: &mut _| {
        let (a, b) = (RngExt::random::<f64>(rng), RngExt::random::<f64>(rng));
        match idx % 4 {
            0 => Vector3::new(4.0 * a, 3.0 * b, 0.0),
            1 => Vector3::new(4.0 * a, 0.0, 2.0 * b),
            2 => Vector3::new(0.0, 3.0 * a, 2.0 * b),
            _ => Vector3::new(4.0, 3.0 * a, 2.0 * b),
        }
    };
    (0..count)
        .map(|idx| (point(idx, rng), descriptor(rng)))
        .collect()
}

fn truth() -> Similarity<Target, Source> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -1.9, 1.1));
    Similarity::new(0.4, rotation, Vector3::new(3.0, -2.0, 0.5))
}

fn cloud(points: impl IntoIterator<Item = (Vector3<f64>, Descriptor)>) -> Cloud {
    let (points, descriptors) = points.into_iter().unzip();
    Cloud::new(points, Descriptors::Binary(descriptors)).unwrap()
}

/// What another map of the points shows: noise of 1 cm, 20 bits that differ.
fn seen_again(
    points: &[(Vector3<f64>, Descriptor)],
    rng: &mut impl Rng,
) -> Vec<(Vector3<f64>, Descriptor)> {
    let from_target = truth().inverse();
    let again = points.iter().map(|(point, look)| {
        let noise = Vector3::from_fn(|_, _| 0.035 * (rng.random::<f64>() - 0.5));
        let mut look = *look;
        for _ in 0..20 {
            look.0[rng.random_range(0..4)] ^= 1 << rng.random_range(0..64);
        }
        (from_target * (point + noise), look)
    });
    again.collect()
}

fn found(source: &Cloud, target: &Cloud, settings: &RegisterSettings) -> Result<Found, Refusal> {
    let [source, target] = [source, target].map(|cloud| ShapedCloud::new(cloud, None));
    find(&source, &target, settings)
}

#[test]
fn what_looks_the_same_is_found_and_counted() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let target = room(800, &mut rng);
    let mut source = seen_again(&target[..400], &mut rng);
    source.extend(seen_again(&room(400, &mut rng), &mut rng));
    let Outcome::Accepted(alignment) = register(&cloud(source), &cloud(target), &settings()) else {
        panic!("half of the source is in the target");
    };
    // 400 points with 1 cm of noise over 2 m fix the turn to 0.02° and the scale to 0.05 %.
    let error = (truth().inverse() * alignment.target_from_source).log();
    assert!(
        error.fixed_rows::<3>(0).norm() < 0.003 && error[6].abs() < 0.003,
        "{error}"
    );
    let evidence = alignment.quality.evidence.unwrap();
    assert!(evidence.consistent_count > 380, "{evidence:?}");
    assert!(evidence.runner_up_count < 10 && evidence.false_alarms_log10 < -100.0);
    // The covariance is that of the correspondences: the error is a likely one.
    let whitened = alignment.covariance.cholesky().unwrap().solve(&error);
    let distance_squared = error.dot(&whitened);
    assert!(
        (0.5..30.0).contains(&distance_squared),
        "{distance_squared}"
    );
}

/// Goal: a wall alone leaves three directions free, but not to points that look the same.
#[test]
fn what_looks_the_same_fixes_a_wall() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut wall = room(1600, &mut rng);
    wall.retain(|(point, _)| point.y == 0.0 && point.z > 0.0);
    let source = seen_again(&wall, &mut rng);
    let Outcome::Accepted(alignment) = register(&cloud(source), &cloud(wall), &settings()) else {
        panic!("each point is known");
    };
    let error = (truth().inverse() * alignment.target_from_source).log();
    assert!(
        error.fixed_rows::<3>(0).norm() < 0.003 && error[6].abs() < 0.003,
        "{error}"
    );
    assert!(alignment.quality.weak_directions.is_empty());
}

/// Goal: 4 degrees of freedom and scale, from both clouds' own up.
#[test]
fn gravity_leaves_the_turn_about_it() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let target = room(800, &mut rng);
    let source = seen_again(&target[..40], &mut rng);
    let others = seen_again(&room(700, &mut rng), &mut rng);
    let source = cloud(source.into_iter().chain(others));
    let up_in_target = UnitVector3::new_normalize(Vector3::new(0.3, 0.4, 1.0));
    let settings = RegisterSettings {
        gravity: Some(Gravity {
            up_in_target,
            up_in_source: truth().rotation().inverse() * up_in_target,
        }),
        ..settings()
    };
    let found = found(&source, &cloud(target), &settings).unwrap();
    let turned = found.start.rotation() * settings.gravity.unwrap().up_in_source;
    assert!(turned.angle(&up_in_target) < 1e-9);
    assert!(
        found.evidence.consistent_count >= 38,
        "{:?}",
        found.evidence
    );
}

/// Goal: of two rooms that look the same neither is chosen.
#[test]
fn a_room_that_stands_twice_is_ambiguous() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let one = room(600, &mut rng);
    let shift = Vector3::new(9.0, 1.0, 0.0);
    let mut target = Vec::new();
    for (idx, (point, look)) in one.iter().enumerate() {
        // Each point was mapped in one of the rooms only, so that descriptors are unique.
        let place = if idx % 5 < 3 { *point } else { point + shift };
        target.push((place, *look));
    }
    let source = cloud(seen_again(&one, &mut rng));
    let refusal = found(&source, &cloud(target), &settings()).unwrap_err();
    assert!(matches!(refusal, Refusal::Ambiguous { .. }), "{refusal}");
}

/// Goal: a poster that hangs in two different rooms does not make them one.
#[test]
fn one_thing_in_two_places_is_not_a_place() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let poster: Vec<(Vector3<f64>, Descriptor)> = (0..80)
        .map(|_| {
            let (a, b) = (rng.random::<f64>(), rng.random::<f64>());
            (
                Vector3::new(1.0 + 0.4 * a, 0.0, 1.0 + 0.3 * b),
                descriptor(&mut rng),
            )
        })
        .collect();
    let here = cloud(room(600, &mut rng).into_iter().chain(poster.clone()));
    let mut there = room(600, &mut rng);
    there.extend(poster);
    let there = cloud(seen_again(&there, &mut rng));
    let refusal = found(&there, &here, &settings()).unwrap_err();
    assert!(
        matches!(refusal, Refusal::NarrowEvidence { .. }),
        "{refusal}"
    );
}

#[test]
fn unlike_places_are_not_found() {
    for seed in 5..8 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let source = cloud(seen_again(&room(500, &mut rng), &mut rng));
        let target = cloud(room(500, &mut rng));
        let refusal = found(&source, &target, &settings()).unwrap_err();
        assert_eq!(refusal, Refusal::SearchFoundNothing);
    }
}

//! Loops and joins on maps of a made-up corridor, whose drift is known.

mod world;

use geometry::{Camera, Map, Similarity, Tangent7, Transform, so3, umeyama};
use nalgebra::{Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use self::world::{Drift, World, optics};
use super::align::{Side, Sighting};
use super::*;
use crate::MapId;

const NO_DRIFT: Drift = Drift {
    log_scale: 0.0,
    turn_rad: 0.0,
};

/// Observations and points name each other, and nothing that does not exist.
fn assert_consistent(map: &VslamMap) {
    for point in map.points() {
        assert!(point.view_count() >= 2);
        assert!(point.views().is_sorted());
        for view in point.views() {
            let keyframe = map.keyframe(view.keyframe).unwrap();
            let observation = &keyframe.observations()[view.observation_idx as usize];
            assert_eq!(observation.point, Some(point.id()));
        }
    }
    for keyframe in map.keyframes() {
        for point in keyframe.points() {
            let point = map.point(point).unwrap();
            assert!(point.observation_idx(keyframe.id()).is_some());
        }
    }
}

/// How much longer than the truth the map is around these keyframes.
fn scale(world: &World, map: &VslamMap, frames: std::ops::Range<u64>) -> f64 {
    let pairs = map
        .keyframes()
        .filter(|one| one.frame_idx().is_some_and(|idx| frames.contains(&idx)))
        .map(|one| {
            let truth = world.pose(one.frame_idx().unwrap() as usize);
            (one.centre_in_map(), *truth.translation(), 1.0)
        });
    umeyama::<Map, Map>(pairs.collect::<Vec<_>>().into_iter(), true)
        .unwrap()
        .scale()
}

/// Closes what can be closed, keyframe by keyframe from `first_idx` on; how often it did.
fn revisit(map: &mut VslamMap, first_idx: usize) -> usize {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut loops, mut places) = (Loops::default(), Places::default());
    let ids: Vec<KeyframeId> = map.keyframes().map(Keyframe::id).collect();
    let mut closed_count = 0;
    for (idx, id) in ids.into_iter().enumerate() {
        if idx >= first_idx {
            let closed = loops.close_at((&optics(), &places), map, id, &mut rng);
            closed_count += usize::from(closed.is_some());
        }
        if let Some(keyframe) = map.keyframe(id) {
            places.insert(keyframe);
        }
    }
    closed_count
}

/// A walk around a block and past its start, the keyframes in a round, and a map that drifts.
fn drifted_walk_around() -> (World, usize, VslamMap) {
    let world = World::new(8.0, 1);
    let around = world.keyframes_around();
    let drift = Drift {
        log_scale: 0.2 / around as f64,
        turn_rad: 0.1 / around as f64,
    };
    let map = world.walk(0..around + 8, drift, (MapId(0), 0));
    (world, around, map)
}

#[test]
fn a_closed_loop_corrects_the_drift_of_scale() {
    let (world, around, mut map) = drifted_walk_around();
    let end = around as u64 - 10..around as u64 + 10;
    let before = scale(&world, &map, end.clone()) / scale(&world, &map, 0..20);
    assert!(before > 1.15, "the map drifts without the loop: {before}");

    let point_count = map.point_count();
    assert_eq!(revisit(&mut map, around + 5), 1);
    let after = scale(&world, &map, end) / scale(&world, &map, 0..20);
    // Noise of half a pixel leaves each length of a window of keyframes uncertain by 0.3 %.
    assert!((after - 1.0).abs() < 0.01, "{after}");
    assert!(map.revision() > 0);
    assert!(map.point_count() < point_count, "points were joined");
    assert_consistent(&map);
    let first = map.keyframes().next().unwrap();
    let far = first.centre_in_map() - map.keyframes().next_back().unwrap().centre_in_map();
    let truth = world.pose(0).translation() - world.pose(around + 7).translation();
    assert!((far.norm() - truth.norm()).abs() < 0.1 * truth.norm());
}

/// How far keyframes are from the truth after alignment, root mean square.
fn position_error(world: &World, map: &VslamMap) -> f64 {
    let pairs: Vec<_> = map
        .keyframes()
        .map(|one| {
            let truth = world.pose(one.frame_idx().unwrap() as usize);
            (*truth.translation(), one.centre_in_map(), 1.0)
        })
        .collect();
    let truth_from_map = umeyama::<Map, Map>(pairs.iter().copied(), true).unwrap();
    let squared = pairs
        .iter()
        .map(|(truth, estimate, _)| (truth - truth_from_map * *estimate).norm_squared());
    (squared.sum::<f64>() / pairs.len() as f64).sqrt()
}

fn adjusting(keyframes_max: usize, background: Option<Background>) -> Loops {
    Loops::new(&VslamSettings {
        global_adjustment_keyframes_max: keyframes_max,
        background,
        ..VslamSettings::default()
    })
}

/// Adjusts the map beside the frames, of which the third culls a keyframe; how many frames it
/// takes.
fn adjust_meanwhile(map: &mut VslamMap, background: Option<Background>) -> usize {
    let mut loops = adjusting(1000, background);
    loops.begin_adjustment(map);
    let mut frame_count = 0;
    while loops.adjustment.is_some() {
        loops.adjust_further(map);
        frame_count += 1;
        if frame_count == 3 {
            let culled = map.keyframes().nth(40).unwrap().id();
            map.remove_keyframe(culled);
        }
    }
    frame_count
}

#[test]
fn the_whole_map_is_adjusted_beside_the_frames_while_it_may_change() {
    let (world, around, mut map) = drifted_walk_around();
    revisit(&mut map, around + 5);
    // Bent, as by a pose graph that did not know where the drift came from.
    let bend = |one: &Keyframe| {
        let phase = std::f64::consts::TAU * one.frame_idx().unwrap() as f64 / around as f64;
        let way = Vector3::new(0.0, 0.15 * (3.0 * phase).sin(), 0.0);
        (
            one.id,
            Similarity::new(1.0, so3::exp(&Vector3::zeros()), way),
        )
    };
    map.correct(&map.keyframes().map(bend).collect());
    let closed = position_error(&world, &map);

    let mut at_once = map.clone();
    adjusting(1000, None).adjust_all(&mut at_once);
    let adjusted = position_error(&world, &at_once);
    assert!(adjusted < 0.4 * closed, "{closed} m, then {adjusted} m");
    assert_consistent(&at_once);
    assert!(at_once.revision() > map.revision());

    let mut elsewhere = map.clone();
    let mut lost = map.clone();
    let frame_count = adjust_meanwhile(&mut map, None);
    let sliced = position_error(&world, &map);
    assert!(
        sliced < 1.2 * adjusted,
        "{adjusted} m, in slices {sliced} m"
    );
    assert_consistent(&map);

    let at_the_same_frame = adjust_meanwhile(&mut elsewhere, Some(|job| job()));
    assert_eq!(at_the_same_frame, frame_count);
    assert_eq!(position_error(&world, &elsewhere), sliced, "bit by bit");

    adjust_meanwhile(&mut lost, Some(drop));
    assert_consistent(&lost);
    assert!(position_error(&world, &lost) > 0.9 * closed);

    let mut small_only = adjusting(50, None);
    small_only.begin_adjustment(&map);
    assert!(!small_only.adjust_further(&mut map));

    let mut left = adjusting(1000, None);
    left.begin_adjustment(&map);
    assert!(!left.adjust_further(&mut map.successor(MapId(9))));
    assert!(left.adjustment.is_none());
}

#[test]
fn what_only_looks_the_same_is_no_loop() {
    // A nearly straight corridor whose walls repeat every ten metres.
    let world = World::new(160.0, 100);
    let mut map = world.walk(0..80, NO_DRIFT, (MapId(0), 0));
    let before = map.clone();
    assert_eq!(revisit(&mut map, 0), 0);
    assert_eq!(map.point_count(), before.point_count());
    // And a ring of which each quarter is the same.
    let world = World::new(8.0, 4);
    let around = world.keyframes_around();
    let mut map = world.walk(0..around / 2, NO_DRIFT, (MapId(0), 0));
    assert_eq!(revisit(&mut map, 0), 0);
}

/// Two walks over overlapping steps in maps of their own; the second is turned, moved and larger.
fn two_maps(
    world: &World,
    first: std::ops::Range<usize>,
    second: std::ops::Range<usize>,
) -> (VslamMap, VslamMap) {
    let first = world.walk(first, NO_DRIFT, (MapId(0), 0));
    let mut second = world.walk(second, NO_DRIFT, (MapId(1), 1000));
    let rotation = so3::exp(&Vector3::new(0.3, -1.0, 0.2));
    second.transform(&Similarity::new(
        1.7,
        rotation,
        Vector3::new(3.0, 1.0, -2.0),
    ));
    (first, second)
}

/// Whether all keyframes stand to each other as in truth, up to one similarity.
fn assert_true_to(world: &World, map: &VslamMap) {
    let pairs: Vec<_> = map
        .keyframes()
        .map(|one| {
            let truth = world.pose(one.frame_idx().unwrap() as usize);
            (*truth.translation(), one.centre_in_map(), 1.0)
        })
        .collect();
    let truth_from_map = umeyama::<Map, Map>(pairs.iter().copied(), true).unwrap();
    for (truth, estimate, _) in pairs {
        let error = (truth - truth_from_map * estimate).norm();
        assert!(error < 0.1, "{error} m");
    }
}

#[test]
fn a_map_is_joined_to_the_larger_one_whichever_is_followed() {
    let world = World::new(8.0, 1);
    for (first, second) in [(0..40, 28..50), (28..50, 0..40)] {
        let (earlier, mut map) = two_maps(&world, first.clone(), second.clone());
        let mut places = Places::default();
        places.insert_all(&earlier);
        let larger = if first.len() > second.len() {
            earlier.id()
        } else {
            map.id()
        };
        let all: BTreeSet<KeyframeId> = earlier
            .keyframes()
            .chain(map.keyframes())
            .map(Keyframe::id)
            .collect();
        // The keyframe that shows the place is the one in the middle of what both have seen.
        let shown = map
            .keyframes()
            .find(|one| one.frame_idx() == Some(34))
            .unwrap()
            .id();
        let mut earlier = vec![earlier];
        let joined = Loops::default()
            .join_at(
                (&optics(), &places),
                &mut map,
                &mut earlier,
                shown,
                &mut ChaCha8Rng::seed_from_u64(1),
            )
            .unwrap();
        assert_eq!((joined.into, map.id()), (larger, larger));
        assert!(earlier.is_empty());
        let stretch = if larger == MapId(0) { 1.0 / 1.7 } else { 1.0 };
        assert!((joined.stretch / stretch - 1.0).abs() < 0.01, "{joined:?}");
        let kept: BTreeSet<KeyframeId> = map.keyframes().map(Keyframe::id).collect();
        assert_eq!(kept, all);
        assert!(map.revision() > 0);
        assert_consistent(&map);
        assert_true_to(&world, &map);
        // They hang together: what both saw has become one.
        let neighbours: Vec<_> = map
            .covisible(shown)
            .into_iter()
            .map(|one| one.keyframe)
            .collect();
        assert!(
            neighbours.iter().any(|id| id.0 < 1000) && neighbours.iter().any(|id| id.0 >= 1000)
        );
    }
}

#[test]
fn maps_of_different_places_stay_apart() {
    let world = World::new(8.0, 1);
    let (earlier, mut map) = two_maps(&world, 0..20, 60..80);
    let mut places = Places::default();
    places.insert_all(&earlier);
    let mut earlier = vec![earlier];
    for id in map.keyframes().map(Keyframe::id).collect::<Vec<_>>() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let index = (&optics(), &places);
        let joined = Loops::default().join_at(index, &mut map, &mut earlier, id, &mut rng);
        assert_eq!(joined, None);
    }
}

#[test]
fn derivatives_of_sightings_match_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut random = |limit: f64| rng.random_range(-limit..limit);
    for side in [Side::Target, Side::Source] {
        for _ in 0..10 {
            let tangent = Tangent7::from_fn(|_, _| random(0.3));
            let similarity = Similarity::<Map, Map>::exp(&tangent);
            let omega = Vector3::new(random(0.2), random(0.2), random(0.2));
            let camera_from_map: Transform<Camera, Map> =
                Transform::new(so3::exp(&omega), Vector3::new(0.1, 0.2, 0.3));
            let sighting = Sighting {
                point: Vector3::new(random(1.0), random(1.0), 5.0),
                camera_from_map,
                position: Vector2::new(0.1, -0.1),
                sigma: 0.01,
                side,
            };
            let (_, jacobian) = sighting.residual(&similarity).unwrap();
            for axis in 0..7 {
                let value = |width: f64| {
                    let mut delta = Tangent7::zeros();
                    delta[axis] = width;
                    sighting.residual(&similarity.perturbed(&delta)).unwrap().0
                };
                let numeric = (value(1e-6) - value(-1e-6)) / 2e-6;
                let difference = (numeric - jacobian.column(axis)).norm();
                assert!(
                    difference < 1e-4 * (1.0 + numeric.norm()),
                    "{side:?} {axis}"
                );
            }
        }
    }
}

//! Descriptors of made-up places: each place has its own, each look flips some of their bits.

use features::Descriptor;
use geometry::{Timestamp, Transform};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::plane_grid::PlaneGrid;
use crate::{MapId, Observation, PointId, View};

const KEYPOINT_COUNT: usize = 300;
/// Bits in which a look differs from the thing, at most; two looks differ by twice that.
const FLIP_COUNT: usize = 20;

fn random_descriptor(rng: &mut ChaCha8Rng) -> Descriptor {
    Descriptor(std::array::from_fn(|_| rng.random()))
}

/// The same things seen again.
fn look(rng: &mut ChaCha8Rng, things: &[Descriptor]) -> Vec<Descriptor> {
    let seen_again = |thing: &Descriptor| {
        let mut words = thing.0;
        for _ in 0..FLIP_COUNT {
            let bit = rng.random_range(0..256_usize);
            words[bit / 64] ^= 1 << (bit % 64);
        }
        Descriptor(words)
    };
    things.iter().map(seen_again).collect()
}

fn observation(descriptor: Descriptor) -> Observation {
    Observation {
        position: Vector2::zeros(),
        position_px: Vector2::zeros(),
        sigma: 1e-3,
        level: 0,
        angle_rad: 0.0,
        descriptor,
        point: None,
    }
}

/// Pairs of keyframes that see the points of one place each, and the descriptors of the places.
fn map_of_places(rng: &mut ChaCha8Rng, place_count: usize) -> (VslamMap, Vec<Vec<Descriptor>>) {
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let mut all_things = Vec::new();
    for place in 0..place_count {
        let things: Vec<Descriptor> = (0..KEYPOINT_COUNT)
            .map(|_| random_descriptor(rng))
            .collect();
        let mut ids = Vec::new();
        for _ in 0..2 {
            let frame = Frame {
                frame_idx: place as u64,
                captured_at: Timestamp::default(),
                observations: look(rng, &things).into_iter().map(observation).collect(),
                grid: PlaneGrid::default(),
            };
            ids.push(map.add_keyframe(frame, Transform::identity()));
        }
        for observation_idx in 0..KEYPOINT_COUNT as u32 {
            let view = |keyframe: &KeyframeId| View {
                keyframe: *keyframe,
                observation_idx,
            };
            let point = NewPoint {
                position_in_map: Vector3::z(),
                covariance_in_map: Matrix3::identity(),
                parallax_rad: 0.1,
                expected_range: None,
            };
            map.add_point(point, ids.iter().map(view).collect());
        }
        for (id, other) in [(ids[0], ids[1]), (ids[1], ids[0])] {
            map.keyframe_mut(id).unwrap().neighbours = vec![other];
        }
        all_things.push(things);
    }
    (map, all_things)
}

#[test]
fn a_place_is_found_among_hundreds_by_a_third_of_what_it_shows() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (map, things) = map_of_places(&mut rng, 150);
    let mut places = Places::default();
    places.insert_all(&map);
    for place in (0..150).step_by(10) {
        let mut seen = look(&mut rng, &things[place][..KEYPOINT_COUNT / 3]);
        let others = (0..2 * KEYPOINT_COUNT / 3).map(|_| random_descriptor(&mut rng));
        seen.extend(others);
        let ranked = rank(&map, &places.look_alikes(seen.iter()), |_| true);
        assert_eq!(ranked[0].keyframe.0 as usize / 2, place);
        let runner_up = ranked.get(1).map_or(0.0, |one| one.score);
        assert!(ranked[0].score > 5.0 * runner_up, "{:?}", &ranked[..2]);
    }
}

#[test]
fn what_every_place_shows_tells_little() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut map, things) = map_of_places(&mut rng, 30);
    // All places but the last also show the same thing, over and over.
    let sign = random_descriptor(&mut rng);
    for id in 0..58 {
        let keyframe = map.keyframe_mut(KeyframeId(id)).unwrap();
        for observation in &mut keyframe.observations[..60] {
            observation.descriptor = sign;
        }
    }
    let mut places = Places::default();
    places.insert_all(&map);
    let mut seen = vec![sign; 60];
    seen.extend(look(&mut rng, &things[29][..60]));
    let ranked = rank(&map, &places.look_alikes(seen.iter()), |_| true);
    assert_eq!(ranked[0].keyframe.0 / 2, 29);
}

#[test]
fn what_is_not_usable_is_left_out_and_a_culled_keyframe_is_its_heir() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut map, things) = map_of_places(&mut rng, 10);
    let mut places = Places::default();
    places.insert_all(&map);
    map.keyframe_mut(KeyframeId(7)).unwrap().parent = Some(KeyframeId(6));
    map.remove_keyframe(KeyframeId(7));
    let alike = places.look_alikes(
        look(&mut rng, &things[3])
            .iter()
            .collect::<Vec<_>>()
            .into_iter(),
    );
    let best = |usable: &dyn Fn(KeyframeId) -> bool| {
        rank(&map, &alike, usable).first().map(|one| one.keyframe)
    };
    assert_eq!(best(&|_| true), Some(KeyframeId(6)));
    assert_ne!(best(&|id| id != KeyframeId(6)), Some(KeyframeId(6)));
}

#[test]
fn memory_is_bounded_even_if_everything_looks_the_same() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (mut map, _) = map_of_places(&mut rng, 20);
    let sign = random_descriptor(&mut rng);
    for id in 0..40 {
        for observation in &mut map.keyframe_mut(KeyframeId(id)).unwrap().observations {
            observation.descriptor = sign;
        }
    }
    let mut places = Places::default();
    places.insert_all(&map);
    assert!(
        places.entry_count <= LEAF_ENTRIES_MAX + usize::from(DEPTH_MAX),
        "{}",
        places.entry_count
    );
    assert!(!places.look_alikes([sign].iter()).is_empty());
}

//! What a keyframe costs in maps of different size.

use rand::RngExt;

use super::*;

/// Rooms that the vehicle never sees, one chunk each, in rows beside the room that it flies in.
fn publish_elsewhere(localizer: &mut Localizer, chunk_count: usize, rng: &mut ChaCha8Rng) {
    for idx in 0..chunk_count {
        let landmarks = (0..80).map(|_| Landmark {
            point_in_chunk: Vector3::new(
                4.0 * rng.random::<f64>() - 2.0,
                3.0 * rng.random::<f64>() - 1.5,
                1.0 + 3.0 * rng.random::<f64>(),
            ),
            covariance_in_chunk: Matrix3::identity() * 1e-4,
            descriptor: Descriptor(std::array::from_fn(|_| rng.random())),
        });
        let chunk = ChunkIdx(1000 + idx as u64);
        localizer.insert_chunk(AnchorIdx(0), chunk, landmarks.collect());
        let place = Vector3::new((idx % 40) as f64 * 9.0, (idx / 40 + 1) as f64 * 9.0, 0.0);
        let map_from_chunk = Similarity::new(1.0, UnitQuaternion::identity(), place);
        localizer.place_chunk(AnchorIdx(0), chunk, map_from_chunk);
    }
}

/// The most chunks and landmarks that one keyframe looks at: while searching, and once located.
fn effort(chunk_count: usize) -> [(usize, usize); 2] {
    let mut scene = scene(30, 1.0);
    publish_elsewhere(&mut scene.localizer, chunk_count, &mut scene.rng);
    scene.publish(&AnchorSettings::default());
    let (mut searching, mut following) = ((0, 0), (0, 0));
    let mut follows = false;
    for step in 0..60 {
        let report = scene.step(step);
        let effort = report
            .anchors
            .iter()
            .map(|one| (one.chunk_count, one.candidate_count));
        let most = if follows {
            &mut following
        } else {
            &mut searching
        };
        for (chunks, candidates) in effort {
            *most = (most.0.max(chunks), most.1.max(candidates));
        }
        follows = report.verdict == Verdict::Accepted;
    }
    assert!(follows, "{chunk_count}: not located");
    [searching, following]
}

/// Goal: the work of a keyframe does not grow with the map, however it is located. Method: count
/// chunks and landmarks that are looked at in maps of 40, 130 and 1,030 chunks.
#[test]
fn what_a_keyframe_costs_does_not_grow_with_the_map() {
    let [small, medium, large] = [10, 100, 1000].map(effort);
    println!("searching, following: {small:?} {medium:?} {large:?}");
    let [_, following] = small;
    for [_, grown] in [medium, large] {
        // Landmarks are drawn anew for each map, so the counts differ a little.
        let limit = |count: usize| count + count / 4;
        assert!(grown.0 <= limit(following.0), "{grown:?}");
        assert!(grown.1 <= limit(following.1), "{grown:?}");
    }
    // The search is bounded by its budget of comparisons, in landmarks: 8 million over at least
    // 200 features, and two rounds of refinement.
    let limit = LocalizerSettings::default().search_distance_count_max / 200;
    assert!(large[0].1 <= limit + 2 * following.1, "{large:?}");
}

/// Goal: a place that is mapped again and again costs no more in the end. Method: the same chunks
/// under ever new numbers.
#[test]
fn mapping_a_place_again_and_again_is_bounded() {
    let mut localizer = Localizer::new(LocalizerSettings {
        predicted_landmark_count_max: 3000,
        ..LocalizerSettings::default()
    });
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    for round in 0..20 {
        for idx in 0..10 {
            let landmarks = (0..50).map(|_| Landmark {
                point_in_chunk: Vector3::new(rng.random(), rng.random(), 3.0),
                covariance_in_chunk: Matrix3::identity() * 1e-4,
                descriptor: Descriptor(std::array::from_fn(|_| rng.random())),
            });
            let chunk = ChunkIdx(10 * round + idx);
            localizer.insert_chunk(AnchorIdx(0), chunk, landmarks.collect());
            localizer.place_chunk(AnchorIdx(0), chunk, Similarity::identity());
        }
    }
    let landmarks = &localizer.anchors[&AnchorIdx(0)].landmarks;
    let near = landmarks.chunks_near(&Vector3::zeros(), 3000);
    let count: usize = near.iter().map(|(_, chunk)| chunk.placed().len()).sum();
    assert_eq!((landmarks.landmark_count(), count), (10_000, 3000));
    assert_eq!(
        near.last().map(|(idx, _)| *idx),
        Some(ChunkIdx(199)),
        "the newest stay"
    );
}

/// Goal: what a place promises is asked of no more landmarks than are compared. Method: the bound
/// leaves none of the chunks about the place.
#[test]
fn what_should_be_in_view_is_bounded_too() {
    let mut scene = scene(34, 0.0);
    scene.publish(&AnchorSettings::default());
    scene.flyer.fly_to(0);
    let keyframe = scene.flyer.keyframe(&scene.world);
    let features = FeatureIndex::new(&keyframe.features).unwrap();
    let landmarks = &scene.localizer.anchors[&AnchorIdx(0)].landmarks;
    let enu_from_anchor = landmarks.placement().unwrap().enu_from_map;
    let anchor_from_enu = enu_from_anchor.inverse();
    let pose = anchor_from_enu.transform_pose(&scene.flyer.enu_from_camera);
    let expected_counts = [40_000, 1].map(|predicted_landmark_count_max| {
        let settings = LocalizerSettings {
            predicted_landmark_count_max,
            ..LocalizerSettings::default()
        };
        let coverage = matching::coverage(&features, landmarks, &pose.inverse(), &[], &settings);
        coverage.expected_count
    });
    assert!(
        expected_counts[0] > 10 && expected_counts[1] == 0,
        "{expected_counts:?}"
    );
}

/// Goal: what follows the own map costs the same however many keyframes that has.
#[test]
fn only_recent_keyframes_are_asked_for() {
    let mut scene = scene(32, 1.0);
    scene.publish(&AnchorSettings::default());
    for step in 0..120 {
        scene.step(step);
        let window = scene.localizer.settings.window_keyframe_count;
        let tied = scene.localizer.tied_keyframes();
        assert!(tied.len() <= window + 12 + 12 + 1, "{}", tied.len());
    }
}

/// Goal: many anchors whose maps show nothing of this place cost no more than two. Method: count
/// what is searched for each keyframe, and that nobody is forgotten.
#[test]
fn anchors_are_searched_in_turn() {
    let mut scene = scene(33, 1.0);
    for idx in 0..5 {
        scene.publish(&votes::honest(idx));
    }
    scene.world = World::new(2500, &mut ChaCha8Rng::seed_from_u64(99));
    let mut tried = std::collections::BTreeSet::new();
    for step in 0..3 {
        let report = scene.step(step);
        assert_eq!(report.anchors.len(), 2, "{report:?}");
        tried.extend(report.anchors.iter().map(|one| one.anchor));
    }
    assert_eq!(tried.len(), 5);
}

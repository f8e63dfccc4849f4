//! Whole alignments in a synthetic room; the flight knows the truth, the localiser does not.

mod chain;
mod growth;
mod late_chunks;
mod settling;
mod votes;
pub(super) mod world;

use features::Descriptor;
use geometry::{Enu, Matrix7, Similarity, Timestamp};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use world::{AnchorSettings, Flyer, World, publish_anchor};

struct Scene {
    world: World,
    localizer: Localizer,
    flyer: Flyer,
    rng: ChaCha8Rng,
}

fn scene(seed: u64, drift_scale: f64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Scene {
        world: World::new(2500, &mut rng),
        localizer: Localizer::new(LocalizerSettings::default()),
        flyer: Flyer::new(seed + 1000, drift_scale),
        rng,
    }
}

impl Scene {
    fn publish(&mut self, settings: &AnchorSettings) {
        publish_anchor(&self.world, settings, &mut self.localizer, &mut self.rng);
    }

    fn step(&mut self, step: usize) -> AlignmentReport {
        self.flyer.fly_to(step);
        let keyframe = self.flyer.keyframe(&self.world);
        self.localizer.observe_keyframe(&keyframe)
    }

    fn estimate(&self) -> Option<Estimate> {
        self.localizer.estimate(Timestamp::from_nanoseconds(0))
    }

    /// Position error (m) and its squared norm against the stated covariance.
    fn position_error(&self) -> Option<(f64, f64)> {
        let estimate = self.estimate()?;
        let map_from_camera = self.flyer.map_from_camera();
        let pose = estimate.enu_from_camera(&map_from_camera);
        let error = pose.translation() - self.flyer.enu_from_camera.translation();
        let covariance: Matrix3<f64> = estimate.position_covariance(&map_from_camera, None);
        let inverse = covariance.try_inverse()?;
        Some((error.norm(), error.dot(&(inverse * error))))
    }
}

#[test]
fn a_flyer_finds_itself_and_follows_drift() {
    let mut scene = scene(1, 1.0);
    scene.publish(&AnchorSettings::default());
    let mut errors = Vec::new();
    for step in 0..60 {
        let report = scene.step(step);
        assert!(
            step == 0 || report.verdict == Verdict::Accepted,
            "{step}: {report:?}"
        );
        errors.extend(scene.position_error().map(|(error, _)| error));
    }
    assert!(
        errors.len() >= 55,
        "{} keyframes with an estimate",
        errors.len()
    );
    assert_eq!(scene.localizer.jump_count(), 0);
    assert!(errors.iter().all(|error| *error < 0.08));
}

/// Goal: stated position uncertainty is honest. Method: Monte Carlo over worlds, georeference
/// errors and drift; the bounds are those that a mission is judged by, widened for 20 runs.
#[test]
fn stated_uncertainty_is_honest() {
    let (mut inside, mut count, mut sum) = (0, 0, 0.0);
    for seed in 0..20 {
        let mut scene = scene(seed, 1.0);
        scene.publish(&AnchorSettings::default());
        for step in 0..40 {
            scene.step(step);
            if let Some((_, squared)) = scene.position_error() {
                inside += usize::from(squared <= 14.16);
                count += 1;
                sum += squared / 3.0;
            }
        }
    }
    let (share, mean) = (inside as f64 / count as f64, sum / count as f64);
    assert!(share >= 0.97, "{share} inside three sigma");
    assert!(
        (0.2..1.5).contains(&mean),
        "normalised squared error {mean}"
    );
}

/// Keyframes before the anchor's chunks.
const EARLY_COUNT: usize = 8;

/// Goal: what is known in the end is better than what was known then, also where nothing was: the
/// first keyframes come before the anchor's chunks.
#[test]
fn hindsight_is_better_and_reaches_back_before_the_first_landmarks() {
    let (mut then_sum, mut now_sum) = (0.0, 0.0);
    for seed in 0..6 {
        let mut scene = scene(40 + seed, 2.0);
        let mut poses = KeyframePoses::new();
        let mut truth = BTreeMap::new();
        let mut errors_then = BTreeMap::new();
        for step in 0..60 {
            if step == EARLY_COUNT {
                // What all keyframes share, hindsight cannot mend.
                scene.publish(&AnchorSettings {
                    georeference_sigma: [2e-4, 8e-4, 3e-4],
                    ..AnchorSettings::default()
                });
            }
            scene.step(step);
            let newest = scene.localizer.newest.unwrap();
            poses.insert(newest.0, newest.1);
            truth.insert(newest.0, *scene.flyer.enu_from_camera.translation());
            if let Some((error, _)) = scene.position_error() {
                errors_then.insert(newest.0, error);
            }
        }
        let corrected = scene.localizer.corrected_keyframes(&poses);
        let before = scene.localizer.estimate(Timestamp::default()).unwrap();
        let mut early_count = 0;
        for one in &corrected {
            let place = one.enu_from_map.transform_pose(&poses[&one.keyframe]);
            let error = (place.translation() - truth[&one.keyframe]).norm();
            match errors_then.get(&one.keyframe) {
                Some(then) => {
                    then_sum += then * then;
                    now_sum += error * error;
                }
                None => {
                    early_count += 1;
                    assert!(error < 0.08, "{error}");
                }
            }
        }
        assert!(corrected.len() > 50 && early_count >= EARLY_COUNT - 1);
        // Looking back changes nothing.
        let after = scene.localizer.estimate(Timestamp::default()).unwrap();
        assert_eq!(before.enu_from_map, after.enu_from_map);
    }
    println!("hindsight: {:.2} of the error", (now_sum / then_sum).sqrt());
    assert!(now_sum < 0.8 * then_sum, "{now_sum} {then_sum}");
}

/// Goal: no alignment where there is none. Method: the flyer sees another world than the anchor.
#[test]
fn another_world_is_never_aligned() {
    for seed in 0..5 {
        let mut scene = scene(seed, 1.0);
        scene.publish(&AnchorSettings::default());
        scene.world = World::new(2500, &mut ChaCha8Rng::seed_from_u64(seed + 77));
        for step in 0..20 {
            let report = scene.step(step);
            assert!(matches!(report.verdict, Verdict::Refused(_)), "{report:?}");
        }
        assert!(scene.estimate().is_none());
    }
}

/// Goal: a room with the same furniture is another room. Method: a part of the anchor's world looks
/// the same, and the rest does not; with nothing asked about the rest, it is taken for the room.
#[test]
fn a_room_of_the_same_plan_is_not_the_room() {
    let mut was_mistaken = 0;
    for seed in 0..2 {
        for extent_min in [LocalizerSettings::default().agreement_extent_min, 0.0] {
            let mut scene = scene(seed, 1.0);
            scene.localizer = Localizer::new(LocalizerSettings {
                agreement_extent_min: extent_min,
                ..LocalizerSettings::default()
            });
            scene.world = World::new(8000, &mut scene.rng);
            scene.publish(&AnchorSettings::default());
            // A quarter of all cubes of this edge.
            let cube = |along_m: f64| (along_m / 1.2).floor() as i64;
            let looks_alike = |point: &Vector3<f64>| {
                (cube(point.x) + cube(point.y) + cube(point.z)).rem_euclid(4) == 0
            };
            scene.world = scene.world.redecorated(looks_alike, &mut scene.rng);
            (0..12).for_each(|step| drop(scene.step(step)));
            if extent_min > 0.0 {
                assert!(scene.estimate().is_none(), "seed {seed}");
            }
            was_mistaken += usize::from(scene.estimate().is_some());
        }
    }
    assert!(was_mistaken > 0, "the rooms are too different for a test");
}

/// Goal: what is missing speaks against a room. Method: all that the vehicle sees looks as the
/// anchor saw it, and most of what the anchor saw is not there.
#[test]
fn a_room_without_most_of_the_things_is_not_the_room() {
    for seed in 0..2 {
        let mut scene = scene(seed, 1.0);
        scene.world = World::new(8000, &mut scene.rng);
        scene.publish(&AnchorSettings::default());
        let cube = |along_m: f64| (along_m / 0.3).floor() as i64;
        let is_kept = |point: &Vector3<f64>| {
            (cube(point.x) + 2 * cube(point.y) + 3 * cube(point.z)).rem_euclid(6) == 0
        };
        scene.world = scene.world.only(is_kept);
        (0..12).for_each(|step| drop(scene.step(step)));
        assert!(scene.estimate().is_none(), "seed {seed}");
    }
}

/// Goal: a vehicle that was taken in finds out by what it sees next. Method: the anchor has mapped
/// nothing but the furniture that both rooms share, and then the rest of its room.
#[test]
fn what_comes_later_revokes_an_alignment_to_another_room() {
    for seed in 0..2 {
        let mut scene = scene(seed, 1.0);
        let cube = |along_m: f64| (along_m / 1.2).floor() as i64;
        let is_shared = |point: &Vector3<f64>| {
            (cube(point.x) + cube(point.y) + cube(point.z)).rem_euclid(4) == 0
        };
        let room = World::new(8000, &mut scene.rng);
        let other_room = room.furnished_anew(is_shared, &mut scene.rng);
        scene.world = room.only(is_shared);
        scene.publish(&AnchorSettings::default());
        scene.world = other_room;
        (0..4).for_each(|step| drop(scene.step(step)));
        assert!(scene.estimate().is_some(), "seed {seed}: not taken in");
        let seen = std::mem::replace(&mut scene.world, room);
        scene.publish(&AnchorSettings::default());
        scene.world = seen;
        let revoked_at = (4..12).find(|step| scene.step(*step).revoked);
        assert!(revoked_at.is_some(), "seed {seed}: not found out");
        assert_eq!(scene.localizer.overruled_count(), 1, "seed {seed}");
        assert!(scene.estimate().is_none(), "seed {seed}");
        // Nor is it believed again.
        (12..20).for_each(|step| drop(scene.step(step)));
        assert!(scene.estimate().is_none(), "seed {seed}");
    }
}

/// Goal: a strip of the image tells no pose. Method: only a slab of the room looks as the anchor
/// saw it, and nothing is asked about the rest.
#[test]
fn a_strip_of_the_image_is_not_enough() {
    let mut estimate_counts = [0, 0];
    for seed in 0..2 {
        for (count, breadth_min) in estimate_counts.iter_mut().zip([0.08, 0.0]) {
            let mut scene = scene(seed, 1.0);
            scene.localizer = Localizer::new(LocalizerSettings {
                agreement_extent_min: 0.0,
                inlier_breadth_min: breadth_min,
                ..LocalizerSettings::default()
            });
            scene.world = World::new(8000, &mut scene.rng);
            scene.publish(&AnchorSettings::default());
            let in_slab = |point: &Vector3<f64>| point.z.abs() < 0.2;
            scene.world = scene.world.redecorated(in_slab, &mut scene.rng);
            for step in 0..12 {
                scene.step(step);
                *count += usize::from(scene.estimate().is_some());
            }
        }
    }
    let [broad, any] = estimate_counts;
    assert!(broad == 0 && any > 0, "{broad} and {any}");
}

#[test]
fn reasons_are_given_before_anything_is_known() {
    let mut scene = scene(6, 0.0);
    assert_eq!(
        scene.step(0).verdict,
        Verdict::Refused(Refusal::NoLandmarks)
    );
    let mut keyframe = scene.flyer.keyframe(&scene.world);
    keyframe.features[0].position.x = f64::NAN;
    let report = scene.localizer.observe_keyframe(&keyframe);
    assert_eq!(report.verdict, Verdict::Refused(Refusal::BadInput));
    keyframe.features.clear();
    let report = scene.localizer.observe_keyframe(&keyframe);
    assert_eq!(report.verdict, Verdict::Refused(Refusal::BadInput));
    assert_eq!(scene.localizer.refused_input_count(), 2);
}

#[test]
fn malicious_input_is_counted_and_changes_nothing() {
    let mut scene = scene(7, 1.0);
    scene.publish(&AnchorSettings::default());
    let localizer = &mut scene.localizer;
    let landmark_count = localizer.landmark_count();
    let refused_before = localizer.refused_input_count();
    let (anchor, chunk) = (AnchorIdx(0), ChunkIdx(900));
    let landmark = |x: f64, variance: f64| Landmark {
        point_in_chunk: Vector3::new(x, 0.0, 1.0),
        covariance_in_chunk: Matrix3::identity() * variance,
        descriptor: Descriptor::default(),
    };
    let bad = vec![
        landmark(f64::NAN, 1.0),
        landmark(1e30, 1.0),
        landmark(1.0, f64::INFINITY),
        landmark(1.0, -1.0),
    ];
    let intake = localizer.insert_chunk(anchor, chunk, bad);
    assert_eq!((intake.accepted_count, intake.refused_count), (0, 4));
    localizer.insert_chunk(anchor, chunk, Vec::new());
    let intake = localizer.insert_chunk(anchor, chunk, vec![landmark(1.0, 1.0); 100_000]);
    assert!(intake.accepted_count < 5000);
    localizer.remove_chunk(anchor, chunk);
    let far = Similarity::new(1.0, UnitQuaternion::identity(), Vector3::repeat(f64::NAN));
    localizer.place_chunk(anchor, ChunkIdx(0), far);
    localizer.place_anchor(anchor, Similarity::identity(), Matrix7::repeat(f64::NAN), 9);
    localizer.place_anchor(anchor, Similarity::identity(), -Matrix7::identity(), 9);
    assert_eq!(localizer.refused_input_count() - refused_before, 6);
    assert_eq!(localizer.landmark_count(), landmark_count);
    (0..5).for_each(|step| drop(scene.step(step)));
    assert!(scene.position_error().unwrap().0 < 0.08);
}

#[test]
fn a_map_that_started_anew_is_aligned_anew() {
    let mut scene = scene(8, 1.0);
    scene.publish(&AnchorSettings::default());
    (0..10).for_each(|step| drop(scene.step(step)));
    scene.flyer.restart_map();
    scene.localizer.forget_map();
    assert!(scene.estimate().is_none());
    (10..15).for_each(|step| drop(scene.step(step)));
    assert_eq!(scene.localizer.jump_count(), 0);
    assert!(scene.position_error().unwrap().0 < 0.08);
}

#[test]
fn a_new_placement_moves_the_estimate_and_an_old_one_does_not() {
    let mut scene = scene(10, 0.0);
    scene.publish(&AnchorSettings::default());
    (0..10).for_each(|step| drop(scene.step(step)));
    let before = scene.estimate().unwrap().enu_from_map;
    let shift = Vector3::new(0.01, 0.0, 0.0);
    let placement = *scene.localizer.anchors[&AnchorIdx(0)]
        .landmarks
        .placement()
        .unwrap();
    let moved = Similarity::<Enu, Map>::new(
        placement.enu_from_map.scale(),
        *placement.enu_from_map.rotation(),
        placement.enu_from_map.translation() + shift,
    );
    scene
        .localizer
        .place_anchor(AnchorIdx(0), moved, placement.covariance, 0);
    assert_eq!(scene.estimate().unwrap().enu_from_map, before);
    scene
        .localizer
        .place_anchor(AnchorIdx(0), moved, placement.covariance, 2);
    let after = scene.estimate().unwrap().enu_from_map;
    assert!((after.translation() - before.translation() - shift).norm() < 1e-9);
    assert_eq!(scene.localizer.jump_count(), 0);
}

/// Keyframes of the own map, as they were observed.
type FlownKeyframes = Vec<(KeyframeIdx, Transform<Map, Camera>)>;

/// A scene in which the vehicle has flown ten keyframes, and these.
fn flown_scene() -> (Scene, FlownKeyframes) {
    let mut scene = scene(11, 0.0);
    scene.publish(&AnchorSettings::default());
    let mut keyframes = Vec::new();
    for step in 0..10 {
        scene.flyer.fly_to(step);
        let keyframe = scene.flyer.keyframe(&scene.world);
        scene.localizer.observe_keyframe(&keyframe);
        keyframes.push((keyframe.id, keyframe.map_from_camera));
    }
    (scene, keyframes)
}

/// Goal: the alignment follows corrections of the own map. Method: every keyframe is turned about
/// the map's origin, as if the map had been laid anew; the estimate turns back.
#[test]
fn moved_keyframes_move_the_alignment() {
    let (mut scene, keyframes) = flown_scene();
    let before = scene.estimate().unwrap().enu_from_map;
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, -0.01, 0.03));
    let laid_anew = Transform::<Map, Map>::new(turn, Vector3::new(0.1, 0.0, -0.1));
    for (id, map_from_camera) in keyframes {
        scene
            .localizer
            .keyframe_moved(id, &(laid_anew * map_from_camera));
    }
    let expected = before * laid_anew.inverse();
    let after = scene.estimate().unwrap().enu_from_map;
    let difference = (expected.inverse() * after).log();
    assert!(difference.norm() < 1e-9, "{difference}");
}

/// Goal: a loop closure that makes the own map larger leaves the vehicle where it is. Method: all
/// of the own map grows by a third; the alignment shrinks by as much.
#[test]
fn stretched_keyframes_scale_the_alignment() {
    let (mut scene, keyframes) = flown_scene();
    let before = scene.estimate().unwrap().enu_from_map;
    let factor = 4.0 / 3.0;
    for (id, _) in &keyframes {
        scene.localizer.keyframe_stretched(*id, factor);
    }
    let grown = keyframes.into_iter().map(|(id, map_from_camera)| {
        let way = map_from_camera.translation() * factor;
        (id, Transform::new(*map_from_camera.rotation(), way))
    });
    scene.localizer.keyframes_moved(grown);
    let after = scene.estimate().unwrap().enu_from_map;
    let growth = Similarity::<Map, Map>::new(factor, UnitQuaternion::identity(), Vector3::zeros());
    let difference = (before.inverse() * after * growth).log();
    assert!(difference.norm() < 1e-6, "{difference}");
}

#[test]
fn equal_input_gives_equal_estimates() {
    let run = || {
        let mut scene = scene(12, 1.0);
        scene.publish(&votes::honest(0));
        scene.publish(&votes::honest(1));
        (0..10).for_each(|step| drop(scene.step(step)));
        scene.estimate().unwrap()
    };
    let (first, second) = (run(), run());
    assert_eq!(first.enu_from_map, second.enu_from_map);
    assert_eq!(first.covariance, second.covariance);
}

#[test]
fn most_descriptors_may_be_wrong() {
    let mut scene = scene(13, 1.0);
    scene.flyer.wrong_descriptor_share = 0.7;
    scene.publish(&AnchorSettings::default());
    let accepted = (0..20)
        .filter(|step| scene.step(*step).verdict == Verdict::Accepted)
        .count();
    assert!(accepted >= 15, "{accepted} of 20");
    assert!(scene.position_error().unwrap().0 < 0.1);
}

#[test]
fn removing_chunks_does_not_remove_what_was_located_in_them() {
    let mut scene = scene(14, 1.0);
    scene.publish(&AnchorSettings::default());
    (0..5).for_each(|step| drop(scene.step(step)));
    let before = scene.estimate().unwrap().enu_from_map;
    (0..30).for_each(|idx| scene.localizer.remove_chunk(AnchorIdx(0), ChunkIdx(idx)));
    assert_eq!(scene.localizer.landmark_count(), 0);
    assert_eq!(scene.estimate().unwrap().enu_from_map, before);
    scene.localizer.remove_anchor(AnchorIdx(0));
    assert!(scene.estimate().is_none());
}

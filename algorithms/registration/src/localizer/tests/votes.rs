//! Several anchors, of which some lie, move or repeat what others said.

use super::*;

pub fn honest(idx: u32) -> AnchorSettings {
    AnchorSettings {
        idx: AnchorIdx(idx),
        unit_m: 1.0 + 0.5 * f64::from(idx),
        ..AnchorSettings::default()
    }
}

/// By 2 m, 5° and a factor of 1.1.
fn lying(idx: u32) -> AnchorSettings {
    let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, 5_f64.to_radians());
    AnchorSettings {
        lie: Similarity::new(1.1, turn, Vector3::new(1.2, -1.6, 0.0)),
        ..honest(idx)
    }
}

fn fly(scene: &mut Scene, steps: std::ops::Range<usize>) -> usize {
    steps.filter(|step| scene.step(*step).jumped).count()
}

fn left_out(scene: &Scene) -> Vec<AnchorIdx> {
    let left_out = scene.estimate().unwrap().left_out;
    left_out.iter().map(|one| one.anchor).collect()
}

/// Squared position error against the stated covariance, below 99.73 % of χ².
fn is_within_sigma(scene: &Scene) -> bool {
    scene.position_error().unwrap().1 < 14.16
}

fn sigma(scene: &Scene) -> f64 {
    let estimate = scene.estimate().unwrap();
    let covariance = estimate.position_covariance(&scene.flyer.map_from_camera(), None);
    covariance.trace().sqrt()
}

#[test]
fn two_anchors_that_agree_are_both_used() {
    let mut scene = scene(3, 1.0);
    scene.publish(&honest(0));
    scene.publish(&honest(1));
    fly(&mut scene, 0..20);
    let estimate = scene.estimate().unwrap();
    assert_eq!(estimate.anchors, [AnchorIdx(0), AnchorIdx(1)]);
    assert!(!estimate.conflict && estimate.left_out.is_empty());
    assert!(scene.position_error().unwrap().0 < 0.08);
}

#[test]
fn one_honest_and_one_lying_anchor_are_a_conflict_that_covers_both() {
    let mut scene = scene(4, 1.0);
    scene.publish(&honest(0));
    fly(&mut scene, 0..10);
    let sigma_before = sigma(&scene);
    scene.publish(&lying(1));
    fly(&mut scene, 10..20);
    let estimate = scene.estimate().unwrap();
    assert!(estimate.conflict);
    assert_eq!(
        estimate.anchors,
        [AnchorIdx(0)],
        "the one that was trusted stays"
    );
    let lie = estimate.left_out[0];
    assert_eq!(lie.anchor, AnchorIdx(1));
    assert!(
        (lie.turn_rad.to_degrees() - 5.0).abs() < 1.0 && (lie.scale - 1.1).abs() < 0.03,
        "{lie:?}"
    );
    assert!(sigma_before < 0.1 && sigma(&scene) > 0.9 * lie.distance_m);
    assert!(is_within_sigma(&scene));
    // Had the liar come first, the truth would be within the uncertainty too.
    let covariance = estimate.position_covariance(&scene.flyer.map_from_camera(), None);
    let map_from_camera = scene.flyer.map_from_camera();
    let own = estimate.enu_from_camera(&map_from_camera);
    let truth = scene.flyer.enu_from_camera.translation();
    let told = lying(1).lie * *truth;
    let error = told - own.translation();
    assert!(error.dot(&(covariance.try_inverse().unwrap() * error)) < 14.16);
}

#[test]
fn two_honest_anchors_overrule_a_lying_one_and_name_it() {
    let mut scene = scene(5, 1.0);
    scene.publish(&lying(0));
    scene.publish(&honest(1));
    scene.publish(&honest(2));
    // Until two honest ones are located too, nobody can know.
    fly(&mut scene, 0..8);
    for step in 8..30 {
        scene.step(step);
        assert!(is_within_sigma(&scene), "{step}");
        assert_eq!(left_out(&scene), [AnchorIdx(0)]);
    }
    let estimate = scene.estimate().unwrap();
    assert!(!estimate.conflict);
    assert_eq!(estimate.anchors, [AnchorIdx(1), AnchorIdx(2)]);
    assert_eq!(left_out(&scene), [AnchorIdx(0)]);
    assert!(scene.position_error().unwrap().0 < 0.1);
}

/// Goal: a vehicle that begins a new map, and until then goes by single frames, does not believe
/// the liar again.
#[test]
fn who_was_overruled_stays_so_while_there_is_no_estimate() {
    let mut scene = scene(5, 1.0);
    scene.publish(&lying(0));
    scene.publish(&honest(1));
    scene.publish(&honest(2));
    fly(&mut scene, 0..30);
    scene.localizer.forget_map();
    assert!(scene.estimate().is_none());
    let believed = scene.localizer.believed_anchors();
    assert_eq!(believed, [AnchorIdx(1), AnchorIdx(2)]);
}

/// Goal: the way from a lie to the truth is counted, though the conflict in between has made the
/// stated uncertainty large enough to explain it.
#[test]
fn leaving_a_liar_is_a_jump() {
    let mut scene = scene(5, 1.0);
    scene.publish(&lying(0));
    assert_eq!(fly(&mut scene, 0..8), 0);
    assert_eq!(scene.estimate().unwrap().anchors, [AnchorIdx(0)]);
    scene.publish(&honest(1));
    fly(&mut scene, 8..16);
    assert!(scene.estimate().unwrap().conflict);
    scene.publish(&honest(2));
    fly(&mut scene, 16..24);
    assert_eq!(
        scene.estimate().unwrap().anchors,
        [AnchorIdx(1), AnchorIdx(2)]
    );
    assert_eq!(scene.localizer.jump_count(), 1);
    assert!(is_within_sigma(&scene));
}

/// Goal: one anchor has one vote, however many maps it has published. Method: two epochs of a
/// liar against one honest anchor.
#[test]
fn two_maps_of_one_owner_do_not_overrule_another() {
    let mut scene = scene(4, 1.0);
    scene.publish(&honest(2));
    fly(&mut scene, 0..5);
    for idx in [0, 1] {
        scene.publish(&lying(idx));
        let (owner, fixed) = (OwnerIdx(77), Reference::Fixed);
        scene.localizer.set_reference(AnchorIdx(idx), owner, fixed);
    }
    fly(&mut scene, 5..20);
    let estimate = scene.estimate().unwrap();
    assert!(estimate.conflict);
    assert_eq!(estimate.anchors, [AnchorIdx(2)]);
}

/// Goal: the georeference of an owner counts once. Method: an anchor's map, and the same again as
/// a second epoch: the estimate is no more certain, as it is with another anchor's.
#[test]
fn a_second_epoch_of_an_anchor_adds_no_certainty() {
    let sigma_with = |owner_of_second: u32| {
        let mut scene = scene(6, 1.0);
        for (idx, owner) in [(0, 0), (1, owner_of_second)] {
            scene.publish(&AnchorSettings {
                georeference_sigma: [0.004, 0.03, 0.005],
                ..honest(idx)
            });
            let owner = OwnerIdx(owner);
            scene
                .localizer
                .set_reference(AnchorIdx(idx), owner, Reference::Fixed);
        }
        fly(&mut scene, 0..15);
        (sigma(&scene), scene.estimate().unwrap().anchors.len())
    };
    let (same, same_count) = sigma_with(0);
    let (other, other_count) = sigma_with(1);
    assert_eq!((same_count, other_count), (1, 2));
    assert!(other < 0.85 * same, "{same} {other}");
}

#[test]
fn a_registered_map_neither_votes_nor_adds_certainty() {
    let mut scene = scene(4, 1.0);
    scene.publish(&honest(0));
    fly(&mut scene, 0..10);
    let before = sigma(&scene);
    for idx in [1, 2] {
        scene.publish(&lying(idx));
        let registered = Reference::Registered;
        scene
            .localizer
            .set_reference(AnchorIdx(idx), OwnerIdx(idx), registered);
    }
    fly(&mut scene, 10..20);
    let estimate = scene.estimate().unwrap();
    assert!(!estimate.conflict);
    assert_eq!(
        (estimate.anchors, estimate.reference),
        (vec![AnchorIdx(0)], Reference::Fixed)
    );
    assert!((0.5..2.0).contains(&(sigma(&scene) / before)));
    assert!(scene.position_error().unwrap().0 < 0.08);
}

/// Goal: where nothing else is known, registered maps give a place, no more certain than they say
/// they are, and two of them no more than one.
#[test]
fn registered_maps_alone_give_a_place_as_certain_as_the_better_of_them() {
    let georeference_sigma = [0.004, 0.03, 0.005];
    let mut sigmas = Vec::new();
    for count in [1, 2] {
        let mut scene = scene(6, 1.0);
        for idx in 0..count {
            scene.publish(&AnchorSettings {
                georeference_sigma,
                ..honest(idx)
            });
            let registered = Reference::Registered;
            scene
                .localizer
                .set_reference(AnchorIdx(idx), OwnerIdx(idx), registered);
        }
        fly(&mut scene, 0..30);
        let estimate = scene.estimate().unwrap();
        assert_eq!(estimate.reference, Reference::Registered);
        assert_eq!(estimate.anchors.len(), 1);
        assert!(is_within_sigma(&scene));
        sigmas.push(sigma(&scene));
    }
    // Three axes of the least that the map says of its own place: 0.03 of its unit of 1 m.
    let stated = 0.03 * 3_f64.sqrt();
    assert!(sigmas.iter().all(|sigma| *sigma >= stated), "{sigmas:?}");
    assert!(sigmas[1] > 0.95 * sigmas[0], "{sigmas:?}");
}

#[test]
fn maps_out_of_sight_do_not_starve_registered_ones() {
    let mut scene = scene(6, 1.0);
    let elsewhere = World::new(2500, &mut scene.rng);
    for idx in 0..2 {
        publish_anchor(
            &elsewhere,
            &honest(idx),
            &mut scene.localizer,
            &mut scene.rng,
        );
    }
    scene.publish(&honest(2));
    scene
        .localizer
        .set_reference(AnchorIdx(2), OwnerIdx(2), Reference::Registered);
    fly(&mut scene, 0..10);
    assert_eq!(scene.estimate().unwrap().anchors, [AnchorIdx(2)]);
}

#[test]
fn what_rests_on_the_own_map_is_not_used() {
    let mut scene = scene(6, 1.0);
    scene.publish(&honest(0));
    let (idx, owner) = (AnchorIdx(0), OwnerIdx(0));
    scene
        .localizer
        .set_reference(idx, owner, Reference::Registered);
    fly(&mut scene, 0..5);
    assert!(scene.estimate().is_some());
    scene
        .localizer
        .set_reference(idx, owner, Reference::Circular);
    assert!(scene.estimate().is_none());
    assert_eq!(
        scene.step(5).verdict,
        Verdict::Refused(Refusal::NoLandmarks)
    );
}

/// Goal: an anchor that corrects itself takes the vehicle along, and the way is counted.
#[test]
fn an_anchor_that_corrects_itself_by_a_metre_is_followed() {
    let mut scene = scene(10, 1.0);
    scene.publish(&AnchorSettings {
        lie: Similarity::new(1.0, UnitQuaternion::identity(), Vector3::x()),
        ..honest(0)
    });
    fly(&mut scene, 0..10);
    let before = scene.position_error().unwrap().0;
    assert!((0.9..1.1).contains(&before), "{before}");
    scene.publish(&AnchorSettings {
        revision: 2,
        ..honest(0)
    });
    let estimate = scene.estimate().unwrap();
    assert_eq!(
        (scene.localizer.jump_count(), estimate.conflict),
        (1, false)
    );
    assert!(scene.position_error().unwrap().0 < 0.08);
    assert_eq!(fly(&mut scene, 10..20), 0);
    assert!(is_within_sigma(&scene));
}

/// Goal: a wrong alignment is overruled, and the jump counted. Method: the own map changes
/// without a word, which makes the alignment wrong.
#[test]
fn a_wrong_alignment_is_overruled_and_the_jump_counted() {
    let mut scene = scene(9, 1.0);
    scene.publish(&AnchorSettings::default());
    fly(&mut scene, 0..10);
    scene.flyer.restart_map();
    assert_eq!(fly(&mut scene, 10..30), 1);
    let counts = |scene: &Scene| {
        let localizer = &scene.localizer;
        (localizer.jump_count(), localizer.overruled_count())
    };
    assert_eq!(counts(&scene), (1, 1));
    assert!(scene.position_error().unwrap().0 < 0.08);
    // What was counted stays counted in the next map, before and after it has a place.
    scene.localizer.forget_map();
    assert!(scene.estimate().is_none());
    assert_eq!(counts(&scene), (1, 1));
}

/// Keyframes from the first that does not fit until the right place is believed: three misses,
/// then every second one is sought everywhere until three agree, and one that may fail.
const RECOVERY_KEYFRAME_COUNT: usize = 12;

/// Goal: a vehicle that was taken in by a thing that stands twice finds out, soon, and says so.
/// Method: the anchor has mapped the west wall alone while the vehicle sees the east wall, which
/// looks the same; then the rest of the map comes.
#[test]
fn an_alignment_to_the_wrong_of_two_like_walls_is_overruled() {
    for seed in 0..5 {
        let mut scene = scene(20 + seed, 1.0);
        scene.world.repeat_east_in_the_west();
        scene.publish(&AnchorSettings {
            chunks: 14..17,
            ..honest(0)
        });
        fly(&mut scene, 0..4);
        let taken_in = scene.position_error().map(|(error, _)| error);
        assert!(taken_in > Some(1.0), "{seed}: {taken_in:?}");
        scene.publish(&honest(0));
        // As long as nothing but the wall is in view, nobody can know.
        let (mut misfit_at, mut revoked) = (None, false);
        let found_at = (4..60).find(|step| {
            let report = scene.step(*step);
            if report.verdict != Verdict::Accepted {
                misfit_at.get_or_insert(*step);
            }
            revoked |= report.revoked;
            // What is given up makes place for what comes next.
            report.overruled || (revoked && scene.estimate().is_some())
        });
        let found_at = found_at.unwrap_or_else(|| panic!("{seed}: not found out"));
        println!("misfit at {misfit_at:?}, overruled at {found_at}");
        let limit = misfit_at.unwrap() + RECOVERY_KEYFRAME_COUNT;
        assert!(found_at < limit, "{seed}: {misfit_at:?} {found_at}");
        assert_eq!(scene.localizer.overruled_count(), 1);
        assert_eq!(scene.localizer.jump_count(), u64::from(!revoked));
        assert!(scene.position_error().unwrap().0 < 0.1, "{seed}");
    }
}

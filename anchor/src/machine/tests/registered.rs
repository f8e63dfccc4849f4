//! A vehicle without fixes shares its map as what it is.

use std::collections::BTreeMap;

use geometry::{Camera, Chunk, Enu, Map, Matrix7, Similarity};
use nalgebra::UnitQuaternion;
use protocol::{PROVENANCE_COUNT_MAX, Reference};

use super::*;
use crate::georeference::PlacedKeyframe;
use crate::{Georeference, Registration};

/// The map drifts: each keyframe stands 2 cm farther from where the map says than the one before.
fn place(pose: &KeyframePose) -> Similarity<Enu, Camera> {
    let drift = Vector3::x() * 0.02 * f64::from(pose.id.0);
    Similarity::<Enu, Map>::new(1.0, UnitQuaternion::identity(), drift)
        * Similarity::from(pose.map_from_camera)
}

fn registration(poses: &[KeyframePose], sources: &[&str]) -> Registration {
    let enu_from_map = Similarity::identity();
    let placed = poses.iter().map(|pose| {
        let placed = PlacedKeyframe {
            enu_from_camera: place(pose),
            covariance: Matrix7::identity() * 1e-4,
        };
        (pose.id, placed)
    });
    Registration {
        datum: Datum::site("lab").unwrap(),
        georeference: Georeference {
            enu_from_map,
            covariance: Matrix7::identity() * 1e-4,
            keyframes: placed.collect::<BTreeMap<_, _>>(),
            fix_sigma_m: 0.02,
            outlier_count: 0,
            fix_count: 0,
            drift_factor: 1.0,
            newest_fix_at: poses.last().unwrap().captured_at,
        },
        provenance: sources
            .iter()
            .map(|one| VehicleId::new(one).unwrap())
            .collect(),
    }
}

/// Hands on the events, and brings the keyframes that are asked for.
fn drive(anchor: &mut Anchor, mut events: Vec<Event>, now: Timestamp) -> Vec<Effect> {
    let mut all = Vec::new();
    while !events.is_empty() {
        for effect in anchor.handle(events.remove(0), now) {
            if let Effect::RequestKeyframe(id) = effect {
                let pose = *poses().iter().find(|pose| pose.id == id).unwrap();
                events.push(Event::KeyframeSettled(keyframe_input(pose, 100)));
            }
            all.push(effect);
        }
    }
    all
}

fn frames() -> Vec<Frame> {
    fly(straight, 20.0, &TYPICAL_DRIFT, 5)
}

fn poses() -> Vec<KeyframePose> {
    frames().iter().filter_map(Frame::keyframe_pose).collect()
}

/// Flies, and knows where it is from the middle on, at first of all keyframes and then of the
/// newest; the effects with their times, and when it knew.
fn share(anchor: &mut Anchor, sources: &[&str]) -> (Vec<(Timestamp, Effect)>, Timestamp) {
    let frames = frames();
    let known_at = frames[frames.len() / 2].captured_at;
    let (mut poses, mut all) = (Vec::new(), Vec::new());
    let mut knew = false;
    for frame in &frames {
        let now = frame.captured_at;
        let mut events = Vec::new();
        let new_pose = frame.keyframe_pose();
        poses.extend(new_pose);
        if now >= known_at && new_pose.is_some() {
            let first = if knew {
                poses.len().saturating_sub(12)
            } else {
                0
            };
            knew = true;
            let registration = Box::new(registration(&poses[first..], sources));
            events.push(Event::Registered(Some(registration)));
        }
        events.extend(new_pose.map(Event::KeyframeInserted));
        events.push(Event::Tick);
        let effects = drive(anchor, events, now);
        all.extend(effects.into_iter().map(|effect| (now, effect)));
    }
    (all, known_at)
}

/// Where chunks stand by what was published, and when they were captured.
fn places<'a>(
    effects: impl Iterator<Item = &'a Effect>,
) -> Vec<(Timestamp, Similarity<Enu, Chunk>)> {
    let mut enu_from_map = Similarity::identity();
    let mut chunks = BTreeMap::new();
    let mut places = BTreeMap::new();
    for effect in effects {
        match effect {
            Effect::PublishPlacement(one) => enu_from_map = one.enu_from_map,
            Effect::PublishPage(page) => {
                let placements = page.placements();
                places.extend(placements.map(|one| (one.number, one.map_from_chunk)));
            }
            Effect::PublishChunk { chunk, .. } => {
                chunks.insert(chunk.id().number, chunk.header().captured_at);
            }
            _ => {}
        }
    }
    let placed = chunks.into_iter();
    let placed = placed.map(|(number, at)| (at, enu_from_map * places[&number]));
    placed.collect()
}

/// Goal: all that is shared stands where its keyframe was placed, also what is cut after the last
/// word of it. Method: the vehicle stops, and nothing but time passes.
#[test]
fn the_last_keyframes_before_a_stop_stand_where_they_were_placed() {
    let mut anchor = Anchor::registered(settings(), EPOCH);
    let (effects, _) = share(&mut anchor, &["ugv1"]);
    let mut effects: Vec<Effect> = effects.into_iter().map(|(_, effect)| effect).collect();
    let stopped_at = frames().last().unwrap().captured_at;
    for step in 1..60 {
        let now = stopped_at.after(std::time::Duration::from_millis(100 * step));
        effects.extend(drive(&mut anchor, vec![Event::Tick], now));
    }
    let poses = poses();
    let places = places(effects.iter());
    let newest = places.last().map(|(at, _)| *at);
    assert_eq!(newest, poses.last().map(|pose| pose.captured_at));
    for (captured_at, enu_from_chunk) in places {
        let pose = poses.iter().find(|pose| pose.captured_at == captured_at);
        let expected = place(pose.unwrap());
        let error_m = (enu_from_chunk.translation() - expected.translation()).norm();
        // Half a standard deviation of 2 cm is not worth a message.
        assert!(error_m < 0.02, "{captured_at:?}: {error_m}");
    }
}

/// Goal: what is cut in the last moment is placed before it is said that nobody knows any more.
#[test]
fn chunks_are_placed_before_the_place_is_lost() {
    let mut anchor = Anchor::registered(settings(), EPOCH);
    let poses = &poses()[20..22];
    let now = poses[1].captured_at;
    let known = || Event::Registered(Some(Box::new(registration(poses, &["ugv1"]))));
    let inserted = poses.iter().copied().map(Event::KeyframeInserted);
    let mut effects = drive(
        &mut anchor,
        [known()].into_iter().chain(inserted).collect(),
        now,
    );
    let later = now.after(std::time::Duration::from_millis(100));
    for pose in poses {
        let settled = Event::KeyframeSettled(keyframe_input(*pose, 100));
        effects.extend(anchor.handle(settled, later));
    }
    effects.extend(anchor.handle(Event::Registered(None), later));
    let places = places(effects.iter());
    assert_eq!(places.len(), 2);
    for ((_, enu_from_chunk), pose) in places.iter().zip(poses) {
        let error = enu_from_chunk.translation() - place(pose).translation();
        assert!(error.norm() < 0.02, "{error}");
    }
}

/// Goal: nothing is shared of which nobody has said where it is.
#[test]
fn keyframes_without_a_place_are_not_shared() {
    let mut anchor = Anchor::registered(settings(), EPOCH);
    let poses = &poses()[..6];
    let now = poses[5].captured_at;
    let inserted = poses.iter().copied().map(Event::KeyframeInserted);
    drive(&mut anchor, inserted.collect(), now);
    let known = Event::Registered(Some(Box::new(registration(&poses[4..], &["ugv1"]))));
    drive(&mut anchor, vec![known], now);
    let later = now.after(std::time::Duration::from_secs(3));
    let effects = drive(&mut anchor, vec![Event::Tick], later);
    let chunks = effects.iter().filter_map(|effect| match effect {
        Effect::PublishChunk { chunk, .. } => Some(chunk.header().captured_at),
        _ => None,
    });
    let expected: Vec<Timestamp> = poses[4..].iter().map(|pose| pose.captured_at).collect();
    assert_eq!(chunks.collect::<Vec<_>>(), expected);
}

#[test]
fn what_is_shared_names_what_it_rests_on_and_only_while_it_stands_somewhere() {
    let mut settings = settings();
    settings.datum = None;
    let mut anchor = Anchor::registered(settings, EPOCH);
    let (effects, known_at) = share(&mut anchor, &["ugv1"]);
    let source = [VehicleId::new("ugv1").unwrap()];
    let (mut chunk_count, mut placement_count, mut manifest_count) = (0, 0, 0);
    for (at, effect) in &effects {
        let (reference, provenance) = match effect {
            Effect::PublishChunk { chunk, .. } => {
                chunk_count += 1;
                (chunk.header().reference, &chunk.header().provenance)
            }
            Effect::PublishPlacement(one) => {
                placement_count += 1;
                (one.reference, &one.provenance)
            }
            Effect::PublishManifest(one) => {
                manifest_count += 1;
                (one.reference, &one.provenance)
            }
            _ => continue,
        };
        assert!(*at >= known_at);
        assert_eq!(
            (reference, &provenance[..]),
            (Reference::Registered, &source[..])
        );
    }
    assert!(chunk_count > 10 && placement_count > 0 && manifest_count > 0);
    // No longer global: nothing more is cut.
    let later = effects
        .last()
        .unwrap()
        .0
        .after(std::time::Duration::from_secs(5));
    anchor.handle(Event::Registered(None), later);
    assert_eq!(anchor.state().0, VehicleState::GlobalStale);
    let pose = fly(straight, 20.0, &TYPICAL_DRIFT, 5);
    let pose = pose.iter().rev().find_map(Frame::keyframe_pose).unwrap();
    let pose = KeyframePose {
        id: KeyframeId(9999),
        ..pose
    };
    let mut after = anchor.handle(Event::KeyframeInserted(pose), later);
    after.extend(anchor.handle(Event::KeyframeSettled(keyframe_input(pose, 100)), later));
    let is_chunk = |effect: &Effect| matches!(effect, Effect::PublishChunk { .. });
    assert!(!after.iter().any(is_chunk));
}

#[test]
fn what_cannot_name_its_sources_is_not_shared() {
    let names: Vec<String> = (0..=PROVENANCE_COUNT_MAX)
        .map(|idx| format!("ugv{idx}"))
        .collect();
    let all: Vec<&str> = names.iter().map(String::as_str).collect();
    for sources in [&all[..0], &all[..]] {
        let mut anchor = Anchor::registered(settings(), EPOCH);
        let (effects, _) = share(&mut anchor, sources);
        let says_nothing = |(_, effect): &(Timestamp, Effect)| {
            !matches!(
                effect,
                Effect::PublishChunk { .. } | Effect::PublishPlacement(_)
            )
        };
        assert!(effects.iter().all(says_nothing));
    }
}

/// Goal: a keyframe that falls due just when a loop closure stretches the map is shared once it is
/// known anew where it stands, and is not asked for meanwhile. Method: time passes between the
/// stretch and the next word of the place, and a keyframe that was on its way comes.
#[test]
fn what_falls_due_while_the_map_stretches_is_shared_later() {
    let mut anchor = Anchor::registered(settings(), EPOCH);
    let poses = &poses()[20..24];
    let now = poses[3].captured_at;
    let known = || Event::Registered(Some(Box::new(registration(poses, &["ugv1"]))));
    let settled = |pose: KeyframePose| Event::KeyframeSettled(keyframe_input(pose, 100));
    let inserted = poses.iter().copied().map(Event::KeyframeInserted);
    let mut events: Vec<Event> = [known()].into_iter().chain(inserted).collect();
    events.push(settled(poses[0]));
    let is_chunk = |effect: &Effect| matches!(effect, Effect::PublishChunk { .. });
    let chunk_count = |effects: &[Effect]| effects.iter().filter(|one| is_chunk(one)).count();
    assert_eq!(chunk_count(&drive(&mut anchor, events, now)), 1);

    let stretched = poses.iter().map(|pose| KeyframePose {
        unit: pose.unit * 1.1,
        ..*pose
    });
    let moved = Event::KeyframesMoved(stretched.collect());
    let effects = drive(&mut anchor, vec![moved, settled(poses[3])], now);
    assert_eq!(chunk_count(&effects), 0);
    let after = |tenths: u64| now.after(std::time::Duration::from_millis(100 * tenths));
    for tenths in 1..40 {
        let effects = anchor.handle(Event::Tick, after(tenths));
        let asks = |effect: &Effect| matches!(effect, Effect::RequestKeyframe(_));
        assert!(!effects.iter().any(|one| asks(one) || is_chunk(one)));
    }
    let effects = drive(&mut anchor, vec![known()], after(40));
    assert_eq!(chunk_count(&effects), poses.len() - 1);
    let effects = drive(&mut anchor, vec![known()], after(41));
    assert_eq!(chunk_count(&effects), 0, "each is shared once");
}

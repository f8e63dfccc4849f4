//! A vehicle without fixes shares its map as what it is.

use std::collections::BTreeMap;

use geometry::{Matrix7, Similarity};
use protocol::{PROVENANCE_COUNT_MAX, Reference};

use super::*;
use crate::georeference::PlacedKeyframe;
use crate::{Georeference, Registration};

fn registration(frames: &[Frame], sources: &[&str]) -> Registration {
    let enu_from_map = Similarity::identity();
    let poses = frames.iter().filter_map(Frame::keyframe_pose);
    let placed = poses.map(|pose| {
        let placed = PlacedKeyframe {
            enu_from_camera: enu_from_map * Similarity::from(pose.map_from_camera),
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
            newest_fix_at: frames.last().unwrap().captured_at,
        },
        provenance: sources
            .iter()
            .map(|one| VehicleId::new(one).unwrap())
            .collect(),
    }
}

/// Flies, and knows where it is from the middle on; the effects with their times, and when it knew.
fn share(anchor: &mut Anchor, sources: &[&str]) -> (Vec<(Timestamp, Effect)>, Timestamp) {
    let frames = fly(straight, 20.0, &TYPICAL_DRIFT, 5);
    let poses: Vec<KeyframePose> = frames.iter().filter_map(Frame::keyframe_pose).collect();
    let known_at = frames[frames.len() / 2].captured_at;
    let mut all = Vec::new();
    for frame in &frames {
        let now = frame.captured_at;
        let mut events = Vec::new();
        if now == known_at {
            let registration = Box::new(registration(&frames, sources));
            events.push(Event::Registered(Some(registration)));
        }
        events.extend(frame.keyframe_pose().map(Event::KeyframeInserted));
        events.push(Event::Tick);
        while !events.is_empty() {
            for effect in anchor.handle(events.remove(0), now) {
                if let Effect::RequestKeyframe(id) = effect {
                    let pose = *poses.iter().find(|pose| pose.id == id).unwrap();
                    events.push(Event::KeyframeSettled(keyframe_input(pose, 100)));
                }
                all.push((now, effect));
            }
        }
    }
    (all, known_at)
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

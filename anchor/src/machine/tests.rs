//! The state machine over simulated flights.

mod loop_closure;
mod registered;

use geodesy::{Datum, Geodetic};
use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};
use protocol::{ChunkCamera, Epoch, VehicleId, VehicleState, decode, encode};
use vslam::{KeyframeId, PointId};

use super::{Anchor, Effect, Event};
use crate::simulation::{Frame, Normal, TYPICAL_DRIFT, at, fly, straight, with_a_turn};
use crate::{AnchorSettings, FixPosition, KeyframeInput, KeyframePose, PointInput};

const EPOCH: Epoch = Epoch {
    counter: 1,
    random: 0x9f3c_21ab,
};

fn settings() -> AnchorSettings {
    let camera = ChunkCamera {
        focal_length_px: 480.0,
        width_px: 640,
        height_px: 360,
    };
    let mut settings = AnchorSettings::new(VehicleId::new("ugv1").unwrap(), camera);
    settings.datum = Some(Datum::site("lab").unwrap());
    settings
}

/// Points ahead of a keyframe, each new.
fn keyframe_input(pose: KeyframePose, point_count: u32) -> KeyframeInput {
    let points = (0..point_count).map(|idx| {
        let share = f64::from(idx) / f64::from(point_count);
        let point = Vector3::new(share - 0.5, 0.3 * (9.0 * share).sin(), 1.0 + share);
        PointInput {
            id: PointId(pose.id.0 * 10_000 + idx),
            position_in_map: pose.map_from_camera * point,
            covariance_in_map: Matrix3::identity() * 1e-4,
            descriptor: [idx as u8; 32],
            view_count: 4,
            parallax_rad: 0.1,
        }
    });
    KeyframeInput {
        points: points.collect(),
        pose,
    }
}

/// Flies the frames and answers every request; the effects with the time at which they came.
fn run(anchor: &mut Anchor, frames: &[Frame], fix_sigma_m: f64) -> Vec<(Timestamp, Effect)> {
    let mut normal = Normal::new(11);
    let mut all = Vec::new();
    for frame in frames {
        let now = frame.captured_at;
        let mut events = vec![Event::Fix(frame.fix(fix_sigma_m, &mut normal))];
        events.extend(frame.keyframe_pose().map(Event::KeyframeInserted));
        events.push(Event::Frame(frame.input()));
        while !events.is_empty() {
            for effect in anchor.handle(events.remove(0), now) {
                if let Effect::RequestKeyframe(id) = effect {
                    let pose = frames.iter().filter_map(Frame::keyframe_pose);
                    let pose = pose.into_iter().find(|pose| pose.id == id).unwrap();
                    events.push(Event::KeyframeSettled(keyframe_input(pose, 100)));
                }
                all.push((now, effect));
            }
        }
    }
    all
}

#[test]
fn a_flight_with_a_turn_becomes_global_and_places_its_chunks() {
    let frames = fly(with_a_turn, 20.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let mut effects = run(&mut anchor, &frames, 0.02);
    assert_eq!(anchor.state().0, VehicleState::Global);
    let later = frames
        .last()
        .unwrap()
        .captured_at
        .after(std::time::Duration::from_secs(1));
    effects.extend(
        anchor
            .handle(Event::Tick, later)
            .into_iter()
            .map(|one| (later, one)),
    );

    // A receiver that applies what was published finds every chunk where it is.
    let mut placement = None;
    let mut places = std::collections::BTreeMap::new();
    let mut chunks = Vec::new();
    let (mut placement_bytes, mut page_bytes, mut chunk_bytes) = (0, 0, 0);
    for (_, effect) in &effects {
        match effect {
            Effect::PublishPlacement(one) => {
                placement_bytes += encode(one).len();
                placement = Some(decode::<protocol::Placement>(&encode(one)).unwrap());
            }
            Effect::PublishPage(page) => {
                page_bytes += encode(page).len();
                let page: protocol::PlacementPage = decode(&encode(page)).unwrap();
                places.extend(
                    page.placements()
                        .map(|one| (one.number, one.map_from_chunk)),
                );
            }
            Effect::PublishChunk { chunk, bytes } => {
                chunk_bytes += bytes.len();
                assert_eq!(decode::<protocol::Chunk>(bytes).unwrap(), *chunk);
                chunks.push(chunk.clone());
            }
            _ => {}
        }
    }
    let enu_from_map = placement.unwrap().enu_from_map;
    let mut squared = 0.0;
    for chunk in &chunks {
        let captured_at = chunk.header().captured_at;
        let frame = frames
            .iter()
            .find(|frame| frame.captured_at == captured_at)
            .unwrap();
        let enu_from_chunk = enu_from_map * places[&chunk.id().number];
        let point = chunk.points().nth(50).unwrap().position_in_chunk;
        let truth = frame.enu_from_camera * (point * frame.scale_m);
        squared += (enu_from_chunk * point - truth).norm_squared();
    }
    let rms_m = (squared / chunks.len() as f64).sqrt();
    println!("{} chunks {chunk_bytes} B, rms {rms_m:.4} m", chunks.len());
    println!("placements {placement_bytes} B, pages {page_bytes} B");
    // The bound of the georeference's own test plus half a sigma that is not worth a message.
    assert!(chunks.len() >= 60 && rms_m < 0.05, "{rms_m}");
}

#[test]
fn a_straight_path_stays_unscaled_and_says_so() {
    let frames = fly(straight, 12.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let effects = run(&mut anchor, &frames, 0.02);
    assert_eq!(
        anchor.state(),
        (VehicleState::LocalUnscaled, "straight path")
    );
    assert!(
        !effects
            .iter()
            .any(|(_, one)| matches!(one, Effect::PublishPlacement(_)))
    );
    assert!(
        effects
            .iter()
            .any(|(_, one)| matches!(one, Effect::PublishChunk { .. }))
    );
}

#[test]
fn keyframes_are_cut_at_the_latest_after_their_time() {
    let frames = fly(with_a_turn, 6.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    for (now, effect) in run(&mut anchor, &frames, 0.02) {
        if let Effect::PublishChunk { chunk, .. } = effect {
            let delay_s = now - chunk.header().captured_at;
            assert!((1.49..1.65).contains(&delay_s), "{delay_s}");
        }
    }
    assert!(anchor.counts().chunks_cut > 10);

    // Ten newer keyframes at once, without a second passing.
    let mut anchor = Anchor::new(settings(), EPOCH);
    let poses = frames.iter().filter_map(Frame::keyframe_pose).take(12);
    let effects: Vec<Effect> = poses
        .flat_map(|pose| anchor.handle(Event::KeyframeInserted(pose), at(0.1)))
        .collect();
    let requested = |effect: &Effect| matches!(effect, Effect::RequestKeyframe(_));
    assert_eq!(effects.iter().filter(|effect| requested(effect)).count(), 2);
}

#[test]
fn placements_come_at_most_once_a_second() {
    let frames = fly(with_a_turn, 20.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let effects = run(&mut anchor, &frames, 0.02);
    let times: Vec<Timestamp> = effects
        .iter()
        .filter(|(_, effect)| matches!(effect, Effect::PublishPlacement(_)))
        .map(|(now, _)| *now)
        .collect();
    assert!(times.len() >= 2);
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] > 0.99));
}

#[test]
fn the_first_placement_does_not_wait_for_its_turn() {
    let frames = fly(with_a_turn, 20.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let effects = run(&mut anchor, &frames, 0.02);
    let at = |wanted: fn(&Effect) -> bool| effects.iter().find(|(_, effect)| wanted(effect));
    let global = at(|effect| match effect {
        Effect::StateChanged { state, .. } => *state == VehicleState::Global,
        _ => false,
    });
    let placed = at(|effect| matches!(effect, Effect::PublishPlacement(_)));
    assert_eq!(global.unwrap().0, placed.unwrap().0);
}

fn settled(anchor: &mut Anchor, input: KeyframeInput) -> Vec<(protocol::Chunk, Vec<u8>)> {
    let now = input.pose.captured_at;
    anchor.handle(Event::KeyframeInserted(input.pose), now);
    chunks(anchor.handle(Event::KeyframeSettled(input), now))
}

fn chunks(effects: Vec<Effect>) -> Vec<(protocol::Chunk, Vec<u8>)> {
    let chunk = |effect| match effect {
        Effect::PublishChunk { chunk, bytes } => Some((chunk, bytes)),
        _ => None,
    };
    effects.into_iter().filter_map(chunk).collect()
}

#[test]
fn chunks_are_frozen_and_replaced_when_their_points_move() {
    let frames = fly(with_a_turn, 2.0, &TYPICAL_DRIFT, 3);
    let pose = frames[6].keyframe_pose().unwrap();
    let mut anchor = Anchor::new(settings(), EPOCH);
    let first = settled(&mut anchor, keyframe_input(pose, 80));
    assert_eq!(first.len(), 1);

    // The whole keyframe moves: its points keep their places in the chunk.
    let mut moved = pose;
    moved.map_from_camera = pose.map_from_camera * frames[0].map_from_camera.relabel();
    anchor.handle(Event::KeyframesMoved(vec![moved]), at(2.0));
    let again = anchor.handle(Event::KeyframeSettled(keyframe_input(moved, 80)), at(2.0));
    assert!(chunks(again).is_empty());

    // The points move within the keyframe: a new chunk names the old one.
    let mut bent = keyframe_input(moved, 80);
    for point in &mut bent.points {
        point.position_in_map += Vector3::new(0.1, 0.1, 0.1);
    }
    let second = chunks(anchor.handle(Event::KeyframeSettled(bent), at(3.0)));
    assert_eq!(second.len(), 1);
    assert_eq!(second[0].0.header().replaces, vec![first[0].0.id().number]);
    assert_eq!(anchor.counts().chunks_replaced, 1);
}

#[test]
fn a_point_is_in_one_chunk_only() {
    let frames = fly(with_a_turn, 2.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let first = keyframe_input(frames[0].keyframe_pose().unwrap(), 80);
    let mut second = keyframe_input(frames[6].keyframe_pose().unwrap(), 80);
    second.points.extend(first.points.iter().cloned());
    assert_eq!(settled(&mut anchor, first)[0].0.point_count(), 80);
    assert_eq!(settled(&mut anchor, second)[0].0.point_count(), 80);
}

#[test]
fn a_rich_keyframe_is_split_at_64_kib() {
    let frames = fly(with_a_turn, 2.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let split = settled(
        &mut anchor,
        keyframe_input(frames[0].keyframe_pose().unwrap(), 4000),
    );
    assert_eq!(split.len(), 3);
    assert!(split.iter().all(|(_, bytes)| bytes.len() <= 64 * 1024));
    let numbers: Vec<u32> = split.iter().map(|(chunk, _)| chunk.id().number.0).collect();
    assert_eq!(numbers, [0, 1, 2]);
    let point_count: usize = split.iter().map(|(chunk, _)| chunk.point_count()).sum();
    assert_eq!(point_count, 4000);
}

#[test]
fn malformed_points_are_dropped_and_counted() {
    let frames = fly(with_a_turn, 2.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let mut input = keyframe_input(frames[0].keyframe_pose().unwrap(), 60);
    input.points[0].position_in_map.x = f64::NAN;
    input.points[1].covariance_in_map *= f64::INFINITY;
    input.points[2].position_in_map = input.pose.map_from_camera * Vector3::new(0.0, 0.0, -1.0);
    input.points[3].position_in_map = input.pose.map_from_camera * Vector3::new(0.0, 0.0, 1e6);
    let cut = settled(&mut anchor, input);
    assert_eq!(cut[0].0.point_count(), 56);
    assert_eq!(anchor.counts().points_dropped, 4);
}

#[test]
fn fixes_out_of_order_or_not_finite_are_counted_and_ignored() {
    let frames = fly(with_a_turn, 4.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let mut normal = Normal::new(1);
    let good = frames[5].fix(0.02, &mut normal);
    let mut bad = frames[6].fix(0.02, &mut normal);
    bad.position = FixPosition::Local(Vector3::new(f64::NAN, 0.0, 0.0));
    let mut flat = frames[6].fix(0.02, &mut normal);
    flat.covariance = Matrix3::zeros();
    let mut foreign = frames[7].fix(0.02, &mut normal);
    foreign.position = FixPosition::Geodetic(Geodetic::from_degrees(47.0, 8.0, 400.0).unwrap());
    for fix in [good.clone(), bad, flat, good, foreign] {
        anchor.handle(Event::Fix(fix), at(1.0));
    }
    let counts = anchor.counts().fixes;
    assert_eq!(
        (counts.malformed, counts.out_of_order, counts.foreign_datum),
        (2, 1, 1)
    );
}

#[test]
fn the_first_geodetic_fix_becomes_the_datum() {
    let mut settings = settings();
    settings.datum = None;
    let mut anchor = Anchor::new(settings, EPOCH);
    let position = Geodetic::from_degrees(47.0, 8.0, 400.0).unwrap();
    let mut fix = fly(straight, 1.0, &TYPICAL_DRIFT, 1)[0].fix(1.0, &mut Normal::new(1));
    fix.position = FixPosition::Geodetic(position);
    anchor.handle(Event::Fix(fix), at(0.0));
    assert_eq!(anchor.datum(), Some(&Datum::Wgs84(position)));
}

#[test]
fn without_fixes_the_position_goes_stale() {
    let frames = fly(with_a_turn, 20.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    run(&mut anchor, &frames, 0.02);
    let end = frames.last().unwrap().captured_at;
    let later = end.after(std::time::Duration::from_secs(11));
    anchor.handle(Event::Tick, later);
    let expected = "no accepted fix for more than 10 s";
    assert_eq!(anchor.state(), (VehicleState::GlobalStale, expected));
}

#[test]
fn a_new_map_is_a_new_epoch_and_starts_from_nothing() {
    let frames = fly(with_a_turn, 20.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    run(&mut anchor, &frames, 0.02);
    let end = frames.last().unwrap().captured_at;
    let effects = anchor.handle(Event::MapRestarted { epoch_random: 7 }, end);
    assert_eq!(anchor.map().epoch.to_string(), "2-00000007");
    assert!(matches!(
        &effects[..],
        [Effect::StateChanged {
            state: VehicleState::NoMap,
            ..
        }]
    ));
    let pose = KeyframePose {
        id: KeyframeId(1000),
        ..frames[0].keyframe_pose().unwrap()
    };
    let first = settled(&mut anchor, keyframe_input(pose, 50));
    assert_eq!(first[0].0.id().to_string(), "ugv1/2-00000007/0");
}

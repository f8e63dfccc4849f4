use camera::Calibration;
use geodesy::Datum;
use nalgebra::Vector3;
use protocol::{ChunkPoint, Reference, encode};

use super::*;
use crate::node::{EpochStart, NodeSettings, PositionSource};
use crate::test_support::{chunk, manifest, placement, vehicle};

fn settings(id: &str) -> (NodeSettings, Calibration) {
    let text = "resolution: [324, 244]\nintrinsics: [180.9, 180.94, 159.23, 155.72]\n\
                distortion_model: radial-tangential\n\
                distortion_coefficients: [0.0, 0.0, 0.0, 0.0]\ncamera_model: pinhole\n";
    let settings = NodeSettings {
        id: vehicle(id),
        stale_after_s: 10.0,
        global_sigma_m: None,
        seed: 1,
        epoch_start: EpochStart {
            counter: 1,
            seed: 7,
        },
        background: None,
    };
    (settings, Calibration::from_euroc_yaml(text).unwrap())
}

fn peer() -> Node {
    let (settings, calibration) = settings("drone1");
    Node::peer(settings, calibration)
}

fn anchor() -> Node {
    let (settings, calibration) = settings("ugv1");
    let source = PositionSource {
        datum: Some(Datum::site("lab").unwrap()),
        antenna_in_body: Vector3::zeros(),
    };
    Node::anchor(settings, calibration, &source)
}

fn own_map(node: &Node) -> MapId {
    match &node.role {
        Role::Anchor(role) => role.map().clone(),
        Role::Peer(_) => panic!("an anchor is no peer"),
    }
}

fn hear(node: &mut Node, key: &Key, payload: Vec<u8>) -> Vec<Effect> {
    let mut effects = Vec::new();
    let payload: Arc<[u8]> = Arc::from(payload);
    node.take_message(
        &key.to_string(),
        &payload,
        Timestamp::default(),
        &mut effects,
    );
    effects
}

/// Goal: nobody adds to an anchor's map but itself. Method: whole messages about the map that is
/// being published; nothing is kept, and each is counted.
#[test]
fn what_an_anchor_never_said_of_its_map_is_refused() {
    let mut node = anchor();
    let map = own_map(&node);
    let forged = chunk(map.clone(), 6012);
    let page = PlacementPage::new(map.clone(), 0, 7, &[]);
    let messages = [
        (Key::Chunk(forged.id().clone()), encode(&forged)),
        (
            Key::Placement(map.clone()),
            encode(&placement(map.clone(), u32::MAX)),
        ),
        (Key::PlacementPage(map.clone(), 0), encode(&page)),
        (
            Key::Manifest(map.anchor.clone()),
            encode(&manifest(map.clone(), 9)),
        ),
    ];
    let count = messages.len() as u64;
    for (key, payload) in messages {
        assert!(hear(&mut node, &key, payload).is_empty(), "{key}");
    }
    assert_eq!(node.counters.impersonations, count);
    assert_eq!(node.counters.chunks_received, 0);
    assert!(node.shelf.map(&map).is_none());
}

#[test]
fn an_own_chunk_that_comes_back_is_a_duplicate() {
    let mut node = anchor();
    let own = chunk(own_map(&node), 0);
    let payload = encode(&own);
    node.shelf.take_chunk(&own, &payload);
    assert!(hear(&mut node, &Key::Chunk(own.id().clone()), payload).is_empty());
    assert_eq!(node.counters.impersonations, 0);
    assert_eq!(node.counters.duplicates, 1);
}

/// An epoch from before a restart is held by others alone.
#[test]
fn chunks_of_an_earlier_epoch_are_taken_back() {
    let mut node = anchor();
    let mut map = own_map(&node);
    map.epoch = "1-0000000a".parse().unwrap();
    let old = chunk(map, 3);
    let effects = hear(&mut node, &Key::Chunk(old.id().clone()), encode(&old));
    assert!(effects.iter().any(|one| matches!(one, Effect::Keep(_))));
    assert_eq!(node.counters.chunks_received, 1);
}

fn circular_count(node: &Node) -> u64 {
    match &node.role {
        Role::Peer(role) => role.circular_count(),
        Role::Anchor(_) => panic!("a peer is no anchor"),
    }
}

/// Another drone's map, registered to what these vehicles say.
fn registered_to(sources: &[&str]) -> (Placement, Chunk) {
    let mut map = crate::test_support::map();
    map.anchor = vehicle("drone2");
    let provenance: Vec<VehicleId> = sources.iter().map(|one| vehicle(one)).collect();
    let mut placement = placement(map.clone(), 1);
    placement.reference = Reference::Registered;
    placement.provenance = provenance.clone();
    let fixed = chunk(map, 0);
    let mut header = fixed.header().clone();
    header.reference = Reference::Registered;
    header.provenance = provenance;
    let points: Vec<ChunkPoint> = fixed.points().collect();
    (placement, Chunk::new(header, &points).unwrap())
}

/// Goal: a rumour does not come back as evidence. Method: a map that rests on this vehicle's own,
/// and one that does not; both are kept and handed on.
#[test]
fn what_rests_on_the_own_map_is_kept_and_not_used() {
    for (sources, refused) in [(&["ugv1"][..], 0), (&["ugv1", "drone1"][..], 2)] {
        let mut node = peer();
        let (placement, chunk) = registered_to(sources);
        let key = Key::Placement(placement.map.clone());
        let kept = hear(&mut node, &key, encode(&placement));
        assert!(kept.iter().any(|one| matches!(one, Effect::Keep(_))));
        let key = Key::Chunk(chunk.id().clone());
        let kept = hear(&mut node, &key, encode(&chunk));
        assert!(kept.iter().any(|one| matches!(one, Effect::Keep(_))));
        assert_eq!(circular_count(&node), refused, "{sources:?}");
    }
}

#[test]
fn nobody_speaks_of_the_map_that_a_peer_shares() {
    let mut node = peer();
    let Role::Peer(role) = &node.role else {
        panic!("a peer");
    };
    let forged = chunk(role.shared_map().clone(), 3);
    let effects = hear(&mut node, &Key::Chunk(forged.id().clone()), encode(&forged));
    assert!(effects.is_empty());
    assert_eq!(node.counters.impersonations, 1);
}

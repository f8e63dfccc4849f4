use std::collections::BTreeSet;

use camera::Calibration;
use geodesy::Datum;
use geometry::Similarity;
use nalgebra::Vector3;
use protocol::{ChunkPlacement, ChunkPoint, Reference, encode};
use registration::AnchorIdx;

use super::*;
use crate::node::peer_role::PeerRole;
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
    peer_named("drone1")
}

fn peer_named(id: &str) -> Node {
    let (settings, calibration) = settings(id);
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

fn peer_role(node: &Node) -> &PeerRole {
    match &node.role {
        Role::Peer(role) => role,
        Role::Anchor(_) => panic!("a peer is no anchor"),
    }
}

/// Another drone's map, registered to what these vehicles say.
fn registered_to(sources: &[&str]) -> (Placement, Chunk) {
    let named = sources.iter().map(|one| vehicle(one)).collect();
    registered("drone2", &named, 0)
}

fn registered(owner: &str, sources: &BTreeSet<VehicleId>, number: u32) -> (Placement, Chunk) {
    let mut map = crate::test_support::map();
    map.anchor = vehicle(owner);
    let provenance: Vec<VehicleId> = sources.iter().cloned().collect();
    let mut placement = placement(map.clone(), number);
    placement.reference = Reference::Registered;
    placement.provenance = provenance.clone();
    let fixed = chunk(map, number);
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
        assert_eq!(peer_role(&node).circular_count(), refused, "{sources:?}");
    }
}

/// Chunks and where they stand, which all have one landmark.
fn hear_all<'a>(nodes: &mut [Node], said: impl Iterator<Item = &'a (Placement, Chunk)> + Clone) {
    for node in nodes {
        let others = |chunk: &Chunk| chunk.id().map.anchor != node.settings.id;
        let heard: Vec<_> = said.clone().filter(|(_, chunk)| others(chunk)).collect();
        for (placement, chunk) in heard {
            let page = PlacementPage::new(
                placement.map.clone(),
                0,
                chunk.id().number.0 + 1,
                &[ChunkPlacement {
                    number: chunk.id().number,
                    map_from_chunk: Similarity::identity(),
                }],
            );
            let key = Key::Placement(placement.map.clone());
            hear(node, &key, encode(placement));
            let key = Key::PlacementPage(placement.map.clone(), 0);
            hear(node, &key, encode(&page));
            hear(node, &Key::Chunk(chunk.id().clone()), encode(chunk));
        }
    }
}

/// Goal: no vehicle holds itself up by others that it holds up, even if all begin in the same
/// moment, when nobody has named anybody yet. Method: each of a ring begins to use the map of the
/// next; what was mapped until then rested on the ground vehicle alone.
#[test]
fn vehicles_that_begin_to_use_each_other_at_once_let_go() {
    let all = ["drone1", "drone2", "drone3"];
    for ring in [&all[..2], &all] {
        let mut nodes: Vec<Node> = ring.iter().map(|id| peer_named(id)).collect();
        let ground = (
            placement(crate::test_support::map(), 1),
            chunk(crate::test_support::map(), 0),
        );
        hear_all(&mut nodes, [&ground].into_iter());
        let mut named = vec![BTreeSet::from([vehicle("ugv1")]); ring.len()];
        for round in 1..=ring.len() as u32 + 1 {
            let said = ring.iter().zip(&named);
            let said: Vec<_> = said
                .map(|(id, named)| registered(id, named, round))
                .collect();
            hear_all(&mut nodes, said.iter());
            if round == 1 {
                for node in &nodes {
                    let usable_count = peer_role(node).localizer().landmark_count();
                    assert_eq!(usable_count, ring.len(), "everybody uses everybody");
                }
            }
            for (idx, node) in nodes.iter().enumerate() {
                // The ground vehicle was heard first, then the others in the order of the ring.
                let next = (idx + 1) % ring.len();
                let next = AnchorIdx(1 + next as u32 - u32::from(next > idx));
                let used = [AnchorIdx(0), next];
                named[idx].extend(peer_role(node).provenance_of(&used));
            }
        }
        for node in &nodes {
            let role = peer_role(node);
            assert_eq!(
                role.localizer().landmark_count(),
                1,
                "the ground vehicle is left"
            );
            assert!(role.circular_count() > 0);
        }
    }
}

/// A chunk may say so before its map's placement does.
#[test]
fn the_first_word_that_a_map_rests_on_the_own_one_counts_for_all_of_it() {
    let mut nodes = [peer()];
    let early = registered("drone2", &BTreeSet::from([vehicle("ugv1")]), 1);
    hear_all(&mut nodes, [&early].into_iter());
    assert_eq!(peer_role(&nodes[0]).localizer().landmark_count(), 1);
    let (_, later) = registered("drone2", &BTreeSet::from([vehicle("drone1")]), 2);
    let key = Key::Chunk(later.id().clone());
    hear(&mut nodes[0], &key, encode(&later));
    assert_eq!(peer_role(&nodes[0]).localizer().landmark_count(), 0);
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

//! Two shelves, and the questions that one asks about the other.

use geometry::Timestamp;
use protocol::{
    Chunk, ChunkCamera, ChunkHeader, ChunkPoint, Epoch, Manifest, Reference, encode,
};

use super::*;

fn vehicle(name: &str) -> VehicleId {
    VehicleId::new(name).unwrap()
}

fn map() -> MapId {
    MapId {
        anchor: vehicle("anchor1"),
        epoch: Epoch {
            counter: 1,
            random: 7,
        },
    }
}

fn shelf_with(numbers: std::ops::Range<u32>) -> Shelf {
    let mut shelf = Shelf::default();
    for number in numbers {
        let chunk = chunk(number);
        shelf.take_chunk(&chunk, &encode(&chunk));
    }
    shelf
}

fn chunk(number: u32) -> Chunk {
    let header = ChunkHeader {
        id: chunk_id(&map(), ChunkNumber(number)),
        captured_at: Timestamp::default(),
        camera: ChunkCamera {
            focal_length_px: 180.0,
            width_px: 324,
            height_px: 244,
        },
        replaces: Vec::new(),
        reference: Reference::Fixed,
        provenance: Vec::new(),
        signature: Vec::new(),
    };
    let point = ChunkPoint {
        position_in_chunk: nalgebra::Vector3::new(0.1, 0.2, 1.0 + f64::from(number)),
        depth_sigma: 0.01,
        descriptor: [7; 32],
    };
    Chunk::new(header, &[point]).unwrap()
}

fn beacon(of: &str, shelf: &Shelf) -> Have {
    Have::rotate(vehicle(of), &shelf.entries(), 0).0
}

fn manifest(holder: &str, shelf: &Shelf) -> Manifest {
    let held = shelf.map(&map()).unwrap().chunks.clone();
    Manifest {
        map: map(),
        revision: 1,
        datum: geodesy::Datum::site("lab").unwrap(),
        chunks: held.clone(),
        bounding_box: None,
        public_key: Vec::new(),
        signature: Vec::new(),
        holder: vehicle(holder),
        held,
    }
}

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_seconds(seconds).unwrap()
}

#[test]
fn what_is_missing_is_pulled_from_one_holder_newest_first_and_windowed() {
    let (theirs, mut own) = (shelf_with(0..20), shelf_with(0..2));
    let mut reconciler = Reconciler::new(vehicle("peer1"));
    reconciler.hear(beacon("anchor1", &theirs), at(0.0));
    reconciler.hear(beacon("peer2", &theirs), at(0.0));
    assert!(reconciler.ask(&own, at(0.5)).is_empty(), "it may be on its way");
    let questions = reconciler.ask(&own, at(1.6));
    let [(request, selector)] = &questions[..] else {
        panic!("one question, got {questions:?}");
    };
    assert_eq!(selector, "anchor/anchor1/map");
    reconciler.learn(&manifest("anchor1", &theirs), &own);
    reconciler.learn(&manifest("peer2", &theirs), &own);
    reconciler.request_ended(*request, at(1.7));
    let mut pulled = Vec::new();
    for round in 0..100 {
        let pulls = reconciler.ask(&own, at(1.7));
        if pulls.is_empty() {
            break;
        }
        assert!(pulls.len() <= 2 * WINDOW, "round {round}");
        for (request, selector) in pulls {
            let Key::HeldChunk(_, id) = selector.parse().unwrap() else {
                panic!("{selector} is no pull");
            };
            assert!(reconciler.is_pull(request));
            let chunk = chunk(id.number.0);
            own.take_chunk(&chunk, &encode(&chunk));
            pulled.push(id.number.0);
            reconciler.request_ended(request, at(1.7));
        }
    }
    assert_eq!(pulled[0], 19);
    pulled.sort_unstable();
    assert_eq!(pulled, (2..20).collect::<Vec<_>>(), "each once");
    assert!(reconciler.ask(&own, at(5.0)).is_empty());
}

#[test]
fn who_merely_lags_is_not_asked() {
    let own = shelf_with(0..9);
    let mut reconciler = Reconciler::new(vehicle("peer1"));
    reconciler.hear(beacon("peer2", &shelf_with(0..5)), at(0.0));
    assert!(reconciler.ask(&own, at(3.0)).is_empty());
}

#[test]
fn a_holder_that_does_not_deliver_is_asked_again_only_after_its_beacon() {
    let (theirs, own) = (shelf_with(0..1), Shelf::default());
    let mut reconciler = Reconciler::new(vehicle("peer1"));
    reconciler.hear(beacon("peer2", &theirs), at(0.0));
    let questions = reconciler.ask(&own, at(0.0));
    assert_eq!(questions.len(), 1, "an unknown map is asked about at once");
    reconciler.learn(&manifest("peer2", &theirs), &own);
    reconciler.request_ended(questions[0].0, at(0.1));
    let pulls = reconciler.ask(&own, at(0.1));
    reconciler.request_ended(pulls[0].0, at(3.1));
    let questions = reconciler.ask(&own, at(3.2));
    assert_eq!(questions[0].1, "anchor/anchor1/map", "what it holds is asked first");
    assert!(reconciler.ask(&own, at(60.0)).is_empty(), "it has been silent for too long");
}

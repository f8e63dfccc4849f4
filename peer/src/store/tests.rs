use geometry::Similarity;
use nalgebra::UnitQuaternion;
use protocol::ChunkPlacement;

use super::*;
use crate::test_support::{chunk, manifest, map, placement, vehicle};

/// A store with three chunks of one point each, at 1, 11 and 21 m east.
fn store() -> Store {
    let store = Store::new(vehicle("drone1"));
    let mut placements = Vec::new();
    for number in (0..3).map(ChunkNumber) {
        let chunk = chunk(map(), number.0);
        let payload = Arc::from(encode(&chunk));
        store.hold(Kept::Chunk(chunk.id().clone(), payload));
        let east_m = 1.0 + 10.0 * f64::from(number.0);
        let translation = Vector3::new(east_m, 0.0, 0.0);
        placements.push(ChunkPlacement {
            number,
            map_from_chunk: Similarity::new(1.0, UnitQuaternion::identity(), translation),
        });
    }
    store.hold(Kept::Page(PlacementPage::new(map(), 0, 1, &placements)));
    store.hold(Kept::Placement(Box::new(placement(map(), 2))));
    store.hold(Kept::Manifest(manifest(map(), 1)));
    store
}

#[test]
fn each_question_gets_what_it_asks_for() {
    let store = store();
    let check = |selector: &str, expected: &[&str]| {
        let answers = store.answer(&Question::parse(selector).unwrap()).unwrap();
        let keys: Vec<&str> = answers.iter().map(|answer| answer.key.as_str()).collect();
        assert_eq!(keys, expected, "{selector}");
    };
    let chunk = |number: u32| format!("anchor/ugv1/map/1-0000000a/{number}");
    let chunks = [chunk(0), chunk(1), chunk(2)];
    let [first, second, third] = chunks.each_ref().map(String::as_str);
    check("anchor/*/map", &["anchor/ugv1/map"]);
    check("anchor/*/map/*/*", &[first, second, third]);
    check(
        "anchor/*/map/**",
        &["anchor/ugv1/map", first, second, third],
    );
    check("anchor/*/map/*/*?since=1-0000000a:1", &[third]);
    check("anchor/*/map/*/*?bbox=10,-5,12,5", &[second]);
    check("anchor/drone1/map/**", &[]);
    check(
        "anchor/ugv1/placement/1-0000000a/**",
        &[
            "anchor/ugv1/placement/1-0000000a",
            "anchor/ugv1/placement/1-0000000a/0",
        ],
    );
    check(
        "vehicle/drone1/chunk/ugv1/1-0000000a/2",
        &["vehicle/drone1/chunk/ugv1/1-0000000a/2"],
    );
    check("vehicle/other/chunk/**", &[]);
}

#[test]
fn a_manifest_says_who_answers_and_what_that_one_holds() {
    let answers = store()
        .answer(&Question::parse("anchor/ugv1/map").unwrap())
        .unwrap();
    let manifest: Manifest = decode(&answers[0].payload).unwrap();
    assert_eq!(manifest.holder, vehicle("drone1"));
    assert_eq!(manifest.held.count(), 3);
    assert_eq!(manifest.chunks.count(), 10);
}

#[test]
fn a_question_that_makes_no_sense_is_answered_with_the_reason() {
    for parameters in ["bbox=1", "bbox=nan,nan,nan,nan", "since=foo"] {
        let question = Question::parse(&format!("anchor/*/map/**?{parameters}")).unwrap();
        assert!(store().answer(&question).is_err(), "{parameters}");
    }
}

#[test]
fn what_was_kept_is_there_after_a_crash_up_to_the_tear() {
    let folder = tempfile::tempdir().unwrap();
    let chunk = |number: u32| {
        let question = format!("anchor/ugv1/map/1-0000000a/{number}");
        let answers = store()
            .answer(&Question::parse(&question).unwrap())
            .unwrap();
        let id = ChunkId {
            map: map(),
            number: ChunkNumber(number),
        };
        Kept::Chunk(id, Arc::clone(&answers[0].payload))
    };
    let open = || Store::open(vehicle("drone1"), folder.path()).unwrap();
    let (first, reloaded) = open();
    assert!(reloaded.is_empty());
    first.keep(chunk(0)).unwrap();
    first.keep(chunk(1)).unwrap();
    // Not closed, as after a crash, and the last message torn.
    std::mem::forget(first);
    let segment = folder.path().join("000000.mcap");
    let bytes = std::fs::read(&segment).unwrap();
    std::fs::write(&segment, &bytes[..bytes.len() - 5]).unwrap();
    let (second, reloaded) = open();
    let keys: Vec<String> = reloaded.iter().map(|one| one.key.to_string()).collect();
    assert_eq!(keys, ["anchor/ugv1/map/1-0000000a/0"]);
    second.keep(chunk(2)).unwrap();
    second.close().unwrap();
    let (_, reloaded) = open();
    assert_eq!(reloaded.len(), 2);
    std::fs::write(folder.path().join("000007.mcap"), b"foreign").unwrap();
    assert_eq!(open().1.len(), 2);
}

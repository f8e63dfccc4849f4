//! Every key in both directions, and what is no key.

use proptest::prelude::*;

use super::*;

fn vehicle() -> impl Strategy<Value = VehicleId> {
    "[A-Za-z0-9_.-]{1,32}".prop_map(|text| VehicleId::new(&text).unwrap())
}

fn map_id() -> impl Strategy<Value = MapId> {
    (vehicle(), any::<(u32, u32)>()).prop_map(|(anchor, (counter, random))| MapId {
        anchor,
        epoch: Epoch { counter, random },
    })
}

fn chunk_id() -> impl Strategy<Value = ChunkId> {
    (map_id(), any::<u32>()).prop_map(|(map, number)| ChunkId {
        map,
        number: ChunkNumber(number),
    })
}

fn key() -> impl Strategy<Value = Key> {
    prop_oneof![
        vehicle().prop_map(Key::Manifest),
        chunk_id().prop_map(Key::Chunk),
        map_id().prop_map(Key::Placement),
        (map_id(), any::<u32>()).prop_map(|(map, page)| Key::PlacementPage(map, page)),
        (vehicle(), chunk_id()).prop_map(|(holder, chunk)| Key::HeldChunk(holder, chunk)),
        vehicle().prop_map(Key::Have),
        vehicle().prop_map(Key::Pose),
        vehicle().prop_map(Key::Alive),
    ]
}

proptest! {
    #[test]
    fn keys_survive_the_round_trip(key in key()) {
        prop_assert_eq!(key.to_string().parse::<Key>(), Ok(key));
    }

    #[test]
    fn no_text_panics(text in ".{0,80}") {
        let _ = text.parse::<Key>();
        let _ = MapParameters::parse(&text);
    }

    #[test]
    fn an_accepted_text_is_the_only_one_for_its_key(
        text in concat!(
            "(anchor|vehicle)/[a-z0-9+]{0,3}/(map|placement|have)",
            "(/[0-9+-]{1,3}-[0-9a-fA-F]{7,9}){0,2}(/[0-9]{0,2}){0,2}",
        ),
    ) {
        if let Ok(key) = text.parse::<Key>() {
            prop_assert_eq!(key.to_string(), text);
        }
    }

    #[test]
    fn parameters_survive_the_round_trip(
        corner in (-1e6..1e6_f64, -1e6..1e6_f64),
        size in (0.0..1e3_f64, 0.0..1e3_f64),
        since in proptest::option::of(any::<(u32, u32, u32)>()),
    ) {
        let area = Area::new(corner, (corner.0 + size.0, corner.1 + size.1));
        let since = since.map(|(counter, random, number)| {
            (Epoch { counter, random }, ChunkNumber(number))
        });
        let parameters = MapParameters { area, since };
        prop_assert_eq!(MapParameters::parse(&parameters.to_string()), Ok(parameters));
    }
}

#[test]
fn keys_read_as_the_design_says() {
    let map = MapId {
        anchor: VehicleId::new("ugv1").unwrap(),
        epoch: "3-9f3c21ab".parse().unwrap(),
    };
    let chunk = ChunkId {
        map: map.clone(),
        number: ChunkNumber(17),
    };
    let holder = VehicleId::new("drone2").unwrap();
    let cases = [
        (Key::Manifest(map.anchor.clone()), "anchor/ugv1/map"),
        (Key::Chunk(chunk.clone()), "anchor/ugv1/map/3-9f3c21ab/17"),
        (
            Key::Placement(map.clone()),
            "anchor/ugv1/placement/3-9f3c21ab",
        ),
        (
            Key::PlacementPage(map, 2),
            "anchor/ugv1/placement/3-9f3c21ab/2",
        ),
        (
            Key::HeldChunk(holder.clone(), chunk),
            "vehicle/drone2/chunk/ugv1/3-9f3c21ab/17",
        ),
        (Key::Have(holder.clone()), "vehicle/drone2/have"),
        (Key::Pose(holder.clone()), "vehicle/drone2/pose"),
        (Key::Alive(holder), "vehicle/drone2/alive"),
    ];
    for (key, text) in cases {
        assert_eq!(key.to_string(), text);
        assert_eq!(text.parse(), Ok(key));
    }
}

#[test]
fn malformed_keys_are_refused_with_a_reason() {
    let cases = [
        ("", "no key has the shape of \"\""),
        ("anchor/ugv1", "no key has the shape"),
        ("anchor/*/map", "a vehicle id has 1 to 32 letters"),
        ("anchor//map", "a vehicle id has 1 to 32 letters"),
        ("anchor/ugv1/map/3-9f3c21ab", "no key has the shape"),
        ("anchor/ugv1/map/3-9F3C21AB/1", "an epoch is a counter"),
        ("anchor/ugv1/map/03-9f3c21ab/1", "an epoch is a counter"),
        ("anchor/ugv1/map/+3-9f3c21ab/1", "an epoch is a counter"),
        ("anchor/ugv1/map/3-9f3c21a/1", "an epoch is a counter"),
        (
            "anchor/ugv1/map/3-9f3c21ab/01",
            "a chunk number is a decimal",
        ),
        (
            "anchor/ugv1/map/3-9f3c21ab/4294967296",
            "a chunk number is a decimal",
        ),
        (
            "anchor/ugv1/map/3-9f3c21ab/-1",
            "a chunk number is a decimal",
        ),
        ("anchor/ugv1/map/3-9f3c21ab/1/2", "no key has the shape"),
        ("vehicle/drone1/have/", "no key has the shape"),
        ("/vehicle/drone1/have", "no key has the shape"),
    ];
    for (text, reason) in cases {
        let error = text.parse::<Key>().unwrap_err().to_string();
        assert!(error.contains(reason), "{text}: {error}");
    }
    let long = format!("vehicle/{}/have", "x".repeat(500));
    assert!(long.parse::<Key>().unwrap_err().to_string().len() < 200);
}

#[test]
fn parameters_limit_what_is_answered() {
    let parameters = MapParameters::parse("_time=[now(-1s)..];bbox=-1,-2,3,4.5;since=2-0000000a:7");
    let parameters = parameters.unwrap();
    let epoch = |counter, random| Epoch { counter, random };
    assert!(!parameters.admits_number(epoch(2, 10), ChunkNumber(7)));
    assert!(parameters.admits_number(epoch(2, 10), ChunkNumber(8)));
    assert!(parameters.admits_number(epoch(3, 0), ChunkNumber(0)));
    assert!(parameters.admits_area((2.0, 4.0), (9.0, 9.0)));
    assert!(!parameters.admits_area((4.0, 0.0), (5.0, 1.0)));
    assert_eq!(MapParameters::parse(""), Ok(MapParameters::default()));
    for text in [
        "bbox=1,2,3",
        "bbox=1,2,3,4,5",
        "bbox=3,0,1,1",
        "bbox=nan,0,1,1",
        "since=7",
    ] {
        assert!(MapParameters::parse(text).is_err(), "{text}");
    }
}

//! What goes in comes out, for any values.

use proptest::prelude::*;

use super::*;

fn ranges() -> impl Strategy<Value = Ranges> {
    prop::collection::vec(0..400_u32, 0..60)
        .prop_map(|numbers| numbers.into_iter().map(ChunkNumber).collect())
}

fn any_similarity<T, S>() -> impl Strategy<Value = Similarity<T, S>> {
    let rotation = prop::array::uniform3(-3.0..3.0_f64);
    (
        rotation,
        prop::array::uniform3(-1e3..1e3_f64),
        -3.0..3.0_f64,
    )
        .prop_map(|(rotation, translation, log_scale)| {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(rotation));
            Similarity::new(log_scale.exp(), rotation, Vector3::from(translation))
        })
}

fn any_covariance() -> impl Strategy<Value = Matrix7> {
    prop::collection::vec(-1.0..1.0_f64, 49).prop_map(|values| {
        let factor = Matrix7::from_row_slice(&values);
        factor * factor.transpose()
    })
}

fn any_datum() -> impl Strategy<Value = Datum> {
    prop_oneof![
        (-90.0..90.0_f64, -180.0..180.0_f64, -100.0..9e3_f64).prop_map(|(lat, lon, height)| {
            Datum::Wgs84(Geodetic::from_degrees(lat, lon, height).unwrap())
        }),
        "[a-z0-9-]{1,20}".prop_map(|name| Datum::site(&name).unwrap()),
    ]
}

proptest! {
    #[test]
    fn placements_come_back(
        enu_from_map in any_similarity(),
        covariance in any_covariance(),
        datum in any_datum(),
        revision: u32,
        time: i64,
        fix_sigma_m in 0.0..10.0_f64,
    ) {
        let message = Placement {
            enu_from_map,
            covariance,
            datum,
            revision,
            captured_at: Timestamp::from_nanoseconds(time),
            fix_sigma_m,
            ..placement()
        };
        let bytes = encode(&message);
        // A new fix re-sends less than a kilobyte.
        prop_assert!(bytes.len() < 1000);
        prop_assert_eq!(decode::<Placement>(&bytes), Ok(message));
    }

    #[test]
    fn pages_come_back_as_precise_as_they_were_made(
        placed in prop::collection::btree_map(512..768_u32, any_similarity(), 0..256),
    ) {
        let placements: Vec<ChunkPlacement> = placed
            .iter()
            .map(|(number, map_from_chunk)| ChunkPlacement {
                number: ChunkNumber(*number),
                map_from_chunk: *map_from_chunk,
            })
            .collect();
        let page = PlacementPage::new(map_id(), 2, 1, &placements);
        let back: PlacementPage = decode(&encode(&page)).unwrap();
        prop_assert_eq!(&back, &page);
        prop_assert_eq!(back.placements().len(), placements.len());
        for (coded, given) in back.placements().zip(&placements) {
            prop_assert_eq!(coded.number, given.number);
            let point = Vector3::new(1.0, -2.0, 5.0);
            let error = coded.map_from_chunk * point - given.map_from_chunk * point;
            // Single precision of kilometres and of a lever of five times the scale.
            prop_assert!(error.norm() < 1e-3);
        }
    }

    #[test]
    fn manifests_come_back(
        chunks in ranges(),
        held in ranges(),
        datum in any_datum(),
        sources in prop::collection::vec("[a-z0-9]{1,32}", 0..=PROVENANCE_COUNT_MAX),
    ) {
        let reference = match sources.is_empty() {
            true => Reference::Fixed,
            false => Reference::Registered,
        };
        let provenance = sources.iter().map(|source| vehicle(source)).collect();
        let message = Manifest { chunks, held, datum, reference, provenance, ..manifest() };
        prop_assert_eq!(decode::<Manifest>(&encode(&message)), Ok(message));
    }

    #[test]
    fn beacons_rotate_within_a_packet(
        maps in prop::collection::vec(("[a-z0-9]{1,32}", any::<(u32, u32)>(), ranges()), 0..60),
    ) {
        let all: Vec<HaveEntry> = maps
            .iter()
            .map(|(anchor, (counter, random), held)| {
                let epoch = Epoch { counter: *counter, random: *random };
                HaveEntry::new(MapId { anchor: vehicle(anchor), epoch }, held, u32::MAX, u64::MAX)
            })
            .collect();
        let mut seen = Vec::new();
        let mut next_idx = 0;
        while seen.len() < all.len() {
            let (have, next) = Have::rotate(vehicle("drone1"), &all, next_idx);
            let bytes = encode(&have);
            prop_assert!(bytes.len() <= MAX_BEACON_BYTES, "{}", bytes.len());
            let back = decode::<Have>(&bytes);
            prop_assert_eq!(back.as_ref(), Ok(&have));
            prop_assert!(!have.entries.is_empty());
            seen.extend(have.entries);
            next_idx = next;
        }
        prop_assert!(all.iter().all(|entry| seen.contains(entry)));
    }

    #[test]
    fn poses_come_back(
        enu_from_map in any_similarity::<geometry::Enu, geometry::Body>(),
        datum in any_datum(),
        reason in ".{0,100}",
        known: bool,
    ) {
        let mut message = pose();
        message.reason = reason;
        let global = message.global.as_mut().unwrap();
        global.enu_from_body = enu_from_map.rigid_part();
        global.geodetic = match &datum {
            Datum::Wgs84(origin) => Some(*origin),
            Datum::Site(_) => None,
        };
        global.datum = datum;
        if !known {
            message.global = None;
        }
        let mut back: Pose = decode(&encode(&message)).unwrap();
        prop_assert!(back.reason.len() <= 160 && message.reason.starts_with(&back.reason));
        back.reason = message.reason.clone();
        prop_assert_eq!(back, message);
    }
}

#[test]
fn a_manifest_with_more_runs_than_fit_keeps_the_newest() {
    let held: Ranges = (0..10_000).map(|idx| ChunkNumber(2 * idx)).collect();
    let message = Manifest {
        chunks: held.clone(),
        held,
        ..manifest()
    };
    let bytes = encode(&message);
    let back: Manifest = decode(&bytes).unwrap();
    assert_eq!(back.held.count(), 4096);
    assert_eq!(back.held.highest(), Some(ChunkNumber(19_998)));
}

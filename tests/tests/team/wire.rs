//! Goal: what others say cannot harm a vehicle. Method: put malformed, truncated and misplaced
//! messages on the wire and compare what the vehicle counts.

use std::time::Duration;

use protocol::{Have, VehicleId, encode};
use tempfile::TempDir;
use zenoh::Wait;

use crate::processes::{Vehicle, summary};
use crate::recordings::RECORDINGS;

#[test]
fn malformed_messages_are_counted_and_ignored() {
    let folder = TempDir::new().unwrap();
    let tables = format!(
        "[camera]\ndataset = \"{}@0..70\"\n",
        RECORDINGS.drone.display()
    );
    let vehicle = Vehicle::start(folder.path(), "peer1", &[], &tables);
    let mut config = zenoh::Config::default();
    let endpoints = format!("[{:?}]", vehicle.endpoint);
    for (field, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", endpoints.as_str()),
        ("scouting/multicast/enabled", "false"),
    ] {
        config.insert_json5(field, value).unwrap();
    }
    let session = zenoh::open(config).wait().unwrap();
    let have = Have::rotate(VehicleId::new("stranger").unwrap(), &[], 0).0;
    let have = encode(&have);
    let messages: [(&str, &[u8]); 7] = [
        ("anchor/x/map/1-00000000/0", b"no CBOR at all"),
        ("anchor/x/map/1-00000000/0", b""),
        ("anchor/x/map/one/0", b"\xa0"),
        ("anchor/x/placement/1-00000000", &[0xff; 100]),
        ("vehicle/stranger/have", &have[..have.len() - 1]),
        // A message that is whole, under somebody else's key.
        ("vehicle/somebody/have", &have),
        ("vehicle/stranger/pose", &[0x9f; 3000]),
    ];
    // Whole messages in between show that the vehicle goes on listening.
    for (key, payload) in messages {
        session.put(key, payload).wait().unwrap();
        session
            .put("vehicle/stranger/have", &have[..])
            .wait()
            .unwrap();
    }
    // Somebody who says what only this vehicle may say.
    let own = Have::rotate(VehicleId::new("peer1").unwrap(), &[], 0).0;
    let own = encode(&own);
    for _ in 0..3 {
        session.put("vehicle/peer1/have", &own[..]).wait().unwrap();
    }
    vehicle.wait(Duration::from_secs(120));
    session.close().wait().unwrap();
    let peer = summary(folder.path(), "peer1");
    assert_eq!(peer["counters"]["malformed"], messages.len(), "{peer}");
    assert_eq!(peer["counters"]["impersonations"], 3, "{peer}");
    assert_eq!(peer["counters"]["chunks_received"], 0);
    assert_eq!(peer["frame_count"], 70, "every frame was flown");
}

//! Two sessions in one process over loopback.

use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Instant;

use super::*;

struct Nothing;

impl Holdings for Nothing {
    fn answer(&self, question: &Question) -> Result<Vec<Answer>, String> {
        let key = "vehicle/a/chunk/x/1-00000000/7".to_owned();
        let payload = Arc::from(&b"chunk seven"[..]);
        let wanted = question.asks_for(&key) && question.parameters().is_empty();
        Ok(wanted
            .then_some(Answer { key, payload })
            .into_iter()
            .collect())
    }
}

fn open(id: &str, connect: Vec<String>) -> (Link, Receiver<LinkEvent>) {
    let (sender, receiver) = sync_channel(1024);
    let config = ZenohConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        connect,
        ..ZenohConfig::default()
    };
    let inbox = inbox(sender, |event| event);
    (
        Link::open(id, &config, Arc::new(Nothing), inbox).unwrap(),
        receiver,
    )
}

fn wait_for(events: &Receiver<LinkEvent>, mut wanted: impl FnMut(&LinkEvent) -> bool) -> LinkEvent {
    let deadline = Instant::now() + Duration::from_secs(10);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let event = events
            .recv_timeout(left)
            .expect("the event arrives in time");
        if wanted(&event) {
            return event;
        }
    }
}

#[test]
fn messages_requests_and_neighbours_arrive_as_plain_events() {
    let (mut first, first_events) = open("a", Vec::new());
    let (second, second_events) = open("b", first.endpoints());
    wait_for(&first_events, |event| {
        matches!(event, LinkEvent::NeighbourCame { .. })
    });
    wait_for(&second_events, |event| {
        matches!(event, LinkEvent::NeighbourCame { .. })
    });
    // A subscription takes a moment to travel; publish until one arrives.
    let payload: Arc<[u8]> = Arc::from(&b"beacon"[..]);
    let mut sample = None;
    for _ in 0..100 {
        first.publish(Class::Notice, "vehicle/a/have", Arc::clone(&payload));
        let heard = second_events.recv_timeout(Duration::from_millis(50));
        if let Ok(LinkEvent::Sample(heard)) = heard {
            sample = Some(heard);
            break;
        }
    }
    let sample = sample.expect("a message arrives within five seconds");
    assert_eq!(
        (sample.key.as_str(), sample.payload),
        ("vehicle/a/have", payload)
    );
    let origin = sample.origin.unwrap();
    assert_eq!((origin.sender.as_str(), origin.class), ("a", Class::Notice));
    assert!(origin.sequence >= 1);

    second.request(RequestId(5), "vehicle/a/chunk/x/1-00000000/7");
    let reply = wait_for(&second_events, |event| {
        matches!(event, LinkEvent::Reply { .. })
    });
    let LinkEvent::Reply {
        request, payload, ..
    } = reply
    else {
        unreachable!("the wait was for a reply");
    };
    assert_eq!(
        (request, payload.as_ref()),
        (RequestId(5), &b"chunk seven"[..])
    );
    wait_for(&second_events, |event| {
        *event
            == LinkEvent::RequestEnded {
                request: RequestId(5),
            }
    });

    let replies = ask(
        &first.endpoints(),
        "vehicle/a/chunk/**",
        Duration::from_secs(2),
    )
    .unwrap();
    assert_eq!(replies.len(), 1);
    let none = ask(
        &first.endpoints(),
        "vehicle/a/chunk/**?since=1",
        Duration::from_secs(2),
    );
    assert!(none.unwrap().is_empty());

    second.close(Duration::from_secs(1));
    wait_for(&first_events, |event| {
        matches!(event, LinkEvent::NeighbourLeft { .. })
    });
    assert_eq!(first.counters().neighbour_count(), 0);
    first.close(Duration::from_secs(1));
}

#[test]
fn a_port_in_use_is_a_clear_error() {
    let (first, _events) = open("a", Vec::new());
    let config = ZenohConfig {
        listen: first.endpoints(),
        ..ZenohConfig::default()
    };
    let (sender, _receiver) = sync_channel(16);
    let inbox = inbox(sender, |event: LinkEvent| event);
    let error = Link::open("b", &config, Arc::new(Nothing), inbox)
        .err()
        .unwrap();
    assert!(error.to_string().contains("port in use"), "{error}");
}

#[test]
fn a_foreign_attachment_is_no_origin() {
    for bytes in [
        &b""[..],
        b"\x00\x01",
        b"\x07\x01\0\0\0\0\0\0\0a",
        b"\x00\x01\0\0\0\0\0\0\0\xff",
    ] {
        assert_eq!(inbox::decode_origin(bytes), None);
    }
}

//! Opening a session with settings that notice a lost link in two seconds and find it again.

use std::sync::Arc;

use zenoh::Wait;
use zenoh::config::WhatAmI;
use zenoh::sample::SampleKind;

use super::error::{check_endpoints, plain};
use super::inbox::decode_origin;
use super::{Counters, Inbox, LinkError, LinkEvent, Sample};
use crate::config::{ZenohConfig, ZenohMode};

/// Both ends need them: a neighbour's lease sets how fast this side notices that it is gone.
const SETTINGS: [(&str, &str); 7] = [
    ("transport/unicast/open_timeout", "2000"),
    ("transport/link/tx/lease", "2000"),
    ("transport/link/tx/keep_alive", "4"),
    // A chunk on a slow link must not close the transport.
    (
        "transport/link/tx/queue/congestion_control/block/wait_before_close",
        "120000000",
    ),
    (
        "connect/retry",
        "{ period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 2 }",
    ),
    // Without timestamps a wildcard get returns an arbitrary holder's manifest.
    ("timestamping/enabled", "true"),
    ("scouting/timeout", "1000"),
];

pub(super) fn open(config: &ZenohConfig) -> Result<zenoh::Session, LinkError> {
    check_endpoints(&config.listen)?;
    check_endpoints(&config.connect)?;
    let mut settings: Vec<(&str, String)> = SETTINGS
        .iter()
        .map(|(field, value)| (*field, (*value).to_owned()))
        .collect();
    let mode = match config.mode {
        ZenohMode::Peer => "peer",
        ZenohMode::Router => "router",
    };
    settings.push(("mode", json(mode)));
    settings.push(("listen/endpoints", json(&config.listen)));
    settings.push(("connect/endpoints", json(&config.connect)));
    settings.push(("scouting/multicast/enabled", json(&config.scouting)));
    settings.push(("scouting/gossip/enabled", json(&config.scouting)));
    // Endpoints to connect to that do not answer are no error: zenoh tries them again and again.
    // An endpoint that cannot be listened on is one.
    let opened = zenoh::open(configure(&settings)?).wait();
    opened.map_err(|error| LinkError::listen(&config.listen, &error))
}

/// A session of a client that only asks.
pub(super) fn open_client(endpoints: &[String]) -> Result<zenoh::Session, LinkError> {
    check_endpoints(endpoints)?;
    let settings = [
        ("mode", json("client")),
        ("connect/endpoints", json(endpoints)),
        ("connect/timeout_ms", "2000".to_owned()),
        ("scouting/multicast/enabled", json(&false)),
    ];
    let opened = zenoh::open(configure(&settings)?).wait();
    opened.map_err(|error| {
        tracing::debug!(%error, "no session");
        LinkError::Connect {
            endpoints: endpoints.join(", "),
        }
    })
}

fn configure(settings: &[(&str, String)]) -> Result<zenoh::Config, LinkError> {
    let mut config = zenoh::Config::default();
    for (field, value) in settings {
        config
            .insert_json5(field, value)
            .map_err(|error| LinkError::Setting {
                field: (*field).to_owned(),
                value: value.clone(),
                reason: plain(&error.to_string()),
            })?;
    }
    Ok(config)
}

fn json<T: serde::Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).expect("strings, lists of strings and flags are JSON")
}

pub(super) fn watch_neighbours(
    session: &zenoh::Session,
    inbox: &Inbox,
    counters: &Arc<Counters>,
) -> Result<(), LinkError> {
    let (inbox, counters) = (inbox.clone(), Arc::clone(counters));
    let watch = move |event: zenoh::session::TransportEvent| {
        // A client only asks; it is nobody's neighbour.
        if event.transport().whatami() == WhatAmI::Client {
            return;
        }
        let name = event.transport().zid().to_string();
        match event.kind() {
            SampleKind::Put => {
                counters.neighbour_came();
                inbox.deliver(LinkEvent::NeighbourCame { name }, &counters);
            }
            SampleKind::Delete => {
                counters.neighbour_left();
                inbox.deliver(LinkEvent::NeighbourLeft { name }, &counters);
            }
        }
    };
    session
        .info()
        .transport_events_listener()
        .history(true)
        .callback(watch)
        .background()
        .wait()
        .map_err(|error| LinkError::declare("a listener for transports", &error))
}

pub(super) fn subscribe(
    session: &zenoh::Session,
    key: &str,
    inbox: &Inbox,
    counters: &Arc<Counters>,
) -> Result<(), LinkError> {
    let (inbox, counters) = (inbox.clone(), Arc::clone(counters));
    let receive = move |sample: zenoh::sample::Sample| {
        // Nothing that was shared is ever taken back.
        if sample.kind() != SampleKind::Put {
            return;
        }
        let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
        let origin = attachment.as_deref().and_then(decode_origin);
        let sample = Sample {
            key: sample.key_expr().to_string(),
            payload: Arc::from(sample.payload().to_bytes().as_ref()),
            origin,
        };
        let bytes =
            sample.key.len() + sample.payload.len() + attachment.map_or(0, |bytes| bytes.len());
        let sender = sample.origin.as_ref().map_or("", |origin| &origin.sender);
        counters.count_received(sender, bytes);
        inbox.deliver(LinkEvent::Sample(sample), &counters);
    };
    session
        .declare_subscriber(key)
        .callback(receive)
        .background()
        .wait()
        .map_err(|error| LinkError::declare(key, &error))
}

pub(super) fn declare_alive(session: &zenoh::Session, id: &str) -> Result<(), LinkError> {
    let key = format!("vehicle/{id}/alive");
    let token = session
        .liveliness()
        .declare_token(&key)
        .wait()
        .map_err(|error| LinkError::declare(&key, &error))?;
    // The token lives as long as the session.
    std::mem::forget(token);
    Ok(())
}

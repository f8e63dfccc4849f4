//! Asking others.

use std::sync::Arc;
use std::time::Duration;

use zenoh::Wait;
use zenoh::handlers::CallbackDrop;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget, Selector};
use zenoh::sample::Locality;

use super::error::plain;
use super::{Counters, Inbox, LinkError, LinkEvent, RequestId};

/// One reply to [`ask`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    pub key: String,
    pub payload: Arc<[u8]>,
}

/// Why nobody could be asked.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    #[error(transparent)]
    Session(#[from] LinkError),
    #[error("cannot ask {selector:?}: {reason}")]
    Selector { selector: String, reason: String },
}

/// Asks as a client, without being part of the team, and waits for all replies.
pub fn ask(
    endpoints: &[String],
    selector: &str,
    timeout: Duration,
) -> Result<Vec<Reply>, ClientError> {
    let refuse = |error: zenoh::Error| ClientError::Selector {
        selector: selector.to_owned(),
        reason: plain(&error.to_string()),
    };
    // Before anybody is looked for who could be asked.
    let selector = Selector::try_from(selector).map_err(refuse)?;
    let session = super::session::open_client(endpoints)?;
    let replies = session
        .get(&selector)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .timeout(timeout)
        .wait()
        .map_err(refuse)?;
    let mut received = Vec::new();
    while let Ok(reply) = replies.recv() {
        match reply.result() {
            Ok(sample) => received.push(Reply {
                key: sample.key_expr().to_string(),
                payload: Arc::from(sample.payload().to_bytes().as_ref()),
            }),
            Err(error) => {
                let reason = error.payload().try_to_string();
                tracing::debug!(?reason, "a holder answered with an error");
            }
        }
    }
    let _ = session.close().wait();
    Ok(received)
}

pub(super) fn request(
    session: &zenoh::Session,
    request: RequestId,
    selector: &str,
    timeout: Duration,
    inbox: &Inbox,
    counters: &Arc<Counters>,
) {
    let (reply_inbox, reply_counters) = (inbox.clone(), Arc::clone(counters));
    let receive = move |reply: zenoh::query::Reply| {
        let Ok(sample) = reply.result() else {
            return;
        };
        let key = sample.key_expr().to_string();
        let payload: Arc<[u8]> = Arc::from(sample.payload().to_bytes().as_ref());
        reply_counters.count_received("", key.len() + payload.len());
        let event = LinkEvent::Reply {
            request,
            key,
            payload,
        };
        reply_inbox.deliver(event, &reply_counters);
    };
    let (end_inbox, end_counters) = (inbox.clone(), Arc::clone(counters));
    let end = move || end_inbox.deliver(LinkEvent::RequestEnded { request }, &end_counters);
    let asked = session
        .get(selector)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .allowed_destination(Locality::Remote)
        .priority(Priority::Background)
        .congestion_control(CongestionControl::Block)
        .timeout(timeout)
        .with(CallbackDrop {
            callback: receive,
            drop: end,
        })
        .wait();
    if let Err(error) = asked {
        // The handler was dropped with the failed get, so the end has been delivered.
        tracing::debug!(%error, selector, "get failed");
    }
}

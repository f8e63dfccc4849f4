//! Where everything that arrives waits for the vehicle's own loop, as plain data.

use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError};

use super::{Class, Counters};

/// Names a request so that its replies find their way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(pub u64);

/// A message that somebody published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    pub key: String,
    pub payload: Arc<[u8]>,
    /// The vehicle that published it and its count in that class; absent from other programs.
    pub origin: Option<Origin>,
}

/// Who published a message, and its place in that vehicle's stream of one class.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Origin {
    pub sender: String,
    pub class: Class,
    pub sequence: u64,
}

/// What happens on the link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    Sample(Sample),
    Reply {
        request: RequestId,
        key: String,
        payload: Arc<[u8]>,
    },
    /// No more replies will come. This does not say that all came.
    RequestEnded {
        request: RequestId,
    },
    NeighbourCame {
        name: String,
    },
    NeighbourLeft {
        name: String,
    },
}

/// The sending end of a bounded queue of events.
#[derive(Clone)]
pub struct Inbox {
    deliver: Arc<dyn Fn(LinkEvent) -> bool + Send + Sync>,
}

/// An inbox in front of a caller's queue, into which `wrap` turns events.
pub fn inbox<T: Send + 'static>(
    queue: SyncSender<T>,
    wrap: impl Fn(LinkEvent) -> T + Send + Sync + 'static,
) -> Inbox {
    let deliver = move |event| match queue.try_send(wrap(event)) {
        Ok(()) => true,
        // A queue whose reader has gone needs nothing any more.
        Err(TrySendError::Disconnected(_)) => true,
        Err(TrySendError::Full(_)) => false,
    };
    Inbox {
        deliver: Arc::new(deliver),
    }
}

impl Inbox {
    pub(super) fn deliver(&self, event: LinkEvent, counters: &Counters) {
        if !(self.deliver)(event) {
            counters.count_dropped();
        }
    }
}

/// The attachment of every message: the class, its count, and the sender's name.
pub(super) fn encode_origin(sender: &str, class: Class, sequence: u64) -> Vec<u8> {
    let mut bytes = vec![class as u8];
    bytes.extend_from_slice(&sequence.to_le_bytes());
    bytes.extend_from_slice(sender.as_bytes());
    bytes
}

pub(super) fn decode_origin(bytes: &[u8]) -> Option<Origin> {
    let (&class, rest) = bytes.split_first()?;
    let (sequence, sender) = rest.split_first_chunk::<8>()?;
    let sender = std::str::from_utf8(sender).ok()?;
    (sender.len() <= 64).then_some(())?;
    Some(Origin {
        sender: sender.to_owned(),
        class: Class::from_byte(class)?,
        sequence: u64::from_le_bytes(*sequence),
    })
}

//! Three classes of traffic, so that a slow link delays maps and never a pose.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;

use super::Counters;
use super::inbox::encode_origin;

/// How a message travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[repr(u8)]
pub enum Class {
    /// Chunks: behind everything else, waits when the link is slow.
    Bulk = 0,
    /// Beacons, manifests and placements: small, waits.
    Notice = 1,
    /// Poses: dropped when the link is slow.
    Telemetry = 2,
}

impl Class {
    pub const COUNT: usize = 3;

    pub(super) fn from_byte(byte: u8) -> Option<Self> {
        [Self::Bulk, Self::Notice, Self::Telemetry]
            .into_iter()
            .find(|class| *class as u8 == byte)
    }

    fn quality(self) -> (Priority, CongestionControl) {
        match self {
            Self::Bulk => (Priority::Background, CongestionControl::Block),
            Self::Notice => (Priority::Data, CongestionControl::Block),
            Self::Telemetry => (Priority::DataHigh, CongestionControl::Drop),
        }
    }
}

/// Messages that wait in one class; the newest is dropped beyond that, and a beacon makes up
/// for it.
const QUEUE_LIMIT: usize = 4096;

struct Outgoing {
    key: String,
    payload: Arc<[u8]>,
    attachment: Vec<u8>,
}

/// Numbers messages and hands them to one thread per class, because a put may block for seconds.
pub(super) struct Publisher {
    id: String,
    sent: [u64; Class::COUNT],
    queues: Vec<SyncSender<Outgoing>>,
    threads: Vec<JoinHandle<()>>,
    counters: Arc<Counters>,
}

impl Publisher {
    pub fn start(session: zenoh::Session, id: String, counters: Arc<Counters>) -> Self {
        let mut queues = Vec::new();
        let mut threads = Vec::new();
        for class in [Class::Bulk, Class::Notice, Class::Telemetry] {
            let (sender, receiver) = sync_channel(QUEUE_LIMIT);
            let (session, counters) = (session.clone(), Arc::clone(&counters));
            queues.push(sender);
            threads.push(std::thread::spawn(move || {
                put_all(&session, class, &receiver, &counters);
            }));
        }
        Self {
            id,
            sent: [0; Class::COUNT],
            queues,
            threads,
            counters,
        }
    }

    pub fn publish(&mut self, class: Class, key: &str, payload: Arc<[u8]>) {
        let sequence = self.sent[class as usize] + 1;
        let message = Outgoing {
            key: key.to_owned(),
            payload,
            attachment: encode_origin(&self.id, class, sequence),
        };
        match self.queues[class as usize].try_send(message) {
            Ok(()) => self.sent[class as usize] = sequence,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.counters.count_dropped();
            }
        }
    }

    pub fn sent(&self) -> [u64; Class::COUNT] {
        self.sent
    }

    /// Closes the queues and waits until they have drained; a thread that is stuck is left.
    pub fn finish(self, patience: Duration) {
        drop(self.queues);
        let deadline = Instant::now() + patience;
        for thread in self.threads {
            while !thread.is_finished() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
    }
}

fn put_all(
    session: &zenoh::Session,
    class: Class,
    queue: &Receiver<Outgoing>,
    counters: &Counters,
) {
    let (priority, congestion_control) = class.quality();
    while let Ok(message) = queue.recv() {
        let bytes = message.key.len() + message.payload.len() + message.attachment.len();
        let put = session
            .put(message.key.as_str(), message.payload.as_ref())
            .priority(priority)
            .congestion_control(congestion_control)
            .allowed_destination(Locality::Remote)
            .attachment(message.attachment);
        match put.wait() {
            Ok(()) => counters.count_published(bytes),
            Err(error) => tracing::debug!(%error, key = message.key, "put failed"),
        }
    }
}

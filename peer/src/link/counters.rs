//! What went through the link.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Totals since the start. Bytes are those of keys, payloads and attachments, before zenoh's
/// framing; what is sent to several neighbours counts once for each.
#[derive(Debug, Default)]
pub struct Counters {
    sent_bytes: AtomicU64,
    received_bytes: AtomicU64,
    /// Events that found the inbox full.
    dropped: AtomicU64,
    neighbour_count: AtomicU64,
    received_by_sender: Mutex<BTreeMap<String, Traffic>>,
}

/// What came from one vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    pub message_count: u64,
    pub bytes: u64,
}

impl Counters {
    pub fn sent_bytes(&self) -> u64 {
        self.sent_bytes.load(Ordering::Relaxed)
    }

    pub fn received_bytes(&self) -> u64 {
        self.received_bytes.load(Ordering::Relaxed)
    }

    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    pub fn neighbour_count(&self) -> u64 {
        self.neighbour_count.load(Ordering::Relaxed)
    }

    pub fn received_by_sender(&self) -> BTreeMap<String, Traffic> {
        self.lock().clone()
    }

    pub(super) fn count_sent(&self, bytes: usize) {
        self.sent_bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(super) fn count_published(&self, bytes: usize) {
        self.count_sent(bytes * self.neighbour_count() as usize);
    }

    pub(super) fn count_received(&self, sender: &str, bytes: usize) {
        self.received_bytes
            .fetch_add(bytes as u64, Ordering::Relaxed);
        let mut by_sender = self.lock();
        // Senders' names come from the wire; strangers beyond the limit share one entry.
        let name = if by_sender.len() < SENDER_LIMIT || by_sender.contains_key(sender) {
            sender
        } else {
            ""
        };
        let traffic = by_sender.entry(name.to_owned()).or_default();
        traffic.message_count += 1;
        traffic.bytes += bytes as u64;
    }

    pub(super) fn count_dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn neighbour_came(&self) {
        self.neighbour_count.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn neighbour_left(&self) {
        let less_one = |count: u64| count.checked_sub(1);
        let _ = self
            .neighbour_count
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, less_one);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, Traffic>> {
        self.received_by_sender
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

const SENDER_LIMIT: usize = 256;

//! The vehicle's place in the network. The only module that knows zenoh.
//!
//! zenoh moves data and guarantees nothing: a put that returned may never arrive. So all that is
//! sure happens above, by beacons and pulls; here are one session, three classes of traffic that
//! cannot hold each other up, and counters.

mod answer;
mod counters;
mod error;
mod inbox;
mod publisher;
mod question;
mod session;

use std::sync::Arc;
use std::time::Duration;

use zenoh::Wait;

pub use answer::{Answer, Holdings, Question};
pub use counters::{Counters, Traffic};
pub use error::LinkError;
pub use inbox::{Inbox, LinkEvent, Origin, RequestId, Sample, inbox};
pub use publisher::Class;
pub use question::{ClientError, Reply, ask};

use crate::config::ZenohConfig;
use publisher::Publisher;

/// How long a request waits for its holder.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(3);

/// What of zenoh's own log is worth reading. While a link heals, its session calls what arrives
/// before its key an error; beacons make up for it.
pub const LOG_LEVELS: &str = "zenoh=error,zenoh::api::session=off";

/// What a vehicle subscribes to.
pub const SUBSCRIPTIONS: [&str; 5] = [
    "anchor/*/map",
    "anchor/*/map/*/*",
    "anchor/*/placement/**",
    "vehicle/*/have",
    "vehicle/*/pose",
];

/// An open session with everything declared.
pub struct Link {
    session: zenoh::Session,
    publisher: Publisher,
    counters: Arc<Counters>,
    inbox: Inbox,
    id: String,
}

impl Link {
    /// Opens a session and declares subscriptions, queryables and the token of life.
    ///
    /// - `holdings`: answers questions, on a thread of the link's own.
    /// - `inbox`: takes everything that arrives; when it is full, news are dropped and counted,
    ///   and the next beacon brings them back.
    pub fn open(
        id: &str,
        config: &ZenohConfig,
        holdings: Arc<dyn Holdings>,
        inbox: Inbox,
    ) -> Result<Self, LinkError> {
        let session = session::open(config)?;
        let counters = Arc::new(Counters::default());
        let link = Self {
            publisher: Publisher::start(session.clone(), id.to_owned(), Arc::clone(&counters)),
            session,
            counters,
            inbox,
            id: id.to_owned(),
        };
        session::watch_neighbours(&link.session, &link.inbox, &link.counters)?;
        for key in SUBSCRIPTIONS {
            session::subscribe(&link.session, key, &link.inbox, &link.counters)?;
        }
        answer::declare(&link.session, id, holdings, &link.counters)?;
        session::declare_alive(&link.session, id)?;
        Ok(link)
    }

    /// Where this session can be reached, with the ports that were really taken.
    pub fn endpoints(&self) -> Vec<String> {
        let locators = self.session.info().locators().wait();
        locators.iter().map(ToString::to_string).collect()
    }

    /// Queues a message for everybody who listens. Never waits for the network.
    pub fn publish(&mut self, class: Class, key: &str, payload: Arc<[u8]>) {
        self.publisher.publish(class, key, payload);
    }

    /// Asks for `selector`; each reply and the end arrive in the inbox under `request`.
    pub fn request(&self, request: RequestId, selector: &str) {
        question::request(
            &self.session,
            request,
            selector,
            REQUEST_TIMEOUT,
            &self.inbox,
            &self.counters,
        );
    }

    /// How many messages of each class have been handed to zenoh's queues or wait for it.
    pub fn sent(&self) -> [u64; Class::COUNT] {
        self.publisher.sent()
    }

    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    pub fn id(&self) -> &str {
        &self.id
    }

    /// Sends what is queued, for at most `patience`, and leaves the network.
    pub fn close(self, patience: Duration) {
        self.publisher.finish(patience);
        if let Err(error) = self.session.close().wait() {
            tracing::debug!(%error, "zenoh did not close cleanly");
        }
    }
}

#[cfg(test)]
mod tests;

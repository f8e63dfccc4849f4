//! Between a parent and its vehicles: one JSON object a line, orders on stdin, reports on stdout.

use std::collections::BTreeMap;
use std::io::BufRead;
use std::sync::mpsc::SyncSender;

use serde::{Deserialize, Serialize};

use super::{Arrival, VehicleSummary};

/// What a parent wants.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum Order {
    /// Send a beacon, so that it becomes known that messages come through.
    Greet { now_ns: i64 },
    /// It is this time on the vehicle's clock: apply what was sent before, then all inputs up to
    /// it.
    Tick {
        tick: u64,
        now_ns: i64,
        /// How many messages each vehicle had sent when the tick began. A faster vehicle's newer
        /// ones may have arrived already; they wait for the next tick.
        sent_before: BTreeMap<String, Counted>,
    },
    /// Send the requests that the tick brought. Everybody is done with it, so that a holder
    /// answers from the same holdings in every run.
    Ask,
    /// Write the files and end.
    Finish,
}

/// How many messages of a class that must arrive: bulk and notices, not poses.
pub type Counted = [u64; 2];

/// What a vehicle says.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "report", rename_all = "snake_case")]
pub enum Report {
    /// The session is open.
    Listening {
        endpoints: Vec<String>,
        first_captured_at_ns: Option<i64>,
    },
    /// All that belonged to the tick is done, its poses are published.
    TickDone {
        tick: u64,
        sent: Counted,
        /// Requests that wait for [`Order::Ask`] or for their end.
        open_request_count: usize,
    },
    /// The number of the newest message of each class, by sender.
    Heard {
        heard: BTreeMap<String, Counted>,
        open_request_count: usize,
        neighbour_count: usize,
    },
    Finished {
        summary: Box<VehicleSummary>,
    },
    /// It ends without having flown. The log says so too, unless its disk is full.
    Failed {
        error: String,
    },
}

/// Reads orders until the parent closes the pipe, which is also what its death does.
pub(super) fn read_orders(arrivals: &SyncSender<Arrival>) {
    for line in std::io::stdin().lock().lines() {
        let Ok(line) = line else { break };
        match serde_json::from_str(&line) {
            Ok(order) => {
                if arrivals.send(Arrival::Order(order)).is_err() {
                    return;
                }
            }
            Err(error) => tracing::warn!(%error, "order ignored"),
        }
    }
    // The loop may have ended already.
    let _ = arrivals.send(Arrival::OrdersEnded);
}

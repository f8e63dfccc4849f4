//! A vehicle on its parent's clock: what arrived is applied in one order, whatever order it
//! arrived in, so that two runs agree.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError};

use geometry::Timestamp;

use super::Arrival;
use super::control::{Counted, Order, Report};
use super::input::{Input, Source};
use super::interrupt;
use super::vehicle::Vehicle;
use crate::link::{Class, LinkEvent};
use crate::node::Event;

/// Runs until the parent says so or is gone, or somebody ends this vehicle alone.
pub(super) fn run(
    vehicle: &mut Vehicle,
    source: &mut dyn Source,
    arrivals: &Receiver<Arrival>,
    report: &mut dyn FnMut(&Report),
) {
    vehicle.hold_requests();
    let mut waiting = Waiting::default();
    let mut pending: Option<Input> = None;
    while !interrupt::wished() {
        let arrival = match arrivals.recv_timeout(interrupt::GLANCE) {
            Ok(arrival) => arrival,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        match arrival {
            Arrival::Link(event) => {
                waiting.push(event);
                // One report for all that is there already.
                while let Ok(next) = arrivals.try_recv() {
                    match next {
                        Arrival::Link(event) => waiting.push(event),
                        Arrival::Order(order) => {
                            report(&waiting.heard(vehicle));
                            if !obey(vehicle, source, &mut waiting, &mut pending, &order, report) {
                                return;
                            }
                        }
                        Arrival::OrdersEnded => return,
                        Arrival::Input(_) => {}
                    }
                }
                report(&waiting.heard(vehicle));
            }
            Arrival::Order(order) => {
                if !obey(vehicle, source, &mut waiting, &mut pending, &order, report) {
                    return;
                }
            }
            Arrival::OrdersEnded => return,
            Arrival::Input(_) => {}
        }
    }
}

/// Carries out an order; false if it was the last.
fn obey(
    vehicle: &mut Vehicle,
    source: &mut dyn Source,
    waiting: &mut Waiting,
    pending: &mut Option<Input>,
    order: &Order,
    report: &mut dyn FnMut(&Report),
) -> bool {
    match order {
        Order::Greet { now_ns } => vehicle.greet(Timestamp::from_nanoseconds(*now_ns)),
        Order::Tick {
            tick,
            now_ns,
            sent_before,
        } => {
            let now = Timestamp::from_nanoseconds(*now_ns);
            for event in waiting.take_in_order(sent_before) {
                vehicle.take_link(event, now);
            }
            take_inputs(vehicle, source, pending, now);
            vehicle.take(Event::Tick, now);
            report(&Report::TickDone {
                tick: *tick,
                sent: vehicle.sent(),
                open_request_count: vehicle.open_request_count(),
            });
            report(&waiting.heard(vehicle));
        }
        Order::Ask => vehicle.ask(),
        Order::Finish => return false,
    }
    true
}

fn take_inputs(
    vehicle: &mut Vehicle,
    source: &mut dyn Source,
    pending: &mut Option<Input>,
    now: Timestamp,
) {
    while let Some(input) = pending.take().or_else(|| source.next_input()) {
        if matches!(input, Input::End) {
            return;
        }
        if input.captured_at() > now {
            *pending = Some(input);
            return;
        }
        let captured_at = input.captured_at();
        vehicle.take_input(input, captured_at);
    }
}

/// What arrived since the last tick, and how far each sender's messages have come.
#[derive(Default)]
struct Waiting {
    events: Vec<LinkEvent>,
    heard: BTreeMap<String, Counted>,
    ended_request_count: usize,
    neighbour_count: usize,
}

impl Waiting {
    fn push(&mut self, event: LinkEvent) {
        match &event {
            LinkEvent::Sample(sample) => {
                if let Some(origin) = &sample.origin
                    && let Some(class_idx) = counted(origin.class)
                {
                    let heard = self.heard.entry(origin.sender.clone()).or_default();
                    heard[class_idx] = heard[class_idx].max(origin.sequence);
                }
            }
            LinkEvent::RequestEnded { .. } => self.ended_request_count += 1,
            LinkEvent::NeighbourCame { .. } => self.neighbour_count += 1,
            LinkEvent::NeighbourLeft { .. } => {
                self.neighbour_count = self.neighbour_count.saturating_sub(1);
            }
            LinkEvent::Reply { .. } => {}
        }
        self.events.push(event);
    }

    fn heard(&self, vehicle: &Vehicle) -> Report {
        let open_request_count = vehicle.open_request_count();
        Report::Heard {
            heard: self.heard.clone(),
            open_request_count: open_request_count.saturating_sub(self.ended_request_count),
            neighbour_count: self.neighbour_count,
        }
    }

    /// What was sent before the tick; chunks come before the beacons that mention them.
    fn take_in_order(&mut self, sent_before: &BTreeMap<String, Counted>) -> Vec<LinkEvent> {
        self.ended_request_count = 0;
        let (mut due, early): (Vec<_>, Vec<_>) = std::mem::take(&mut self.events)
            .into_iter()
            .partition(|event| is_due(event, sent_before));
        self.events = early;
        due.sort_by_cached_key(rank);
        due
    }
}

/// Whether a message was sent before the tick. What nobody counts is due when it is here.
fn is_due(event: &LinkEvent, sent_before: &BTreeMap<String, Counted>) -> bool {
    let LinkEvent::Sample(sample) = event else {
        return true;
    };
    let limit = sample.origin.as_ref().and_then(|origin| {
        let sent = sent_before.get(&origin.sender)?;
        Some((origin.sequence, sent[counted(origin.class)?]))
    });
    limit.is_none_or(|(sequence, sent)| sequence <= sent)
}

/// The class's place in [`Counted`]; poses may be dropped and are not waited for.
pub(super) fn counted(class: Class) -> Option<usize> {
    match class {
        Class::Bulk => Some(0),
        Class::Notice => Some(1),
        Class::Telemetry => None,
    }
}

type Rank = (u8, Option<crate::link::Origin>, u64, String, Vec<u8>);

fn rank(event: &LinkEvent) -> Rank {
    match event {
        LinkEvent::NeighbourLeft { .. } => (0, None, 0, String::new(), Vec::new()),
        LinkEvent::NeighbourCame { .. } => (1, None, 0, String::new(), Vec::new()),
        LinkEvent::Sample(sample) => {
            let class = sample
                .origin
                .as_ref()
                .map_or(3, |origin| origin.class as u8);
            let payload = match sample.origin {
                Some(_) => Vec::new(),
                None => sample.payload.to_vec(),
            };
            (
                2 + class,
                sample.origin.clone(),
                0,
                sample.key.clone(),
                payload,
            )
        }
        LinkEvent::Reply {
            request,
            key,
            payload,
        } => (6, None, request.0, key.clone(), payload.to_vec()),
        LinkEvent::RequestEnded { request } => (7, None, request.0, String::new(), Vec::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{Origin, Sample};

    fn notice(sender: &str, sequence: u64) -> LinkEvent {
        LinkEvent::Sample(Sample {
            key: format!("vehicle/{sender}/have"),
            payload: Vec::new().into(),
            origin: Some(Origin {
                sender: sender.to_owned(),
                class: Class::Notice,
                sequence,
            }),
        })
    }

    #[test]
    fn a_message_of_the_running_tick_waits_however_early_it_is() {
        let mut waiting = Waiting::default();
        waiting.push(notice("b", 3));
        waiting.push(notice("a", 5));
        waiting.push(notice("a", 4));
        let sent_before = BTreeMap::from([("a".to_owned(), [0, 4]), ("b".to_owned(), [0, 3])]);
        let due = waiting.take_in_order(&sent_before);
        assert_eq!(due, [notice("a", 4), notice("b", 3)]);
        let sent_before = BTreeMap::from([("a".to_owned(), [0, 5])]);
        assert_eq!(waiting.take_in_order(&sent_before), [notice("a", 5)]);
    }

    #[test]
    fn a_message_from_outside_the_team_is_due_at_once() {
        let mut waiting = Waiting::default();
        waiting.push(notice("stranger", 9));
        assert_eq!(waiting.take_in_order(&BTreeMap::new()).len(), 1);
    }
}

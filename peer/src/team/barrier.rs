//! When a tick is over: everybody is done, and what was sent over links that are up has arrived.

use std::collections::BTreeMap;

use super::links::LinkPair;
use crate::process::control::Counted;

/// What each vehicle has sent and heard, and which links count.
pub struct Barrier {
    ids: Vec<String>,
    tick: u64,
    done: Vec<bool>,
    sent: Vec<Counted>,
    heard: Vec<BTreeMap<String, Counted>>,
    open_request_count: Vec<usize>,
    neighbour_count: Vec<usize>,
    /// By sender and receiver.
    streams: BTreeMap<(usize, usize), Stream>,
    stalled: bool,
}

/// Messages from one vehicle to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stream {
    /// All that is sent beyond these numbers arrives.
    Up {
        floor: Counted,
    },
    Cut,
    /// The link may work again; it counts once a notice beyond this number has come through.
    Healing {
        notice_before: u64,
    },
}

impl Barrier {
    pub fn new(ids: Vec<String>) -> Self {
        let count = ids.len();
        let mut streams = BTreeMap::new();
        for sender_idx in 0..count {
            for receiver_idx in (0..count).filter(|idx| *idx != sender_idx) {
                streams.insert((sender_idx, receiver_idx), Stream::Up { floor: [0, 0] });
            }
        }
        Self {
            tick: 0,
            done: vec![false; count],
            sent: vec![[0, 0]; count],
            heard: vec![BTreeMap::new(); count],
            open_request_count: vec![0; count],
            neighbour_count: vec![0; count],
            streams,
            stalled: false,
            ids,
        }
    }

    pub fn id(&self, vehicle_idx: usize) -> &str {
        &self.ids[vehicle_idx]
    }

    /// How many messages each vehicle had sent at the end of the last tick.
    pub fn sent_so_far(&self) -> BTreeMap<String, Counted> {
        let ids = self.ids.iter().cloned();
        ids.zip(self.sent.iter().copied()).collect()
    }

    /// Also that each has noticed its neighbours, which it would tell in a later tick otherwise.
    pub fn everybody_heard_everybody(&self) -> bool {
        let others_count = self.ids.len() - 1;
        let noticed = |count: &usize| *count >= others_count;
        self.neighbour_count.iter().all(noticed) && self.silent().next().is_none()
    }

    /// Who has not heard whom, for an error.
    pub fn silent_pairs(&self) -> String {
        let pairs = self.silent().map(|(sender_idx, receiver_idx)| {
            format!("{} not {}", self.ids[receiver_idx], self.ids[sender_idx])
        });
        pairs.collect::<Vec<_>>().join(", ")
    }

    pub fn begin(&mut self, tick: u64) {
        self.tick = tick;
        self.done.fill(false);
    }

    pub fn take_done(
        &mut self,
        vehicle_idx: usize,
        tick: u64,
        sent: Counted,
        open_request_count: usize,
    ) {
        self.open_request_count[vehicle_idx] = open_request_count;
        self.sent[vehicle_idx] = sent;
        self.done[vehicle_idx] = tick == self.tick;
    }

    pub fn take_heard(
        &mut self,
        vehicle_idx: usize,
        heard: &BTreeMap<String, Counted>,
        open_request_count: usize,
    ) {
        self.heard[vehicle_idx].clone_from(heard);
        self.open_request_count[vehicle_idx] = open_request_count;
    }

    pub fn take_neighbours(&mut self, vehicle_idx: usize, neighbour_count: usize) {
        self.neighbour_count[vehicle_idx] = neighbour_count;
    }

    /// Those with requests that have not ended.
    pub fn askers(&self) -> Vec<usize> {
        let counts = self.open_request_count.iter().enumerate();
        counts
            .filter(|(_, count)| **count > 0)
            .map(|(idx, _)| idx)
            .collect()
    }

    pub fn first_not_done(&self) -> Option<usize> {
        self.done.iter().position(|done| !done)
    }

    /// Whether the next tick may begin.
    pub fn is_passed(&mut self) -> bool {
        if self.first_not_done().is_some() {
            return false;
        }
        self.notice_healed();
        let requests_ended = self.open_request_count.iter().all(|count| *count == 0);
        requests_ended && self.late().next().is_none()
    }

    /// What has not arrived is not waited for any longer.
    pub fn give_up(&mut self) {
        let late: Vec<(usize, usize)> = self.late().collect();
        for (sender_idx, receiver_idx) in late {
            let (sender, receiver) = (&self.ids[sender_idx], &self.ids[receiver_idx]);
            tracing::warn!(sender, receiver, "messages are late; going on without them");
            let stream = self.healing(sender_idx);
            self.streams.insert((sender_idx, receiver_idx), stream);
        }
        self.open_request_count.fill(0);
        self.stalled = true;
    }

    pub fn stalled(&self) -> bool {
        self.stalled
    }

    /// The link was cut, or is healed.
    pub fn set_up(&mut self, pair: LinkPair, up: bool) {
        let (a, b) = (pair.server_idx, pair.client_idx);
        for (sender_idx, receiver_idx) in [(a, b), (b, a)] {
            let stream = if up {
                self.healing(sender_idx)
            } else {
                Stream::Cut
            };
            self.streams.insert((sender_idx, receiver_idx), stream);
        }
    }

    fn heard_from(&self, sender_idx: usize, receiver_idx: usize) -> Counted {
        let heard = self.heard[receiver_idx].get(&self.ids[sender_idx]);
        heard.copied().unwrap_or_default()
    }

    fn healing(&self, sender_idx: usize) -> Stream {
        Stream::Healing {
            notice_before: self.sent[sender_idx][1],
        }
    }

    fn notice_healed(&mut self) {
        let healed = self.streams.iter().filter_map(|(pair, stream)| {
            let Stream::Healing { notice_before } = *stream else {
                return None;
            };
            let (sent, heard) = (self.sent[pair.0][1], self.heard_from(pair.0, pair.1)[1]);
            (heard > notice_before && heard >= sent).then_some(*pair)
        });
        let healed: Vec<(usize, usize)> = healed.collect();
        for pair in healed {
            let floor = self.sent[pair.0];
            self.streams.insert(pair, Stream::Up { floor });
        }
    }

    fn late(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.streams.iter().filter_map(|(pair, stream)| {
            let Stream::Up { floor } = stream else {
                return None;
            };
            let (sent, heard) = (self.sent[pair.0], self.heard_from(pair.0, pair.1));
            let late = (0..2).any(|class| sent[class] > floor[class] && heard[class] < sent[class]);
            late.then_some(*pair)
        })
    }

    fn silent(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let pairs = self.streams.keys().copied();
        pairs.filter(|(sender_idx, receiver_idx)| {
            self.heard_from(*sender_idx, *receiver_idx)[1] == 0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(barrier: &mut Barrier, receiver_idx: usize, sender: &str, counts: Counted) {
        let heard = BTreeMap::from([(sender.to_owned(), counts)]);
        barrier.take_heard(receiver_idx, &heard, 0);
    }

    #[test]
    fn a_tick_waits_for_what_was_sent_over_links_that_are_up() {
        let mut barrier = Barrier::new(vec!["a".into(), "b".into()]);
        heard(&mut barrier, 0, "b", [0, 1]);
        heard(&mut barrier, 1, "a", [0, 1]);
        barrier.take_neighbours(0, 1);
        assert!(!barrier.everybody_heard_everybody(), "b's link came later");
        barrier.take_neighbours(1, 1);
        assert!(barrier.everybody_heard_everybody());
        barrier.begin(1);
        barrier.take_done(0, 1, [1, 1], 0);
        assert!(!barrier.is_passed(), "b is not done");
        barrier.take_done(1, 1, [0, 1], 0);
        assert!(!barrier.is_passed(), "a's chunk is on its way");
        heard(&mut barrier, 1, "a", [1, 1]);
        assert!(barrier.is_passed());
    }

    #[test]
    fn a_tick_waits_for_the_answers_to_what_it_asked() {
        let mut barrier = Barrier::new(vec!["a".into(), "b".into()]);
        barrier.begin(1);
        barrier.take_done(0, 1, [0, 0], 0);
        barrier.take_done(1, 1, [0, 0], 2);
        assert_eq!(barrier.askers(), [1]);
        assert!(!barrier.is_passed());
        barrier.take_heard(1, &BTreeMap::new(), 0);
        assert!(barrier.is_passed());
    }

    #[test]
    fn a_healed_link_counts_again_once_a_new_notice_came_through() {
        let mut barrier = Barrier::new(vec!["a".into(), "b".into()]);
        heard(&mut barrier, 0, "b", [0, 1]);
        heard(&mut barrier, 1, "a", [0, 1]);
        let pair = LinkPair {
            server_idx: 0,
            client_idx: 1,
        };
        barrier.set_up(pair, false);
        let tick = |barrier: &mut Barrier, number: u64, sent: Counted| {
            barrier.begin(number);
            barrier.take_done(0, number, sent, 0);
            barrier.take_done(1, number, [0, 1], 0);
            barrier.is_passed()
        };
        assert!(
            tick(&mut barrier, 1, [5, 4]),
            "nothing is expected over a cut link"
        );
        barrier.set_up(pair, true);
        assert!(
            tick(&mut barrier, 2, [6, 4]),
            "it may take a while to come back"
        );
        heard(&mut barrier, 1, "a", [0, 4]);
        assert!(tick(&mut barrier, 2, [7, 5]), "what is old shows nothing");
        heard(&mut barrier, 1, "a", [0, 5]);
        assert!(
            tick(&mut barrier, 3, [7, 5]),
            "what was lost before is not waited for"
        );
        assert!(!tick(&mut barrier, 4, [8, 5]), "what is sent now is");
    }
}

//! The vehicle's loop body: events to the node, its effects to store, link and files.

use std::sync::Arc;
use std::time::{Duration, Instant};

use geometry::Timestamp;
use keeping::Obstacle;
use protocol::VehicleState;

use super::VehicleSummary;
use super::autopilot::{Autopilot, KeepingSummary};
use super::control::Counted;
use super::input::{Input, Skipped};
use super::loss::Loss;
use super::outputs::Outputs;
use crate::config::VehicleConfig;
use crate::link::{Class, Inbox, Link, LinkEvent, RequestId};
use crate::node::{Effect, Event, FramePose, Node};
use crate::store::{Reloaded, Store};

/// How long the end waits for messages that are still queued.
const CLOSE_PATIENCE: Duration = Duration::from_secs(5);

/// Node, link, store and files of one vehicle.
pub struct Vehicle {
    node: Node,
    link: Link,
    store: Store,
    outputs: Outputs,
    tally: Tally,
    loss: Loss,
    keeping: Option<KeepingSummary>,
    now: Timestamp,
    newest_pose: Option<Box<FramePose>>,
    /// Requests that wait for a parent's word; without a parent's clock they do not wait.
    held_requests: Option<Vec<(RequestId, String)>>,
}

/// What the summary is made of.
#[derive(Default)]
struct Tally {
    frame_count: u64,
    unreadable_count: u64,
    skipped_fix_count: u64,
    input_error: Option<String>,
    global_frame_count: u64,
    first_captured_at: Option<Timestamp>,
    first_global_at: Option<Timestamp>,
    neighbour_count: u64,
    alone_since: Option<Timestamp>,
    without_link_s: f64,
    frame_ms: Vec<f32>,
}

impl Vehicle {
    /// - `store`, `reloaded`: what is held from before, of which the node has not heard yet.
    pub fn open(
        config: &VehicleConfig,
        mut node: Node,
        (store, reloaded): (Store, Vec<Reloaded>),
        inbox: Inbox,
    ) -> anyhow::Result<Self> {
        for kept in node.recall(reloaded) {
            store.hold(kept);
        }
        let link = Link::open(&config.id, &config.zenoh, Arc::new(store.clone()), inbox)?;
        Ok(Self {
            node,
            link,
            store,
            outputs: Outputs::create(&config.out, &config.id)?,
            tally: Tally::default(),
            loss: Loss::default(),
            keeping: None,
            now: Timestamp::default(),
            newest_pose: None,
            held_requests: None,
        })
    }

    pub fn endpoints(&self) -> Vec<String> {
        self.link.endpoints()
    }

    /// From now on requests wait for [`Self::ask`].
    pub fn hold_requests(&mut self) {
        self.held_requests.get_or_insert_default();
    }

    pub fn ask(&mut self) {
        for (request, selector) in self.held_requests.iter_mut().flat_map(std::mem::take) {
            self.link.request(request, &selector);
        }
    }

    pub fn open_request_count(&self) -> usize {
        self.node.open_request_count()
    }

    /// The numbers of the newest messages that must arrive.
    pub fn sent(&self) -> Counted {
        let sent = self.link.sent();
        [sent[Class::Bulk as usize], sent[Class::Notice as usize]]
    }

    pub fn greet(&mut self, now: Timestamp) {
        let effects = self.node.greet(now);
        self.execute(effects);
    }

    pub fn take_input(&mut self, input: Input, now: Timestamp) {
        match input {
            Input::Frame { captured_at, image } => {
                self.tally.begin_frame(captured_at);
                let began = Instant::now();
                self.take(Event::Frame { captured_at, image }, now);
                self.tally
                    .frame_ms
                    .push(began.elapsed().as_secs_f32() * 1e3);
                self.take(Event::PoseOut, now);
            }
            Input::Unreadable {
                captured_at,
                reason,
            } => {
                self.tally.begin_frame(captured_at);
                self.tally.skip(Skipped::Frame, &reason);
                self.take(Event::Tick, now);
            }
            Input::Fix(fix) => self.take(Event::Fix(fix), now),
            Input::Skipped { what, reason } => {
                self.tally.frame_count += u64::from(what == Skipped::Frame);
                self.tally.skip(what, &reason);
            }
            Input::FixesLeftOut { count, reason } => {
                self.tally.skipped_fix_count += count;
                tracing::warn!("{reason}");
            }
            Input::BrokenOff { reason } => {
                // Whoever waits for the end says so, once.
                self.tally.input_error = Some(reason);
            }
            Input::End => {}
        }
    }

    pub fn take_link(&mut self, event: LinkEvent, now: Timestamp) {
        let event = match event {
            LinkEvent::Sample(sample) => Event::Message {
                key: sample.key,
                payload: sample.payload,
            },
            LinkEvent::Reply {
                request,
                key,
                payload,
            } => Event::Reply {
                request,
                key,
                payload,
            },
            LinkEvent::RequestEnded { request } => Event::RequestEnded { request },
            LinkEvent::NeighbourCame { name } => {
                tracing::info!(name, "link up");
                self.tally.neighbour_came();
                Event::NeighbourCame
            }
            LinkEvent::NeighbourLeft { name } => {
                tracing::info!(name, "link down");
                self.tally.neighbour_left();
                Event::NeighbourLeft
            }
        };
        self.take(event, now);
    }

    pub fn take(&mut self, event: Event, now: Timestamp) {
        self.now = now;
        self.tally.follow_links(now);
        let effects = self.node.handle(event, now);
        self.execute(effects);
    }

    fn execute(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::Keep(kept) => self.loss.note("the store", self.store.keep(kept)),
                Effect::Publish {
                    class,
                    key,
                    payload,
                } => self.link.publish(class, &key.to_string(), payload),
                Effect::Request { request, selector } => match &mut self.held_requests {
                    Some(held) => held.push((request, selector)),
                    None => self.link.request(request, &selector),
                },
                Effect::Posed(pose) => {
                    self.tally.count_pose(&pose);
                    self.outputs
                        .write(&pose, self.node.status(), &mut self.loss);
                    self.newest_pose = Some(pose);
                }
            }
        }
    }

    /// Takes over what the station-keeping loop did; `None` if a fault of its own has ended it.
    pub fn end_station(&mut self, autopilot: Option<Autopilot>) {
        let ended = autopilot.ok_or("it has ended in flight by a fault of its own");
        match ended {
            Ok(autopilot) => {
                self.keeping = Some(autopilot.summary);
                self.loss.add(autopilot.loss);
            }
            Err(reason) => self.loss.note("station-keeping", Err(reason)),
        }
    }

    /// What of the own map is around the vehicle as of its newest frame.
    pub fn obstacles(&self) -> Vec<Obstacle> {
        let pose = self.newest_pose.as_ref();
        pose.map_or_else(Vec::new, |pose| self.node.obstacles(pose, self.now))
    }

    /// Leaves the network and writes what is only known at the end.
    pub fn finish(mut self) -> VehicleSummary {
        let mut summary = self.summary();
        self.loss.note("the store", self.store.close());
        self.outputs
            .write_final(&self.node, &mut summary, &mut self.loss);
        self.link.close(CLOSE_PATIENCE);
        summary
    }

    fn summary(&mut self) -> VehicleSummary {
        let status = self.node.status();
        let tally = &mut self.tally;
        tally.frame_ms.sort_by(f32::total_cmp);
        let counters = self.link.counters();
        let enu_from_map = self.node.enu_from_map(self.now);
        let since_start = |at: Timestamp| Some(at - tally.first_captured_at?);
        VehicleSummary {
            id: self.link.id().to_owned(),
            role: self.node.role_name().to_owned(),
            state: status.state.to_string(),
            reason: status.reason.clone(),
            frame_count: tally.frame_count,
            unreadable_count: tally.unreadable_count,
            skipped_fix_count: tally.skipped_fix_count,
            input_error: tally.input_error.clone(),
            global_frame_count: tally.global_frame_count,
            global_share: (tally.frame_count > 0)
                .then(|| tally.global_frame_count as f64 / tally.frame_count as f64),
            first_global_s: tally.first_global_at.and_then(since_start),
            scale: enu_from_map.map(|enu_from_map| enu_from_map.scale()),
            keyframe_count: self.node.slam().map().keyframe_count(),
            point_count: self.node.slam().map().point_count(),
            bytes_sent: counters.sent_bytes(),
            bytes_received: counters.received_bytes(),
            without_link_s: tally.without_link_s,
            dropped_count: counters.dropped(),
            unwritten_count: 0,
            write_error: None,
            ms_per_frame_p50: quantile(&tally.frame_ms, 0.5),
            ms_per_frame_p99: quantile(&tally.frame_ms, 0.99),
            counters: self.node.counters(),
            keeping: self.keeping.clone(),
        }
    }
}

impl Tally {
    fn begin_frame(&mut self, captured_at: Timestamp) {
        self.frame_count += 1;
        self.first_captured_at.get_or_insert(captured_at);
    }

    /// Counts what cannot be used, and says so for the first of each kind.
    fn skip(&mut self, what: Skipped, reason: &str) {
        let (counted, noun) = match what {
            Skipped::Frame => (&mut self.unreadable_count, "image"),
            Skipped::Fix => (&mut self.skipped_fix_count, "fix"),
        };
        *counted += 1;
        if *counted == 1 {
            tracing::warn!("{noun} skipped, further ones are only counted: {reason}");
        }
    }

    fn count_pose(&mut self, pose: &FramePose) {
        if pose.state == VehicleState::Global && pose.global.is_some() {
            self.global_frame_count += 1;
            self.first_global_at.get_or_insert(pose.captured_at);
        }
    }

    fn neighbour_came(&mut self) {
        self.neighbour_count += 1;
    }

    fn neighbour_left(&mut self) {
        self.neighbour_count = self.neighbour_count.saturating_sub(1);
    }

    /// Adds up the time without any neighbour, from the first frame on.
    fn follow_links(&mut self, now: Timestamp) {
        if let Some(since) = self.alone_since.take() {
            self.without_link_s += now.since(since).as_secs_f64();
        }
        if self.neighbour_count == 0 && self.first_captured_at.is_some() {
            self.alone_since = Some(now);
        }
    }
}

fn quantile(sorted: &[f32], share: f64) -> Option<f64> {
    let last_idx = sorted.len().checked_sub(1)?;
    let idx = (last_idx as f64 * share).round() as usize;
    sorted.get(idx).map(|value| f64::from(*value))
}

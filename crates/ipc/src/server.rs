//! The daemon's side: one object on the bridge thread that publishes, keeps, replays and answers.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server as RequestServer;
use iceoryx2::port::{DegradationAction, DegradationCause, DegradationFn};
use iceoryx2::prelude::*;
use serde::Deserialize;

use super::command::{MAX_RESPONSE_BYTES, Request, Response, Served};
use super::error::IpcError;
use super::error_counts::ErrorCounts;
use super::followers::{FollowerEvent, Followers, Word};
use super::messages::{FeedForwardMessage, FollowRequest, ReplayHeader, SampleMessage};
use super::requests::{self, IncomingRequest, Order, Requests, Ticket};
use super::retain::RetainedLog;
use super::robot::RobotId;
use super::runtime_dir;
use super::sender::Sender;
use super::services::{self, BATCH, REPLAY, SERVER_PATIENCE, ServiceNode, now_ns, patiently};
use plumbline_core::Record;

/// Replay requests handled in one [`Server::poll`], so that a flood of them does not hold up the samples.
const REPLAYS_PER_POLL: usize = 8;
/// Pause between two looks at silent followers.
const CHECK_EVERY_NS: u64 = 250_000_000;

/// What the daemon keeps and when it speaks up.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct ServerSettings {
    /// Records kept for replay, 672 bytes each; the default holds ten minutes at 1 kHz (403 MB when full).
    pub retain: usize,
    /// A follower that says nothing for this long is looked after \[ms\].
    pub silent_ms: u64,
}

impl Default for ServerSettings {
    fn default() -> Self {
        ServerSettings { retain: 600_000, silent_ms: 1000 }
    }
}

/// The daemon's end of all services of one robot. Not `Send`: make it on the thread that uses it, which must not be the
/// real-time thread.
///
/// No method blocks or fails because of a client. Trouble with shared memory is counted and shown in [`Served`].
pub struct Server {
    epoch: u64,
    settings: ServerSettings,
    log: RetainedLog,
    followers: Followers,
    counters: Served,
    troubles: ErrorCounts,
    /// Clients whose connection could not be opened.
    unconnected: Arc<AtomicU64>,
    unconnected_said: u64,
    checked_ns: u64,
    // The ports go before the services, the services before their node.
    samples: Publisher<ipc::Service, [SampleMessage], ()>,
    feed_forward: Publisher<ipc::Service, FeedForwardMessage, ()>,
    replay: RequestServer<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>,
    requests: Requests,
    replay_service: services::Replay,
    command_service: services::Commands,
    node: ServiceNode,
}

impl Server {
    /// Opens all services of `robot`, after cleaning up what a killed daemon left behind.
    ///
    /// # Errors
    /// [`IpcError::Full`] when another daemon serves this robot, [`IpcError::Incompatible`] when a client of another version
    /// keeps the services alive, [`IpcError::Transport`] when shared memory is not usable.
    pub fn open(robot: &RobotId, settings: ServerSettings) -> Result<Server, IpcError> {
        let node = services::serving_node()?;
        node.blocking_cleanup_dead_nodes(Duration::from_secs(1));

        let samples_service = services::serve_samples(&node, robot)?;
        let feed_forward_service = services::serve_feed_forward(&node, robot)?;
        let replay_service = services::serve_replay(&node, robot)?;
        let command_service = services::serve_commands(&node, robot)?;

        let unconnected = Arc::new(AtomicU64::new(0));
        let samples = patiently(&services::samples_name(robot), SERVER_PATIENCE, || {
            let builder = samples_service.publisher_builder().initial_max_slice_len(BATCH);
            let builder = builder.set_degradation_handler(counting(&unconnected));
            Ok(builder.max_loaned_samples(1).backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let feed_forward = patiently(&services::feed_forward_name(robot), SERVER_PATIENCE, || {
            let builder = feed_forward_service.publisher_builder().max_loaned_samples(1);
            let builder = builder.set_degradation_handler(counting(&unconnected));
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let replay = patiently(&services::replay_name(robot), SERVER_PATIENCE, || {
            let builder = replay_service.server_builder().set_request_degradation_handler(counting(&unconnected));
            let builder = builder.set_response_degradation_handler(counting(&unconnected));
            let builder = builder.initial_max_slice_len(REPLAY);
            let builder = builder.max_loaned_responses_per_request(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let commands = patiently(&services::command_name(robot), SERVER_PATIENCE, || {
            let builder = command_service.server_builder().set_request_degradation_handler(counting(&unconnected));
            let builder = builder.set_response_degradation_handler(counting(&unconnected));
            let builder = builder.initial_max_slice_len(MAX_RESPONSE_BYTES);
            // No memory that grows: shared memory may be full by then.
            let builder = builder.allocation_strategy(AllocationStrategy::Static);
            let builder = builder.max_loaned_responses_per_request(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;

        runtime_dir::reserve_mapped()
            .map_err(|error| services::transport("reserving memory for", robot.as_str(), error))?;

        let epoch = new_epoch();
        Ok(Server {
            epoch,
            log: RetainedLog::new(settings.retain),
            settings,
            followers: Followers::default(),
            counters: Served { epoch, ..Served::default() },
            troubles: ErrorCounts::default(),
            unconnected,
            unconnected_said: 0,
            checked_ns: now_ns(),
            samples,
            feed_forward,
            replay,
            requests: Requests::of(commands),
            replay_service,
            command_service,
            node,
        })
    }

    /// Identity of this start of the daemon, not 0.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Keeps `records` and sends them to the followers.
    pub fn publish(&mut self, records: &[Record]) {
        for chunk in records.chunks(BATCH) {
            let (epoch, end) = (self.epoch, self.log.end());
            let message = |i: usize| SampleMessage::new(epoch, end + i as u64, &chunk[i]);
            // Sent before they are kept: the followers need not wait for the log's fresh pages. Who asks for them again does so by `poll`.
            let loan = self.samples.loan_slice_uninit(chunk.len());
            let sent = loan.map_err(|error| error.to_string()).and_then(|memory| {
                memory.write_from_fn(message).send().map(|_followers| ()).map_err(|error| error.to_string())
            });
            if let Err(trouble) = sent {
                self.counters.unsent_batches += 1;
                self.trouble("samples", trouble);
            }
            self.keep((0..chunk.len()).map(message));
        }
    }

    /// Puts `messages` into the log.
    fn keep(&mut self, messages: impl Iterator<Item = SampleMessage>) {
        let first_before = self.log.first();
        messages.for_each(|message| self.log.push(message));
        let unacknowledged_from = first_before.max(self.followers.furthest());
        self.counters.given_up_unacknowledged += self.log.first().saturating_sub(unacknowledged_from);
    }

    /// Replaces the latest feed-forward value; sets its `sequence` and `epoch`, and turns its stamp from the records' clock into the clients'.
    pub fn feed_forward(&mut self, mut message: FeedForwardMessage) {
        self.counters.feed_forward += 1;
        message.sequence = self.counters.feed_forward;
        message.epoch = self.epoch;
        message.stamp_ns = message.stamp_ns.saturating_add(services::suspended_ns());
        if let Err(trouble) = self.feed_forward.send_copy(message) {
            self.trouble("feed-forward", trouble.to_string());
        }
    }

    /// Answers what has arrived: replay by itself, commands through `handle`, heavy ones too. Returns the number of commands handled.
    ///
    /// To be called every few milliseconds; each call takes a bounded time, a heavy request's own apart.
    pub fn poll(&mut self, mut handle: impl FnMut(Request, &Served) -> Response) -> usize {
        let (epoch, mut garbled, mut heavy) = (self.epoch, 0, Vec::new());
        let handled = self.serve(usize::MAX, |asked, served| match asked {
            IncomingRequest::Light(request) => Some(handle(request, served)),
            IncomingRequest::Heavy(ticket, bytes) => {
                let request = requests::read(bytes, epoch).inspect_err(|_| garbled += 1);
                let order = request.as_ref().ok().and_then(Request::order);
                let response = request.map_or_else(|refused| refused, |request| handle(request, served));
                heavy.push((ticket, order, response));
                None
            }
        });
        heavy.iter().for_each(|(ticket, order, response)| self.answer(*ticket, *order, response));
        self.counters.garbled_requests += garbled;
        handled - garbled as usize
    }

    /// Answers what has arrived: replay by itself, light requests through `answer`, one client as much as any other. As many heavy requests as
    /// there is `room` for are given to `answer`, too, which returns `None` for them: [`Server::answer`] has the answer later. The others wait.
    pub fn serve(&mut self, room: usize, answer: impl FnMut(IncomingRequest, &Served) -> Option<Response>) -> usize {
        self.poll_replay();
        self.look_after_followers();
        self.look_after_connections();
        if let Err(trouble) = self.requests.take_in() {
            self.trouble("command", trouble);
        }
        if self.requests.is_empty() {
            return 0;
        }
        let served = self.served();
        let outcome = self.requests.serve(self.epoch, &served, room, answer);
        self.counters.garbled_requests += outcome.garbled;
        outcome.trouble.into_iter().for_each(|trouble| self.trouble("command", trouble));
        outcome.orders.iter().for_each(|order| self.log_order(order));
        outcome.handled
    }

    /// Answers a heavy request; `order` is its [`Request::order`].
    pub fn answer(&mut self, ticket: Ticket, order: Option<&'static str>, response: &Response) {
        let Some((order, sent)) = self.requests.answer(ticket, order, response) else { return };
        order.iter().for_each(|order| self.log_order(order));
        if let Err(trouble) = sent {
            self.trouble("command", trouble);
        }
    }

    /// Counts a heavy request that could not be read.
    pub fn count_malformed_request(&mut self) {
        self.counters.garbled_requests += 1;
    }

    /// Counts time that was spent on requests \[ns\].
    pub fn add_request_time(&mut self, ns: u64) {
        self.counters.answering_ns = self.counters.answering_ns.saturating_add(ns);
    }

    /// Logs an order with its sender. A refused one changes nothing, and comes in floods where a program tries again and again.
    fn log_order(&self, order: &Order) {
        let sender = || Sender::of(&self.command_service, order.client);
        match &order.refused {
            Some(reason) => tracing::debug!("`{}` from {} was refused: {reason}", order.name, sender()),
            None => tracing::info!(plumbline_event = "order", "`{}` from {}", order.name, sender()),
        }
    }

    /// What has been done so far.
    pub fn served(&self) -> Served {
        Served {
            published: self.log.end(),
            first_retained: self.log.first(),
            acknowledged: self.followers.furthest(),
            followers: self.followers.list(now_ns()),
            ..self.counters.clone()
        }
    }

    /// The oldest piece of news about a follower that has not been taken yet: worth a line in the log.
    pub fn take_follower_event(&mut self) -> Option<FollowerEvent> {
        self.followers.take_follower_event()
    }

    fn poll_replay(&mut self) {
        for _ in 0..REPLAYS_PER_POLL {
            let active = match self.replay.receive() {
                Ok(Some(active)) => active,
                Ok(None) => return,
                Err(trouble) => return self.trouble("replay", trouble.to_string()),
            };
            let asked: FollowRequest = *active.payload();
            let header = ReplayHeader { epoch: self.epoch, first: self.log.first(), end: self.log.end() };
            // Numbers of another start mean nothing here; the follower learns from the header that it has to start over.
            let known = asked.epoch == self.epoch;
            self.followers.heard(
                Word {
                    port: active.origin().value(),
                    pid: asked.pid,
                    name: readable(&asked.name),
                    acknowledged: if known { asked.acknowledged } else { 0 },
                    from: if known { asked.from } else { 0 },
                    leaving: asked.leaving == 1,
                },
                header.end,
                now_ns(),
            );
            if asked.leaving == 1 {
                continue;
            }
            let from = asked.from.clamp(header.first, header.end);
            let wanted = if known { (asked.count as usize).min(REPLAY) } else { 0 };
            let count = wanted.min((header.end - from) as usize);
            let log = &self.log;
            let sent = active.loan_slice_uninit(count).map_err(|error| error.to_string()).and_then(|mut memory| {
                *memory.user_header_mut() = header;
                let answer = memory.write_from_fn(|i| log.get(from + i as u64).copied().unwrap_or_default());
                answer.send().map_err(|error| error.to_string())
            });
            match sent {
                Ok(()) => self.counters.replayed += count as u64,
                Err(trouble) => self.trouble("replay", trouble),
            }
        }
    }

    fn look_after_followers(&mut self) {
        let now = now_ns();
        let limit = self.settings.silent_ms.saturating_mul(1_000_000);
        if now.saturating_sub(self.checked_ns) < CHECK_EVERY_NS {
            return;
        }
        self.checked_ns = now;
        if !self.followers.any_silent(now, limit) {
            return;
        }
        // A port that is no longer registered was cleaned up after its process; one that is may still belong to a dead one.
        let mut owners = Vec::new();
        self.replay_service.dynamic_config().list_clients(|details| {
            owners.push((details.client_id.value(), details.node_id));
            CallbackProgression::Continue
        });
        let node = &self.node;
        self.followers.check(now, limit, |port| {
            owners.iter().any(|(known, owner)| *known == port && services::runs(node, *owner))
        });
    }

    /// A client that could not be connected does not learn of it: its requests never arrive.
    fn look_after_connections(&mut self) {
        let failed = self.unconnected.load(Ordering::Relaxed);
        for _ in 0..failed.saturating_sub(self.unconnected_said).min(100) {
            let cause = runtime_dir::shortage().unwrap_or_else(|| "its shared memory can't be opened".into());
            self.trouble("a client", format!("not connected: {cause}"));
        }
        self.unconnected_said = failed;
    }

    fn trouble(&mut self, service: &str, reason: String) {
        let cause = format!("{service}: {reason}");
        if let Some(line) = self.troubles.count(&cause) {
            tracing::warn!("shared memory: {line}");
        }
        self.counters.trouble = Some(cause);
    }
}

/// Counts the clients that a port can't connect to; the others are served.
fn counting(unconnected: &Arc<AtomicU64>) -> impl DegradationFn + use<> {
    let unconnected = Arc::clone(unconnected);
    move |cause, _| {
        if matches!(cause, DegradationCause::FailedToEstablishConnection) {
            unconnected.fetch_add(1, Ordering::Relaxed);
        }
        DegradationAction::Ignore
    }
}

/// A number that no earlier start of the daemon had: the wall clock, not 0 \[ns\].
fn new_epoch() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(1, |since| since.as_nanos() as u64).max(1)
}

/// A follower's name as far as it is printable.
fn readable(name: &[u8; 16]) -> String {
    name.iter()
        .take_while(|byte| **byte != 0)
        .map(|byte| if byte.is_ascii_graphic() { *byte as char } else { '?' })
        .collect()
}

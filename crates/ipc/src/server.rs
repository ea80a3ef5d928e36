//! Server of one robot: publishes, retains and replays records, and responds to requests, on the bridge thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server as RequestServer;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{DegradationAction, DegradationCause, DegradationFn};
use iceoryx2::prelude::*;
use serde::Deserialize;

use super::clock;
use super::command::{MAX_RESPONSE_BYTES, Request, Response, Served};
use super::error::IpcError;
use super::error_counts::ErrorCounts;
use super::followers::{FollowerEvent, Followers, Heartbeat};
use super::messages::{FeedForwardMessage, FollowRequest, LAYOUT, ModelHeader, ReplayHeader, SampleMessage};
use super::requests::{self, IncomingRequest, Order, Requests, Ticket};
use super::retain::RetainedLog;
use super::robot::RobotId;
use super::runtime_dir;
use super::sender::Sender;
use super::services::{self, MAX_BATCH_RECORDS, MAX_REPLAY_RECORDS, SERVER_TIMEOUT, ServiceNode, now_ns, retry_until};
use plumbline_core::Record;

/// Maximum replay requests handled in one [`Server::poll`], so that many of them do not delay the samples.
const REPLAYS_PER_POLL: usize = 8;
/// Initial size of a model's memory; a longer text makes it grow \[bytes\].
const INITIAL_MODEL_BYTES: usize = 64 << 10;
/// Interval between two heartbeat checks of the followers \[ns\].
const CHECK_INTERVAL_NS: u64 = 250_000_000;
/// Interval at which the message of the model is sent again \[ns\].
const MODEL_INTERVAL_NS: u64 = 1_000_000_000;

/// Settings of the server: retained records and heartbeat timeout.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct ServerSettings {
    /// Records retained for replay, 680 bytes each; the default holds ten minutes at 1 kHz (408 MB when full).
    pub retain: usize,
    /// Heartbeat timeout of a follower \[ms\].
    pub silent_ms: u64,
}

impl Default for ServerSettings {
    fn default() -> Self {
        ServerSettings { retain: 600_000, silent_ms: 1000 }
    }
}

/// All services of one robot, daemon side. Not `Send`: create it on the thread that uses it, which must not be the
/// real-time thread.
///
/// No method blocks or fails because of a client. Errors of shared memory are counted and reported in [`Served`].
pub struct Server {
    epoch: u64,
    /// Identity of the clock of stamps.
    clock: u32,
    settings: ServerSettings,
    log: RetainedLog,
    followers: Followers,
    counters: Served,
    errors: ErrorCounts,
    /// Clients whose connection could not be opened, counted by the ports.
    unconnected: Arc<AtomicU64>,
    unconnected_logged: u64,
    checked_ns: u64,
    // Drop order: ports before services, services before their node.
    samples: Publisher<ipc::Service, [SampleMessage], ()>,
    feed_forward: Publisher<ipc::Service, FeedForwardMessage, ()>,
    model: Publisher<ipc::Service, [u8], ModelHeader>,
    /// The last message of the model, and when it was sent.
    model_header: ModelHeader,
    model_text: String,
    model_sent_ns: u64,
    replay: RequestServer<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>,
    requests: Requests,
    replay_service: services::Replay,
    command_service: services::Commands,
    node: ServiceNode,
}

impl Server {
    /// Opens all services of `robot` after cleaning up the resources of killed processes.
    ///
    /// # Errors
    /// [`IpcError::Full`] when another daemon serves this robot, [`IpcError::Incompatible`] when services of
    /// another version still have clients, [`IpcError::Transport`] when shared memory is not usable.
    pub fn open(robot: &RobotId, settings: ServerSettings) -> Result<Server, IpcError> {
        let node = services::serving_node()?;
        node.blocking_cleanup_dead_nodes(Duration::from_secs(1));

        let samples_service = services::serve_samples(&node, robot)?;
        let feed_forward_service = services::serve_feed_forward(&node, robot)?;
        let model_service = services::serve_model(&node, robot)?;
        let replay_service = services::serve_replay(&node, robot)?;
        let command_service = services::serve_commands(&node, robot)?;

        let unconnected = Arc::new(AtomicU64::new(0));
        let samples = retry_until(&services::samples_name(robot), SERVER_TIMEOUT, || {
            let builder = samples_service.publisher_builder().initial_max_slice_len(MAX_BATCH_RECORDS);
            let builder = builder.set_degradation_handler(counting(&unconnected));
            Ok(builder.max_loaned_samples(1).backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let feed_forward = retry_until(&services::feed_forward_name(robot), SERVER_TIMEOUT, || {
            let builder = feed_forward_service.publisher_builder().max_loaned_samples(1);
            let builder = builder.set_degradation_handler(counting(&unconnected));
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let model = retry_until(&services::model_name(robot), SERVER_TIMEOUT, || {
            let builder = model_service.publisher_builder().max_loaned_samples(1);
            let builder = builder.initial_max_slice_len(INITIAL_MODEL_BYTES);
            let builder = builder.allocation_strategy(AllocationStrategy::PowerOfTwo);
            let builder = builder.set_degradation_handler(counting(&unconnected));
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let replay = retry_until(&services::replay_name(robot), SERVER_TIMEOUT, || {
            let builder = replay_service.server_builder().set_request_degradation_handler(counting(&unconnected));
            let builder = builder.set_response_degradation_handler(counting(&unconnected));
            let builder = builder.initial_max_slice_len(MAX_REPLAY_RECORDS);
            let builder = builder.max_loaned_responses_per_request(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let commands = retry_until(&services::command_name(robot), SERVER_TIMEOUT, || {
            let builder = command_service.server_builder().set_request_degradation_handler(counting(&unconnected));
            let builder = builder.set_response_degradation_handler(counting(&unconnected));
            let builder = builder.initial_max_slice_len(MAX_RESPONSE_BYTES);
            // Static allocation: shared memory may be full when a response is sent.
            let builder = builder.allocation_strategy(AllocationStrategy::Static);
            let builder = builder.max_loaned_responses_per_request(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;

        runtime_dir::reserve_mapped()
            .map_err(|error| services::transport("reserving memory for", robot.as_str(), error))?;

        let epoch = new_epoch();
        let mut server = Server {
            epoch,
            clock: clock::identity(),
            log: RetainedLog::new(settings.retain),
            settings,
            followers: Followers::default(),
            counters: Served { epoch, ..Served::default() },
            errors: ErrorCounts::default(),
            unconnected,
            unconnected_logged: 0,
            checked_ns: now_ns(),
            samples,
            feed_forward,
            model,
            model_header: ModelHeader::default(),
            model_text: String::new(),
            model_sent_ns: 0,
            replay,
            requests: Requests::new(commands),
            replay_service,
            command_service,
            node,
        };
        // Clients of the daemon before receive that this one serves no model yet.
        server.model(ModelHeader::default(), "");
        Ok(server)
    }

    /// Epoch: identity of this start of the daemon, not 0.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Publishes `records` to the followers and retains them.
    pub fn publish(&mut self, records: &[Record]) {
        for chunk in records.chunks(MAX_BATCH_RECORDS) {
            let (epoch, end) = (self.epoch, self.log.end());
            let message = |i: usize| SampleMessage::new(epoch, end + i as u64, &chunk[i]);
            // Published before they are retained: the page faults of the log do not delay the followers. Replay happens in `poll` only.
            let loan = self.samples.loan_slice_uninit(chunk.len());
            let sent = loan.map_err(|error| error.to_string()).and_then(|memory| {
                memory.write_from_fn(message).send().map(|_followers| ()).map_err(|error| error.to_string())
            });
            if let Err(reason) = sent {
                self.counters.unsent_batches += 1;
                self.report_error("samples", reason);
            }
            self.retain((0..chunk.len()).map(message));
        }
    }

    /// Appends `messages` to the log and counts the discarded ones that no follower acknowledged.
    fn retain(&mut self, messages: impl Iterator<Item = SampleMessage>) {
        let first_before = self.log.first();
        messages.for_each(|message| self.log.push(message));
        let unacknowledged_from = first_before.max(self.followers.highest_acknowledged());
        self.counters.given_up_unacknowledged += self.log.first().saturating_sub(unacknowledged_from);
    }

    /// Publishes the latest feed-forward value. Sets its `sequence` and `epoch`, and its `clock` unless it has one (from a relay); converts
    /// its stamp to `CLOCK_BOOTTIME`.
    pub fn feed_forward(&mut self, mut message: FeedForwardMessage) {
        self.counters.feed_forward += 1;
        message.sequence = self.counters.feed_forward;
        message.epoch = self.epoch;
        if message.clock == 0 {
            message.clock = self.clock;
        }
        message.stamp_ns = message.stamp_ns.saturating_add(services::suspended_ns());
        if let Err(error) = self.feed_forward.send_copy(message) {
            self.report_error("feed-forward", error.to_string());
        }
    }

    /// Publishes the served model: identity, gravity and validity in `header`, and the text of its file. Sets layout, epoch, sequence and
    /// stamp. Clients that connect later receive it, too. [`Server::serve`] sends it again every second.
    pub fn model(&mut self, mut header: ModelHeader, text: &str) {
        (header.layout, header.epoch, header.sequence) = (LAYOUT, self.epoch, self.model_header.sequence + 1);
        header.stamp_ns = services::boot_ns();
        self.model_header = header;
        text.clone_into(&mut self.model_text);
        self.send_model();
    }

    fn send_model(&mut self) {
        self.model_sent_ns = now_ns();
        let (header, text) = (self.model_header, &self.model_text);
        // Memory that grows is not reserved: the kernel ends a process that writes to a segment without memory (SIGBUS).
        let full = runtime_dir::shared_memory_full().filter(|_| text.len() > INITIAL_MODEL_BYTES);
        let sent = full.map_or(Ok(()), Err).and_then(|()| {
            let mut memory = self.model.loan_slice_uninit(text.len()).map_err(|error| error.to_string())?;
            *memory.user_header_mut() = header;
            let filled = memory.write_from_slice(text.as_bytes());
            filled.send().map(|_clients| ()).map_err(|error| error.to_string())
        });
        if let Err(reason) = sent {
            self.report_error("model", reason);
        }
    }

    /// Hands the served model to clients that connected since it was published: iceoryx2 does it when the publisher sends or is asked to.
    /// Sends it again once a second: a tunnel connects its far end after it has read the model here, and followers there have no other sign that
    /// the daemon runs.
    fn serve_model(&mut self) {
        if now_ns().saturating_sub(self.model_sent_ns) >= MODEL_INTERVAL_NS {
            return self.send_model();
        }
        if let Err(error) = self.model.update_connections() {
            self.report_error("model", format!("{error:?}"));
        }
    }

    /// Responds to all received requests: replay itself, commands through `handle`, heavy ones included. Returns the number of commands handled.
    ///
    /// To be called every few milliseconds. The time of a call is bounded, except for heavy requests.
    pub fn poll(&mut self, mut handle: impl FnMut(Request, &Served) -> Response) -> usize {
        let (epoch, mut malformed, mut heavy) = (self.epoch, 0, Vec::new());
        let handled = self.serve(usize::MAX, |asked, served| match asked {
            IncomingRequest::Light(request) => Some(handle(request, served)),
            IncomingRequest::Heavy(ticket, bytes) => {
                let request = requests::read(bytes, epoch).inspect_err(|_| malformed += 1);
                let order = request.as_ref().ok().and_then(Request::order);
                let response = request.map_or_else(|refused| refused, |request| handle(request, served));
                heavy.push((ticket, order, response));
                None
            }
        });
        heavy.iter().for_each(|(ticket, order, response)| self.answer(*ticket, *order, response));
        self.counters.garbled_requests += malformed;
        handled - malformed as usize
    }

    /// Responds to received requests: replay itself, light requests through `answer`, all clients in turn. Up to `max_heavy` heavy requests are
    /// passed to `answer`, which returns `None` for them; [`Server::answer`] sends their response later. The others stay queued.
    pub fn serve(
        &mut self,
        max_heavy: usize,
        answer: impl FnMut(IncomingRequest, &Served) -> Option<Response>,
    ) -> usize {
        self.serve_model();
        self.poll_replay();
        self.check_followers();
        self.report_failed_connections();
        if let Err(reason) = self.requests.receive() {
            self.report_error("command", reason);
        }
        if self.requests.is_empty() {
            return 0;
        }
        let served = self.served();
        let outcome = self.requests.serve(self.epoch, &served, max_heavy, answer);
        self.counters.garbled_requests += outcome.malformed;
        outcome.errors.into_iter().for_each(|reason| self.report_error("command", reason));
        outcome.orders.iter().for_each(|order| self.log_order(order));
        outcome.handled
    }

    /// Sends the response to a heavy request; `order` is its [`Request::order`].
    pub fn answer(&mut self, ticket: Ticket, order: Option<&'static str>, response: &Response) {
        let Some((order, sent)) = self.requests.answer(ticket, order, response) else { return };
        order.iter().for_each(|order| self.log_order(order));
        if let Err(reason) = sent {
            self.report_error("command", reason);
        }
    }

    /// Counts a heavy request that could not be parsed.
    pub fn count_malformed_request(&mut self) {
        self.counters.garbled_requests += 1;
    }

    /// Adds time spent on requests \[ns\].
    pub fn add_request_time(&mut self, ns: u64) {
        self.counters.answering_ns = self.counters.answering_ns.saturating_add(ns);
    }

    /// Logs an order with its sender. Refused orders are logged at debug level: a client may repeat them at a high rate.
    fn log_order(&self, order: &Order) {
        let sender = || Sender::of(&self.command_service, order.client);
        match &order.refused {
            Some(reason) => tracing::debug!("`{}` from {} was refused: {reason}", order.name, sender()),
            None => tracing::info!(plumbline_event = "order", "`{}` from {}", order.name, sender()),
        }
    }

    /// Statistics so far.
    pub fn served(&self) -> Served {
        Served {
            published: self.log.end(),
            first_retained: self.log.first(),
            acknowledged: self.followers.highest_acknowledged(),
            followers: self.followers.list(now_ns()),
            ..self.counters.clone()
        }
    }

    /// Takes the oldest pending event of a follower, for the log.
    pub fn take_follower_event(&mut self) -> Option<FollowerEvent> {
        self.followers.take_follower_event()
    }

    fn poll_replay(&mut self) {
        for _ in 0..REPLAYS_PER_POLL {
            let active = match self.replay.receive() {
                Ok(Some(active)) => active,
                Ok(None) => return,
                Err(error) => return self.report_error("replay", error.to_string()),
            };
            let request: FollowRequest = *active.payload();
            let header = ReplayHeader { epoch: self.epoch, first: self.log.first(), end: self.log.end() };
            // Sequence numbers of another epoch are invalid; the header's epoch makes the follower start over.
            let same_epoch = request.epoch == self.epoch;
            self.followers.update(
                Heartbeat {
                    port: active.origin().value(),
                    pid: request.pid,
                    name: printable(&request.name),
                    acknowledged: if same_epoch { request.acknowledged } else { 0 },
                    from: if same_epoch { request.from } else { 0 },
                    leaving: request.leaving == 1,
                },
                header.end,
                now_ns(),
            );
            if request.leaving == 1 {
                continue;
            }
            let from = request.from.clamp(header.first, header.end);
            let wanted = if same_epoch { (request.count as usize).min(MAX_REPLAY_RECORDS) } else { 0 };
            let count = wanted.min((header.end - from) as usize);
            let log = &self.log;
            let sent = active.loan_slice_uninit(count).map_err(|error| error.to_string()).and_then(|mut memory| {
                *memory.user_header_mut() = header;
                let answer = memory.write_from_fn(|i| log.get(from + i as u64).copied().unwrap_or_default());
                answer.send().map_err(|error| error.to_string())
            });
            match sent {
                Ok(()) => self.counters.replayed += count as u64,
                Err(reason) => self.report_error("replay", reason),
            }
        }
    }

    fn check_followers(&mut self) {
        let now = now_ns();
        let limit = self.settings.silent_ms.saturating_mul(1_000_000);
        if now.saturating_sub(self.checked_ns) < CHECK_INTERVAL_NS {
            return;
        }
        self.checked_ns = now;
        if !self.followers.any_silent(now, limit) {
            return;
        }
        // An unregistered port was cleaned up after its process ended; a registered one may still belong to a dead process.
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

    /// Reports clients that could not be connected. Such a client gets no error: its requests never arrive.
    fn report_failed_connections(&mut self) {
        let failed = self.unconnected.load(Ordering::Relaxed);
        for _ in 0..failed.saturating_sub(self.unconnected_logged).min(100) {
            let cause = runtime_dir::shortage().unwrap_or_else(|| "its shared memory can't be opened".into());
            self.report_error("a client", format!("not connected: {cause}"));
        }
        self.unconnected_logged = failed;
    }

    /// Counts an error of shared memory and logs it at a limited rate.
    fn report_error(&mut self, service: &str, reason: String) {
        let cause = format!("{service}: {reason}");
        if let Some(line) = self.errors.count(&cause) {
            tracing::warn!("shared memory: {line}");
        }
        self.counters.trouble = Some(cause);
    }
}

/// Degradation handler that counts failed connections of a port and ignores them: the other clients are served.
fn counting(unconnected: &Arc<AtomicU64>) -> impl DegradationFn + use<> {
    let unconnected = Arc::clone(unconnected);
    move |cause, _| {
        if matches!(cause, DegradationCause::FailedToEstablishConnection) {
            unconnected.fetch_add(1, Ordering::Relaxed);
        }
        DegradationAction::Ignore
    }
}

/// New epoch: the wall-clock time \[ns\], not 0, different from every earlier start.
fn new_epoch() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(1, |since| since.as_nanos() as u64).max(1)
}

/// The printable characters of a follower's name; others become `?`.
fn printable(name: &[u8; 16]) -> String {
    name.iter()
        .take_while(|byte| **byte != 0)
        .map(|byte| if byte.is_ascii_graphic() { *byte as char } else { '?' })
        .collect()
}

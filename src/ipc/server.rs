//! The daemon's side: one object on the bridge thread that publishes, keeps, replays and answers.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use iceoryx2::identifiers::UniqueClientId;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server as RequestServer;
use iceoryx2::prelude::*;
use serde::Deserialize;

use super::command::{self, MAX_REQUEST_BYTES, MAX_RESPONSE_BYTES, Request, Response, Served};
use super::error::IpcError;
use super::followers::{Followers, News, Word};
use super::messages::{FeedForwardMessage, FollowRequest, ReplayHeader, SampleMessage};
use super::retain::RetainedLog;
use super::robot::RobotId;
use super::sender::Sender;
use super::services::{self, BATCH, REPLAY, SERVER_PATIENCE, ServiceNode, now_ns, patiently};
use crate::joint::Record;

/// Requests handled in one [`Server::poll`] per service, so that a flood of them does not hold up the samples.
const REQUESTS_PER_POLL: usize = 8;
/// Time after which one [`Server::poll`] takes no further request \[ns\]: long ones are dear to read.
const TIME_PER_POLL_NS: u64 = 500_000;
/// First size of an answer's memory; it grows when an answer needs more \[bytes\].
const RESPONSE_BYTES: usize = 4096;
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
    checked_ns: u64,
    // The ports go before the services, the services before their node.
    samples: Publisher<ipc::Service, [SampleMessage], ()>,
    feed_forward: Publisher<ipc::Service, FeedForwardMessage, ()>,
    replay: RequestServer<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>,
    commands: RequestServer<ipc::Service, [u8], (), [u8], ()>,
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

        let samples = patiently(&services::samples_name(robot), SERVER_PATIENCE, || {
            let builder = samples_service.publisher_builder().initial_max_slice_len(BATCH);
            Ok(builder.max_loaned_samples(1).backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let feed_forward = patiently(&services::feed_forward_name(robot), SERVER_PATIENCE, || {
            let builder = feed_forward_service.publisher_builder().max_loaned_samples(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let replay = patiently(&services::replay_name(robot), SERVER_PATIENCE, || {
            let builder = replay_service.server_builder().initial_max_slice_len(REPLAY);
            let builder = builder.max_loaned_responses_per_request(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let commands = patiently(&services::command_name(robot), SERVER_PATIENCE, || {
            let builder = command_service.server_builder().initial_max_slice_len(RESPONSE_BYTES);
            let builder = builder.allocation_strategy(AllocationStrategy::PowerOfTwo);
            let builder = builder.max_loaned_responses_per_request(1);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;

        let epoch = new_epoch();
        Ok(Server {
            epoch,
            log: RetainedLog::new(settings.retain),
            settings,
            followers: Followers::default(),
            counters: Served { epoch, ..Served::default() },
            checked_ns: now_ns(),
            samples,
            feed_forward,
            replay,
            commands,
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

    /// Answers what has arrived: replay by itself, commands through `handle`. Returns the number of commands handled.
    ///
    /// To be called every few milliseconds; each call handles a bounded number of requests.
    pub fn poll(&mut self, mut handle: impl FnMut(Request, &Served) -> Response) -> usize {
        self.poll_replay();
        self.look_after_followers();
        let mut handled = 0;
        let begin = now_ns();
        for _ in 0..REQUESTS_PER_POLL {
            if now_ns().saturating_sub(begin) > TIME_PER_POLL_NS {
                break;
            }
            let active = match self.commands.receive() {
                Ok(Some(active)) => active,
                Ok(None) => break,
                Err(trouble) => {
                    self.trouble("command", trouble.to_string());
                    break;
                }
            };
            let response = match command::decode::<Request>("request", active.payload(), MAX_REQUEST_BYTES) {
                Ok(request) => {
                    handled += 1;
                    let order = request.order();
                    let response = handle(request, &self.served());
                    order.into_iter().for_each(|order| self.log_order(order, active.origin(), &response));
                    response
                }
                Err(error) => {
                    self.counters.garbled_requests += 1;
                    Response::Refused { reason: error.to_string() }
                }
            };
            let bytes = command::encode("answer", &response, MAX_RESPONSE_BYTES).or_else(|error| {
                command::encode("answer", &Response::Refused { reason: error.to_string() }, MAX_RESPONSE_BYTES)
            });
            let sent = bytes.map_err(|error| error.to_string()).and_then(|bytes| {
                let memory = active.loan_slice_uninit(bytes.len()).map_err(|error| error.to_string())?;
                memory.write_from_slice(&bytes).send().map_err(|error| error.to_string())
            });
            if let Err(trouble) = sent {
                self.trouble("command", trouble);
            }
        }
        handled
    }

    /// Says who has given an order. What was refused changes nothing, and comes in floods where a program tries again and again.
    fn log_order(&self, order: &str, client: UniqueClientId, response: &Response) {
        let sender = || Sender::of(&self.command_service, client);
        match response {
            Response::Refused { reason } => tracing::debug!("`{order}` from {} was refused: {reason}", sender()),
            _ => tracing::info!(plumbline_event = "order", "`{order}` from {}", sender()),
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
    pub fn take_news(&mut self) -> Option<News> {
        self.followers.take_news()
    }

    fn poll_replay(&mut self) {
        for _ in 0..REQUESTS_PER_POLL {
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

    fn trouble(&mut self, service: &str, reason: String) {
        tracing::debug!(service, reason, "shared memory");
        self.counters.trouble = Some(format!("{service}: {reason}"));
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

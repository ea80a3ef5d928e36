//! Follower of the samples: every record exactly once and in order, from any start.
//!
//! Live batches arrive by publish-subscribe. Missing records (of a slow, late or restarted follower) are fetched by replay. A periodic
//! request acknowledges records, and its response contains the end of the daemon's log: a loss at the end of the stream is
//! detected too.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client as RequestClient;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::error::IpcError;
use super::messages::{FollowRequest, ReplayHeader, SampleMessage};
use super::robot::RobotId;
use super::services::{self, MAX_REPLAY_RECORDS, ServiceNode, transport};
use plumbline_core::Record;

const POLL_INTERVAL: Duration = Duration::from_micros(500);
/// Maximum batches received in one step: bounds the size of a delivery.
const BATCHES_PER_STEP: usize = 64;

/// Settings of a follower.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamSettings {
    /// Name of this follower in the daemon's log: up to 16 ASCII characters.
    pub name: String,
    /// First record requested from the first daemon; 0 for all retained ones.
    pub from: u64,
    /// Interval between two heartbeats to the daemon.
    pub heartbeat: Duration,
    /// Timeout of a response.
    pub response_timeout: Duration,
}

impl Default for StreamSettings {
    fn default() -> Self {
        StreamSettings {
            name: "estimator".to_string(),
            from: 0,
            heartbeat: Duration::from_millis(50),
            response_timeout: Duration::from_millis(500),
        }
    }
}

/// Result of [`SampleStream::next`].
#[derive(Clone, Debug, PartialEq)]
pub enum Delivery {
    /// The next records without a gap.
    Records {
        /// Sequence number of the first one.
        first: u64,
        /// At least one record.
        records: Vec<Record>,
    },
    /// Lost records: the daemon discarded them before they were requested.
    Missed {
        /// First lost record.
        from: u64,
        /// Record after the last lost one.
        to: u64,
    },
    /// The daemon was restarted; sequence numbers start from 0 again.
    Restarted {
        /// New epoch.
        epoch: u64,
    },
    /// Timeout without new records; a daemon runs.
    Idle,
    /// Timeout without new records, and no daemon runs. The stream continues with the next daemon.
    Gone,
}

/// Counters of a follower over all starts of the daemon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamCounters {
    /// Records delivered.
    pub received: u64,
    /// Delivered records that were fetched by replay.
    pub replayed: u64,
    /// Lost records, [`Delivery::Missed`].
    pub missed: u64,
    /// Restarts of the daemon.
    pub restarts: u64,
    /// Gaps detected between live batches.
    pub gaps: u64,
}

type Pending = PendingResponse<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>;

/// Stream of all records of one robot's daemon in order. Not `Send`.
pub struct SampleStream {
    robot: RobotId,
    settings: StreamSettings,
    /// Epoch of the followed daemon, 0 before its first response.
    epoch: u64,
    /// Sequence number of the next record to receive; those in `ready` are received but not delivered.
    next: u64,
    /// Records are missing: fetch them by replay instead of reading live batches.
    behind: bool,
    /// End of the daemon's log in its last response. Records before it that are missing after all live batches are lost.
    check_end: Option<u64>,
    /// Send a request at once: a batch of an unknown epoch was received.
    epoch_changed: bool,
    gone: bool,
    requested: Option<Instant>,
    /// The last request has a response; otherwise the next request waits for the heartbeat.
    responded: bool,
    ready: VecDeque<Delivery>,
    counters: StreamCounters,
    pending: Option<Pending>,
    subscriber: Subscriber<ipc::Service, [SampleMessage], ()>,
    port: RequestClient<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>,
    replay_service: services::Replay,
    node: ServiceNode,
}

impl SampleStream {
    /// Connects to the daemon of `robot`, waiting up to `timeout` for it to start.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(robot: &RobotId, settings: StreamSettings, timeout: Duration) -> Result<SampleStream, IpcError> {
        let start = Instant::now();
        let left = || timeout.saturating_sub(start.elapsed());
        let node = services::joining_node()?;
        let samples_service = services::join_samples(&node, robot, timeout)?;
        let replay_service = services::join_replay(&node, robot, left())?;
        while replay_service.dynamic_config().number_of_servers() == 0 {
            if start.elapsed() >= timeout {
                return Err(services::no_daemon(robot, timeout));
            }
            thread::sleep(POLL_INTERVAL);
        }
        // The subscriber is created first: it receives all records published before the first response.
        let subscriber = services::retry_until(&services::samples_name(robot), left(), || {
            Ok(samples_service.subscriber_builder().create())
        })?;
        let port = services::retry_until(&services::replay_name(robot), left(), || {
            Ok(replay_service.client_builder().backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        Ok(SampleStream {
            robot: robot.clone(),
            epoch: 0,
            next: settings.from,
            settings,
            behind: true,
            check_end: None,
            epoch_changed: false,
            gone: false,
            requested: None,
            responded: true,
            ready: VecDeque::new(),
            counters: StreamCounters::default(),
            pending: None,
            subscriber,
            port,
            replay_service,
            node,
        })
    }

    /// The next delivery, waiting up to `timeout` for it.
    ///
    /// # Errors
    /// [`IpcError::Transport`] when shared memory failed; an ended daemon is [`Delivery::Gone`].
    pub fn next(&mut self, timeout: Duration) -> Result<Delivery, IpcError> {
        let start = Instant::now();
        loop {
            if let Some(delivery) = self.ready.pop_front() {
                return Ok(delivery);
            }
            self.step()?;
            if self.ready.is_empty() {
                if start.elapsed() >= timeout {
                    return Ok(if self.gone { Delivery::Gone } else { Delivery::Idle });
                }
                thread::sleep(POLL_INTERVAL);
            }
        }
    }

    /// Counters so far.
    pub fn counters(&self) -> StreamCounters {
        self.counters
    }

    /// Epoch of the followed daemon, 0 before its first response.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Sequence number of the record that [`SampleStream::next`] delivers next: where a successor of this follower continues.
    pub fn position(&self) -> u64 {
        if self.ready.iter().any(|delivery| matches!(delivery, Delivery::Restarted { .. })) {
            return 0;
        }
        match self.ready.front() {
            Some(Delivery::Records { first, .. }) => *first,
            Some(Delivery::Missed { from, .. }) => *from,
            _ => self.next,
        }
    }

    /// One step: receive a response, receive live batches, send a request.
    fn step(&mut self) -> Result<(), IpcError> {
        self.receive_response()?;
        if !self.behind && self.receive_batches()? && self.check_end.take().is_some_and(|end| self.next < end) {
            self.fall_behind();
        }
        let overdue = self.requested.is_none_or(|requested| requested.elapsed() >= self.settings.heartbeat);
        if self.pending.is_none()
            && (overdue || (self.behind && self.responded) || std::mem::take(&mut self.epoch_changed))
        {
            self.send_request()?;
        }
        Ok(())
    }

    /// Receives the daemon's response, if one arrived.
    fn receive_response(&mut self) -> Result<(), IpcError> {
        let Some(pending) = &self.pending else { return Ok(()) };
        let name = services::replay_name(&self.robot);
        let Some(response) = pending.receive().map_err(|error| transport("receiving a response from", &name, error))?
        else {
            if self.requested.is_none_or(|requested| requested.elapsed() >= self.settings.response_timeout) {
                self.pending = None;
                self.gone = !self.daemon_runs();
            }
            return Ok(());
        };
        let header = *response.user_header();
        self.gone = false;
        self.responded = true;
        if header.epoch != self.epoch {
            drop(response);
            self.pending = None;
            return self.follow_new_start(header);
        }
        if self.behind && self.next < header.first {
            self.miss(header.first);
        }
        let before = self.counters.received;
        self.accept(response.payload());
        self.counters.replayed += self.counters.received - before;
        drop(response);
        self.pending = None;
        if self.behind {
            self.behind = self.next < header.end;
        } else {
            self.check_end = Some(header.end);
        }
        Ok(())
    }

    /// Follows a daemon with a new epoch from its first record on.
    fn follow_new_start(&mut self, header: ReplayHeader) -> Result<(), IpcError> {
        if self.epoch != 0 {
            // Batches of the old epoch are still delivered.
            while !self.receive_batches()? {}
            self.counters.restarts += 1;
            self.ready.push_back(Delivery::Restarted { epoch: header.epoch });
            self.next = 0;
        }
        self.epoch = header.epoch;
        self.behind = true;
        self.check_end = None;
        Ok(())
    }

    /// Receives live batches; `true` when none is left.
    fn receive_batches(&mut self) -> Result<bool, IpcError> {
        for _ in 0..BATCHES_PER_STEP {
            let received = self.subscriber.receive();
            let name = || services::samples_name(&self.robot);
            let Some(batch) = received.map_err(|error| transport("reading", &name(), error))? else {
                return Ok(true);
            };
            if batch.payload().first().is_some_and(|sample| sample.epoch != self.epoch) {
                self.epoch_changed = true;
                continue;
            }
            if !self.accept(batch.payload()) {
                self.fall_behind();
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Accepts the samples that continue the sequence; `false` at a gap.
    fn accept(&mut self, samples: &[SampleMessage]) -> bool {
        let mut first = self.next;
        let mut records = Vec::with_capacity(samples.len());
        let mut contiguous = true;
        for sample in samples {
            if sample.epoch != self.epoch || sample.seq < self.next {
                continue;
            }
            if sample.seq > self.next {
                contiguous = false;
                break;
            }
            match sample.record() {
                Ok(record) => {
                    records.push(record);
                    self.next += 1;
                    self.counters.received += 1;
                }
                // Invalid record: reported as missed.
                Err(_) => {
                    self.deliver(first, std::mem::take(&mut records));
                    self.miss(sample.seq + 1);
                    first = self.next;
                }
            }
        }
        self.deliver(first, records);
        contiguous
    }

    fn deliver(&mut self, first: u64, records: Vec<Record>) {
        if records.is_empty() {
            return;
        }
        match self.ready.back_mut() {
            Some(Delivery::Records { first: before, records: last }) if *before + last.len() as u64 == first => {
                last.extend(records);
            }
            _ => self.ready.push_back(Delivery::Records { first, records }),
        }
    }

    fn miss(&mut self, to: u64) {
        self.counters.missed += to - self.next;
        self.ready.push_back(Delivery::Missed { from: self.next, to });
        self.next = to;
    }

    fn fall_behind(&mut self) {
        self.counters.gaps += 1;
        self.behind = true;
        self.check_end = None;
    }

    /// Sends a heartbeat with the acknowledgement, and requests a replay when records are missing.
    fn send_request(&mut self) -> Result<(), IpcError> {
        let request = self.request(if self.behind { MAX_REPLAY_RECORDS as u32 } else { 0 }, 0);
        let name = services::replay_name(&self.robot);
        let pending = self.port.send_copy(request).map_err(|error| transport("sending a request to", &name, error))?;
        self.requested = Some(Instant::now());
        self.responded = false;
        if pending.number_of_server_connections() > 0 {
            self.pending = Some(pending);
        } else {
            // Not delivered: no daemon, or the daemon has not yet read earlier requests.
            self.gone = !self.daemon_runs();
        }
        Ok(())
    }

    fn request(&self, count: u32, leaving: u32) -> FollowRequest {
        let mut name = [0; 16];
        for (slot, byte) in name.iter_mut().zip(self.settings.name.bytes()) {
            *slot = byte;
        }
        FollowRequest {
            epoch: self.epoch,
            acknowledged: self.position(),
            from: self.next,
            count,
            leaving,
            pid: std::process::id(),
            reserved: 0,
            name,
        }
    }

    fn daemon_runs(&self) -> bool {
        let mut runs = false;
        self.replay_service.dynamic_config().list_servers(|details| {
            runs |= services::runs(&self.node, details.node_id);
            CallbackProgression::Continue
        });
        runs
    }
}

impl Drop for SampleStream {
    /// Sends a disconnect, which distinguishes it from a crash.
    fn drop(&mut self) {
        self.pending = None;
        // On an error the daemon detects the end by the heartbeat timeout.
        let _ = self.port.send_copy(self.request(0, 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Server, ServerSettings};

    #[test]
    fn samples_are_accepted_in_sequence_and_invalid_ones_reported_as_missed() {
        let robot = RobotId::parse("test", "robot", &format!("test-take-{}", std::process::id())).unwrap();
        let _server = Server::open(&robot, ServerSettings::default()).unwrap();
        let mut stream = SampleStream::connect(&robot, StreamSettings::default(), Duration::from_secs(5)).unwrap();
        (stream.epoch, stream.next) = (9, 100);
        let sample = |epoch, seq, phase| SampleMessage { epoch, seq, cycle: seq, phase, ..SampleMessage::default() };

        // Repeated, of another epoch, next, invalid, next, repeated.
        let batch = [
            sample(9, 99, 0),
            sample(8, 100, 0),
            sample(9, 100, 0),
            sample(9, 101, 99),
            sample(9, 102, 0),
            sample(9, 100, 0),
        ];
        assert!(stream.accept(&batch));
        assert_eq!((stream.next, stream.position()), (103, 100));
        let delivered: Vec<_> = stream.ready.drain(..).collect();
        let record = |cycle| Record { cycle, ..Record::default() };
        let expected = [
            Delivery::Records { first: 100, records: vec![record(100)] },
            Delivery::Missed { from: 101, to: 102 },
            Delivery::Records { first: 102, records: vec![record(102)] },
        ];
        assert_eq!(delivered, expected);
        assert_eq!((stream.counters.received, stream.counters.missed), (2, 1));

        // A gap: nothing after it is accepted.
        assert!(!stream.accept(&[sample(9, 103, 0), sample(9, 105, 0), sample(9, 106, 0)]));
        assert_eq!((stream.next, stream.position()), (104, 103));
        // Contiguous records are merged into one delivery.
        assert!(stream.accept(&[sample(9, 104, 0)]));
        let both = Delivery::Records { first: 103, records: vec![record(103), record(104)] };
        assert_eq!(stream.ready, [both]);
        assert_eq!(stream.next(Duration::ZERO).map(|_| stream.position()), Ok(105));
    }
}

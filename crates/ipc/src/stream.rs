//! A follower of the samples: every record exactly once and in order, from wherever it starts.
//!
//! Live batches come by publish-subscribe; whatever they lack (because this process was slow, came late, or was restarted) is
//! fetched by replay. A regular request tells the daemon how far we are and brings back how far it is, so that a loss at the
//! very end of the stream is found, too.

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
use super::services::{self, REPLAY, ServiceNode, transport};
use plumbline_core::Record;

/// Pause between two looks at shared memory.
const PAUSE: Duration = Duration::from_micros(500);
/// Batches taken in one step, so that a delivery stays of moderate size.
const BATCHES_PER_STEP: usize = 64;

/// How a follower behaves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamSettings {
    /// What the daemon calls this follower: up to 16 ASCII characters.
    pub name: String,
    /// First record wanted of the daemon that is met first; 0 is everything it still has.
    pub from: u64,
    /// How often the daemon is told how far we are.
    pub heartbeat: Duration,
    /// An answer that takes longer is not waited for any more.
    pub answer_within: Duration,
}

impl Default for StreamSettings {
    fn default() -> Self {
        StreamSettings {
            name: "estimator".to_string(),
            from: 0,
            heartbeat: Duration::from_millis(50),
            answer_within: Duration::from_millis(500),
        }
    }
}

/// What [`SampleStream::next`] brings.
#[derive(Clone, Debug, PartialEq)]
pub enum Delivery {
    /// The next records without a gap.
    Records {
        /// Number of the first of them.
        first: u64,
        /// At least one record.
        records: Vec<Record>,
    },
    /// Records that can't be had any more: the daemon gave them up before they were asked for.
    Missed {
        /// The first of them.
        from: u64,
        /// The one after the last of them.
        to: u64,
    },
    /// The daemon was started anew; records count from 0 again.
    Restarted {
        /// Identity of the new start.
        epoch: u64,
    },
    /// Nothing new in the time given; the daemon is there.
    Idle,
    /// Nothing new in the time given, and no daemon is there. The stream goes on by itself when one comes.
    Gone,
}

/// What a follower has counted, over all starts of the daemon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamCounters {
    /// Records delivered.
    pub received: u64,
    /// Those among them that came by replay.
    pub replayed: u64,
    /// Records named in [`Delivery::Missed`].
    pub missed: u64,
    /// Restarts of the daemon.
    pub restarts: u64,
    /// Times that a live batch did not follow on from what was there.
    pub gaps: u64,
}

type Pending = PendingResponse<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>;

/// The records of one robot's daemon, complete and in order. Not `Send`.
pub struct SampleStream {
    robot: RobotId,
    settings: StreamSettings,
    /// The daemon's start that we follow, 0 before its first answer.
    epoch: u64,
    /// Number of the next record to be taken; those in `ready` have been taken, but not handed on.
    next: u64,
    /// Records are missing: ask for replay instead of reading live batches.
    behind: bool,
    /// How far the daemon was when it answered last; once all live batches are read, anything before it that is not there is lost.
    check_end: Option<u64>,
    /// Ask at once: a batch of an unknown start was seen.
    curious: bool,
    gone: bool,
    asked: Option<Instant>,
    /// The last question was answered; otherwise the next one waits for the heartbeat.
    answered: bool,
    ready: VecDeque<Delivery>,
    counters: StreamCounters,
    pending: Option<Pending>,
    subscriber: Subscriber<ipc::Service, [SampleMessage], ()>,
    port: RequestClient<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>,
    replay_service: services::Replay,
    node: ServiceNode,
}

impl SampleStream {
    /// Connects to the daemon of `robot`, waiting up to `patience` for it to appear.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(robot: &RobotId, settings: StreamSettings, patience: Duration) -> Result<SampleStream, IpcError> {
        let start = Instant::now();
        let left = || patience.saturating_sub(start.elapsed());
        let node = services::joining_node()?;
        let samples_service = services::join_samples(&node, robot, patience)?;
        let replay_service = services::join_replay(&node, robot, left())?;
        while replay_service.dynamic_config().number_of_servers() == 0 {
            if start.elapsed() >= patience {
                return Err(services::no_daemon(robot, patience));
            }
            thread::sleep(PAUSE);
        }
        // The subscriber comes first: whatever is published before its first request is answered, it has.
        let subscriber = services::patiently(&services::samples_name(robot), left(), || {
            Ok(samples_service.subscriber_builder().create())
        })?;
        let port = services::patiently(&services::replay_name(robot), left(), || {
            Ok(replay_service.client_builder().backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        Ok(SampleStream {
            robot: robot.clone(),
            epoch: 0,
            next: settings.from,
            settings,
            behind: true,
            check_end: None,
            curious: false,
            gone: false,
            asked: None,
            answered: true,
            ready: VecDeque::new(),
            counters: StreamCounters::default(),
            pending: None,
            subscriber,
            port,
            replay_service,
            node,
        })
    }

    /// What comes next, waiting up to `timeout` for it.
    ///
    /// # Errors
    /// [`IpcError::Transport`] when shared memory failed; a daemon that is gone is [`Delivery::Gone`].
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
                thread::sleep(PAUSE);
            }
        }
    }

    /// What has been counted.
    pub fn counters(&self) -> StreamCounters {
        self.counters
    }

    /// The daemon's start that is followed, 0 before its first answer.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Number of the record that [`SampleStream::next`] brings next: where a successor of this follower could go on.
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

    /// One round: take an answer, take live batches, ask.
    fn step(&mut self) -> Result<(), IpcError> {
        self.take_answer()?;
        if !self.behind && self.take_batches()? && self.check_end.take().is_some_and(|end| self.next < end) {
            self.fall_behind();
        }
        let overdue = self.asked.is_none_or(|asked| asked.elapsed() >= self.settings.heartbeat);
        if self.pending.is_none() && (overdue || (self.behind && self.answered) || std::mem::take(&mut self.curious)) {
            self.ask()?;
        }
        Ok(())
    }

    /// Takes the daemon's answer, if it is there.
    fn take_answer(&mut self) -> Result<(), IpcError> {
        let Some(pending) = &self.pending else { return Ok(()) };
        let name = services::replay_name(&self.robot);
        let Some(answer) = pending.receive().map_err(|error| transport("hearing", &name, error))? else {
            if self.asked.is_none_or(|asked| asked.elapsed() >= self.settings.answer_within) {
                self.pending = None;
                self.gone = !self.daemon_runs();
            }
            return Ok(());
        };
        let header = *answer.user_header();
        self.gone = false;
        self.answered = true;
        if header.epoch != self.epoch {
            drop(answer);
            self.pending = None;
            return self.follow_new_start(header);
        }
        if self.behind && self.next < header.first {
            self.miss(header.first);
        }
        let before = self.counters.received;
        self.take(answer.payload());
        self.counters.replayed += self.counters.received - before;
        drop(answer);
        self.pending = None;
        if self.behind {
            self.behind = self.next < header.end;
        } else {
            self.check_end = Some(header.end);
        }
        Ok(())
    }

    /// The daemon is another one than before, or the first: begin with its first record.
    fn follow_new_start(&mut self, header: ReplayHeader) -> Result<(), IpcError> {
        if self.epoch != 0 {
            // What the old one had sent is still good.
            while !self.take_batches()? {}
            self.counters.restarts += 1;
            self.ready.push_back(Delivery::Restarted { epoch: header.epoch });
            self.next = 0;
        }
        self.epoch = header.epoch;
        self.behind = true;
        self.check_end = None;
        Ok(())
    }

    /// Takes live batches; `true` when there are no more of them.
    fn take_batches(&mut self) -> Result<bool, IpcError> {
        for _ in 0..BATCHES_PER_STEP {
            let received = self.subscriber.receive();
            let name = || services::samples_name(&self.robot);
            let Some(batch) = received.map_err(|error| transport("reading", &name(), error))? else {
                return Ok(true);
            };
            if batch.payload().first().is_some_and(|sample| sample.epoch != self.epoch) {
                self.curious = true;
                continue;
            }
            if !self.take(batch.payload()) {
                self.fall_behind();
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Takes those samples that come next; `false` when there is a gap before them.
    fn take(&mut self, samples: &[SampleMessage]) -> bool {
        let mut first = self.next;
        let mut records = Vec::with_capacity(samples.len());
        let mut whole = true;
        for sample in samples {
            if sample.epoch != self.epoch || sample.seq < self.next {
                continue;
            }
            if sample.seq > self.next {
                whole = false;
                break;
            }
            match sample.record() {
                Ok(record) => {
                    records.push(record);
                    self.next += 1;
                    self.counters.received += 1;
                }
                // No daemon sends this. Give it up by name rather than pass it on.
                Err(_) => {
                    self.deliver(first, std::mem::take(&mut records));
                    self.miss(sample.seq + 1);
                    first = self.next;
                }
            }
        }
        self.deliver(first, records);
        whole
    }

    fn deliver(&mut self, first: u64, records: Vec<Record>) {
        if records.is_empty() {
            return;
        }
        match self.ready.back_mut() {
            Some(Delivery::Records { first: before, records: waiting }) if *before + waiting.len() as u64 == first => {
                waiting.extend(records);
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

    /// Tells the daemon how far we are and asks for more when we are behind.
    fn ask(&mut self) -> Result<(), IpcError> {
        let request = self.request(if self.behind { REPLAY as u32 } else { 0 }, 0);
        let name = services::replay_name(&self.robot);
        let pending = self.port.send_copy(request).map_err(|error| transport("asking", &name, error))?;
        self.asked = Some(Instant::now());
        self.answered = false;
        if pending.number_of_server_connections() > 0 {
            self.pending = Some(pending);
        } else {
            // No one took it: there is no daemon, or one that is too busy to have read our earlier questions.
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
    /// Says goodbye, so that the daemon knows a follower that left from one that died.
    fn drop(&mut self) {
        self.pending = None;
        // There is no one left to tell when this fails; the daemon then finds out by itself.
        let _ = self.port.send_copy(self.request(0, 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Server, ServerSettings};

    #[test]
    fn only_what_comes_next_is_taken_and_impossible_records_are_named() {
        let robot = RobotId::parse("test", "robot", &format!("test-take-{}", std::process::id())).unwrap();
        let _server = Server::open(&robot, ServerSettings::default()).unwrap();
        let mut stream = SampleStream::connect(&robot, StreamSettings::default(), Duration::from_secs(5)).unwrap();
        (stream.epoch, stream.next) = (9, 100);
        let sample = |epoch, seq, phase| SampleMessage { epoch, seq, cycle: seq, phase, ..SampleMessage::default() };

        // Twice seen, of another start, next, impossible, next, twice seen.
        let batch = [
            sample(9, 99, 0),
            sample(8, 100, 0),
            sample(9, 100, 0),
            sample(9, 101, 99),
            sample(9, 102, 0),
            sample(9, 100, 0),
        ];
        assert!(stream.take(&batch));
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

        // A gap: nothing after it is taken.
        assert!(!stream.take(&[sample(9, 103, 0), sample(9, 105, 0), sample(9, 106, 0)]));
        assert_eq!((stream.next, stream.position()), (104, 103));
        // What follows on comes in one delivery.
        assert!(stream.take(&[sample(9, 104, 0)]));
        let both = Delivery::Records { first: 103, records: vec![record(103), record(104)] };
        assert_eq!(stream.ready, [both]);
        assert_eq!(stream.next(Duration::ZERO).map(|_| stream.position()), Ok(105));
    }
}

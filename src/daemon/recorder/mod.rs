//! The flight recorder: keeps the last seconds of the running loop, and writes them to disk after a fault.
//!
//! It has a thread of its own, started before any thread has a real-time priority. The bridge thread copies every record into a ring of that thread's
//! and never waits for it, unless simulated time does; a disk that is slow, full or read-only costs the recording and nothing else.

mod folder;
mod thread;

use super::job_setup::JobSetup;
use crate::config::job::Job;
use crate::recording::about::{
    About, FORMAT, LogClock, Reason, ReasonKind, RecordedModel, RecordedOrder, Settings, panicked,
};
use crate::recording::history::History;
use folder::Folder;
use plumbline_core::{BadInput, Fault, Record, State};
use plumbline_ipc::RobotId;
use plumbline_model::{Mounting, Robot};
use plumbline_rt::cycle::{End, Outcome};
use plumbline_rt::{Controls, CycleSettings, TimedEvent};
use rtrb::{Producer, RingBuffer};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thread::{RecorderThread, work};

/// Records between the bridge thread and the recorder's: four seconds.
const RING: usize = 4096;
const PAUSE: Duration = Duration::from_millis(5);
/// Pause after a recording on demand \[ns\].
const ON_DEMAND_PAUSE_NS: u64 = 2_000_000_000;
/// How long the end of the program may take because of recordings: with the stop before it, less than systemd's `TimeoutStopSec`.
const LAST_WRITE_TIMEOUT: Duration = Duration::from_secs(8);
/// Room behind the fault: no stop takes this long \[cycles\].
const STOP: usize = 5000;

enum Message {
    Open(Box<RecorderThread>),
    Event(TimedEvent),
    Order(RecordedOrder),
    Model(RecordedModel, String),
    Note(String),
    StopReason(Reason),
    /// A recording on demand, with the newest record that was kept before this was sent.
    OnDemand(u64),
    Close(Box<Close>),
}

struct Close {
    /// `None` for an end without a fault.
    reason: Option<Reason>,
    end: String,
    next: Vec<String>,
    goes_on: bool,
    dropped_events: u64,
    flight: Vec<Record>,
    unanswered: Option<State>,
}

/// What was left behind by the loop's thread.
pub enum LoopEnd {
    Ended(Box<Outcome>),
    /// It panicked; its last cycles and the state that was not answered.
    Panicked {
        message: String,
        /// The last cycles, oldest first.
        flight: Vec<Record>,
        unanswered: Option<Box<State>>,
    },
}

/// The recorder's handle, on the bridge thread.
pub struct Recorder {
    inbox: Option<Sender<Message>>,
    thread: Option<JoinHandle<()>>,
    span: f64,
    requests: Arc<Requests>,
    about: Sheet,
}

struct Sheet {
    id: String,
    job: String,
    job_text: String,
    robot_text: String,
}

impl Recorder {
    /// Starts the recorder's thread, which inherits the ordinary scheduling of its caller: call it before the priority of this thread goes up.
    /// Errors: a job or robot description that can't be read a second time.
    pub fn start(job: &Job, id: &RobotId, out: &Path) -> Result<Recorder, BadInput> {
        let (_, robot_text) = Robot::description(&job.robot, Some(job.dir()))?;
        let file = job.file.display().to_string();
        let job_text = std::fs::read_to_string(&job.file)
            .map_err(|error| BadInput::new(&file, "file", error, "a readable configuration"))?;
        let about = Sheet { id: id.to_string(), job: file, job_text, robot_text };
        let requests = Arc::new(Requests::default());
        let mut recorder =
            Recorder { inbox: None, thread: None, span: job.recorder.span, requests: Arc::clone(&requests), about };
        if job.recorder.span > 0.0 {
            let folder = Folder {
                dir: job.recorder.dir.clone().unwrap_or_else(|| out.join("flight")),
                id: id.to_string(),
                keep: job.recorder.keep,
                keep_on_demand: job.recorder.keep_on_demand,
            };
            let (inbox, messages) = channel();
            let thread = std::thread::Builder::new().name("plumbline-flight".into());
            match thread.spawn(move || work(&messages, &folder, &requests)) {
                Ok(thread) => (recorder.inbox, recorder.thread) = (Some(inbox), Some(thread)),
                Err(error) => tracing::error!("there is no flight recorder: {error}"),
            }
        }
        Ok(recorder)
    }

    /// A tape for a loop that is about to begin. Its memory is allocated here.
    pub fn tape(
        &self,
        setup: &JobSetup,
        mounting: Mounting,
        session: &str,
        settings: &CycleSettings,
        controls: &Arc<Controls>,
    ) -> LoopRecorder {
        let waits = setup.job.backend.is_fast();
        let Some(inbox) = &self.inbox else {
            return LoopRecorder { inbox: None, ring: RingBuffer::new(1).0, waits, lost: 0 };
        };
        let (ring, records) = RingBuffer::new(RING);
        let joints = setup.robot.chain.len();
        let depth = (self.span * 1e3) as usize + STOP;
        let Sheet { id, job, job_text, robot_text } = &self.about;
        let about = About {
            format: FORMAT,
            plumbline: env!("CARGO_PKG_VERSION").into(),
            robot: setup.robot.name.clone(),
            id: id.clone(),
            joints,
            mounting: mounting.to_string(),
            rho: mounting.rho,
            phi: mounting.phi,
            session: session.into(),
            job: job.clone(),
            job_sha256: format!("{:x}", Sha256::digest(job_text.as_bytes())),
            recorded: String::new(),
            reason: Reason::default(),
            end: None,
            next: Vec::new(),
            automatic_recovery: false,
            clock: LogClock::Wall { epoch_ns: 0 },
            lost: 0,
            late: 0,
            dropped_events: 0,
            motions: setup.names.clone(),
            notes: Vec::new(),
            settings: Settings::from(settings),
            under_way: Default::default(),
            orders_before: 0,
            models_before: 0,
            orders: Vec::new(),
            models: Vec::new(),
        };
        let texts = vec![("robot.toml".into(), robot_text.clone()), ("job.toml".into(), job_text.clone())];
        let recorder = RecorderThread {
            records,
            history: History::new(depth, joints, settings.guard.tracking),
            about,
            texts,
            before: (self.span * 1e3) as u64,
            simulated: waits,
            controls: Arc::clone(controls),
            stop_reason: None,
            pending: None,
        };
        let opened = inbox.send(Message::Open(Box::new(recorder))).is_ok();
        LoopRecorder { inbox: opened.then(|| inbox.clone()), ring, waits, lost: 0 }
    }

    pub fn note(&self, text: impl Into<String>) {
        self.send(Message::Note(text.into()));
    }

    pub fn set_reason(&self, reason: Reason) {
        self.send(Message::StopReason(reason));
    }

    /// Writes what is there up to `newest`, the cycle that was kept last, on request at `now_ns`.
    pub fn on_demand(&self, newest: u64, now_ns: u64) -> Result<(), String> {
        if self.inbox.is_none() {
            return Err("the job's `recorder.span` is 0 s: nothing is recorded".into());
        }
        self.requests.begin(now_ns)?;
        self.send(Message::OnDemand(newest));
        Ok(())
    }

    /// From now on remarks and reasons go to the caller of what is returned, and to no file.
    #[cfg(test)]
    pub fn remarks(&mut self) -> impl FnMut() -> Vec<String> + use<> {
        let (inbox, messages) = channel();
        self.inbox = Some(inbox);
        let words = |message: Message| match message {
            Message::Note(text) => Some(text),
            Message::StopReason(reason) => Some(format!("{}: {}", reason.kind, reason.text)),
            _ => None,
        };
        move || messages.try_iter().filter_map(words).collect()
    }

    fn send(&self, message: Message) {
        if let Some(inbox) = &self.inbox {
            // A recorder that has ended has logged why.
            let _ = inbox.send(message);
        }
    }
}

/// What has not been written yet is, before the program ends; a disk that takes nothing any more does not keep it from ending.
impl Drop for Recorder {
    fn drop(&mut self) {
        self.inbox = None;
        let Some(thread) = self.thread.take() else { return };
        let deadline = Instant::now() + LAST_WRITE_TIMEOUT;
        while !thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(PAUSE);
        }
        if !thread.is_finished() {
            tracing::error!(
                "the flight recorder was still writing after {LAST_WRITE_TIMEOUT:?}; its last recording is lost"
            );
        }
    }
}

/// Recordings on demand: one at a time, and a pause between two, so that requests do not block the recorder.
#[derive(Debug, Default)]
struct Requests {
    /// When the next may be requested; `u64::MAX` while one is queued or being written \[ns\].
    free_ns: AtomicU64,
}

impl Requests {
    /// Begins the one recording; the error is why not.
    fn begin(&self, now_ns: u64) -> Result<(), String> {
        match self.free_ns.load(Ordering::Acquire) {
            u64::MAX => Err("a recording on demand is being written; ask again when it is there".into()),
            free_ns if now_ns < free_ns => {
                let pause = ON_DEMAND_PAUSE_NS / 1_000_000_000;
                Err(format!("the last recording on demand has just been written; there is one in {pause} s at most"))
            }
            // Called by the bridge thread only.
            _ => {
                self.free_ns.store(u64::MAX, Ordering::Release);
                Ok(())
            }
        }
    }

    /// The recording is written, or was found to be of nothing.
    fn end(&self, now_ns: u64) {
        self.free_ns.store(now_ns.saturating_add(ON_DEMAND_PAUSE_NS), Ordering::Release);
    }
}

/// The bridge thread's end of the recorder, for one loop.
pub struct LoopRecorder {
    inbox: Option<Sender<Message>>,
    ring: Producer<Record>,
    /// Simulated time waits for the recorder; a real arm does not.
    waits: bool,
    lost: u64,
}

impl LoopRecorder {
    pub fn keep(&mut self, records: &[Record]) {
        if self.inbox.is_none() {
            return;
        }
        for record in records {
            while self.waits && self.ring.is_full() && !self.ring.is_abandoned() {
                std::thread::sleep(Duration::from_micros(50));
            }
            self.lost += u64::from(self.ring.push(*record).is_err());
        }
    }

    pub fn event(&self, event: TimedEvent) {
        self.send(|| Message::Event(event));
    }

    /// Reason of the loop's next requested stop.
    pub fn set_reason(&self, reason: Reason) {
        self.send(|| Message::StopReason(reason));
    }

    pub fn ordered(&self, given: RecordedOrder) {
        self.send(|| Message::Order(given));
    }

    pub fn handed(&self, model: RecordedModel, text: &str) {
        self.send(|| Message::Model(model, text.to_string()));
    }

    /// The loop has ended. `words` explain it, `next` is what the operator does; `goes_on`: the daemon recovers the arm without an operator.
    pub fn close(&mut self, left: &LoopEnd, words: &str, next: Vec<String>, goes_on: bool) {
        if self.lost > 0 {
            tracing::warn!("{} records did not reach the flight recorder in time", self.lost);
        }
        let (end, reason, dropped_events, flight, unanswered) = match left {
            LoopEnd::Panicked { message, flight, unanswered } => {
                let text = panicked(message);
                (text.clone(), Some(Reason::new(ReasonKind::Panic, text)), 0, flight, unanswered.as_deref().copied())
            }
            LoopEnd::Ended(outcome) => {
                let reason = kind_of_end(&outcome.end).map(|kind| Reason::new(kind, words));
                (outcome.end.to_string(), reason, outcome.summary.dropped_events, &outcome.flight, outcome.unanswered)
            }
        };
        let flight = flight.clone();
        self.send(|| {
            Message::Close(Box::new(Close { reason, end, next, goes_on, dropped_events, flight, unanswered }))
        });
    }

    fn send(&self, message: impl FnOnce() -> Message) {
        if let Some(inbox) = &self.inbox {
            let _ = inbox.send(message());
        }
    }
}

fn kind_of_end(end: &End) -> Option<ReasonKind> {
    Some(match end {
        End::Quit => return None,
        End::Fault(Fault::Silent { .. }) => ReasonKind::Silent,
        End::Fault(Fault::Reflex { .. }) => ReasonKind::Reflex,
        End::Fault(Fault::Refused { .. }) => ReasonKind::Refused,
        End::Fault(Fault::Disconnected) => ReasonKind::Disconnected,
        End::Unsafe(_) => ReasonKind::Unsafe,
        End::NoBrake => ReasonKind::NoBrake,
        End::NotRealTime => ReasonKind::NotRealTime,
        End::Clock { .. } => ReasonKind::Clock,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_on_demand_come_one_at_a_time_with_a_pause_between() {
        let requests = Requests::default();
        requests.begin(5).unwrap();
        assert!(requests.begin(6).unwrap_err().contains("is being written"));
        assert!(requests.begin(u64::MAX - 1).unwrap_err().contains("is being written"));
        requests.end(100);
        assert!(requests.begin(99 + ON_DEMAND_PAUSE_NS).unwrap_err().contains("one in 2 s"));
        requests.begin(100 + ON_DEMAND_PAUSE_NS).unwrap();
    }
}

//! An arm that another program controls: its states are received, recorded and served a model for. It is never commanded, so there is no loop.

mod arrivals;

use super::Daemon;
use super::gravity::Verdict;
use crate::analysis::collector::{MAX_GAP_S, MIN_RUN_S, states};
use crate::failure::Failure;
use crate::process::service::Progress as ServiceProgress;
use crate::setup::programme::Programme;
use arrivals::Arrivals;
use plumbline_core::{Command, JointVec, Phase, Record, Setpoint, State};
use plumbline_ipc::{GuestDelivery, GuestReceiver, GuestStatus, Progress, RobotId, now_ns};
use plumbline_model::Mounting;
use std::collections::VecDeque;
use std::time::Duration;

/// Pause when nothing has arrived.
const PAUSE: Duration = Duration::from_micros(500);
/// Time without a state after which it is reported \[ns\].
const SILENCE_NS: u64 = 1_000_000_000;

/// A run that is to be recorded.
struct Run {
    number: u32,
    name: String,
    ticks: u64,
}

/// Which run the next state belongs to.
struct Runs {
    left: VecDeque<Run>,
    /// Sample of the first of them that comes next.
    tick: u64,
    /// Sample that its part without a long gap begins with.
    part: u64,
    /// Time between two states \[s\].
    period: f64,
}

/// The place of a state in the programme.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    motion: u32,
    tick: u64,
    /// The run ends with this state.
    last: bool,
}

impl Runs {
    fn of(programme: &Programme, period: f64) -> Runs {
        let run = |own: &crate::setup::programme::Motion| Run {
            number: own.number,
            name: own.name.clone(),
            ticks: own.ticks() as u64,
        };
        Runs { left: programme.motions().map(run).collect(), tick: 0, part: 0, period }
    }

    /// The place of a state `gap` cycles after the one before. A long gap takes none of the run's time, nor does a part that is too short.
    fn place(&mut self, gap: u64) -> Option<Place> {
        let divided = gap > states(MAX_GAP_S, self.period);
        if divided {
            let is_kept = self.tick - self.part >= states(MIN_RUN_S, self.period);
            self.tick = if is_kept { self.tick } else { self.part };
            self.part = self.tick;
        }
        let skipped = if divided { 0 } else { gap.saturating_sub(1) };
        let run = self.left.front()?;
        let tick = (self.tick + skipped).min(run.ticks - 1);
        let place = Place { motion: run.number, tick, last: tick + 1 == run.ticks };
        self.tick = tick + 1;
        Some(place)
    }

    /// Goes on to the next run.
    fn next(&mut self) -> Option<Run> {
        (self.tick, self.part) = (0, 0);
        self.left.pop_front()
    }
}

struct Listening {
    receiver: GuestReceiver,
    arrivals: Arrivals,
    runs: Runs,
    mounting: Mounting,
    cycle: u64,
    last: Option<State>,
    /// When the last state arrived, and when its absence is looked at next \[ns\].
    arrived_ns: u64,
    look_ns: u64,
    /// Identity of the model that is served, 0 for none.
    model: u64,
    records: Vec<Record>,
}

impl Daemon {
    /// Receives the states of an arm that another program controls until the end is requested; records the programme's runs after the start.
    pub(super) fn listen(&mut self, id: &RobotId, programme: &Programme) -> Result<(), Failure> {
        let receiver = GuestReceiver::open(id).map_err(Failure::job)?;
        let (mounting, joints) = (self.state.mounting, self.state.setup.robot.chain.len());
        let period = self.state.setup.job.backend.sample_period();
        self.state.gravity.connect(mounting, None, mounting.gravity(), false);
        self.state.history.guest = Some(GuestStatus::default());
        let mut listening = Listening {
            receiver,
            arrivals: Arrivals::new(joints, period),
            runs: Runs::of(programme, period),
            mounting,
            cycle: 0,
            last: None,
            arrived_ns: now_ns(),
            look_ns: 0,
            model: 0,
            records: Vec::new(),
        };
        tracing::info!(
            "the daemon listens to robot `{id}` and commands nothing; it records after `plumbline command start`"
        );
        self.service.ready("listens; records after `plumbline command start`");
        while !self.state.must_quit() {
            self.answer_requests(None);
            listening.start(self);
            let busy = listening.receive(self)?;
            listening.serve_model(self);
            listening.report(self, id);
            self.service.beat(ServiceProgress::Waiting);
            if !busy {
                std::thread::sleep(PAUSE);
            }
        }
        Ok(())
    }
}

impl Listening {
    /// Starts or ends the recording where that was requested.
    fn start(&mut self, daemon: &mut Daemon) {
        let programme = &mut daemon.state.programme;
        if programme.start && programme.progress == Progress::Idle {
            programme.progress = Progress::Driving;
            tracing::info!("{} runs are recorded", self.runs.left.len());
        }
        if std::mem::take(&mut programme.stop_listening) && programme.progress == Progress::Driving {
            self.runs.left.clear();
            self.complete(daemon);
        }
    }

    /// Nothing more is recorded.
    fn complete(&mut self, daemon: &mut Daemon) {
        daemon.state.programme.driven = Some(daemon.server.served().published);
        daemon.state.programme.progress = Progress::Done;
        tracing::info!("the recording has ended; the daemon listens on");
    }

    /// Takes what has arrived; whether there was anything.
    fn receive(&mut self, daemon: &mut Daemon) -> Result<bool, Failure> {
        let deliveries = self.receiver.receive().map_err(Failure::job)?;
        let busy = !deliveries.is_empty();
        for delivery in deliveries {
            match delivery {
                GuestDelivery::Started { .. } => {
                    self.arrivals.restart();
                    tracing::info!("a publisher of states has started");
                }
                // Its numbers show the gap.
                GuestDelivery::Lost { from, to } => tracing::debug!("states {from} to {} were lost", to - 1),
                GuestDelivery::Samples(samples) => {
                    self.arrived_ns = now_ns();
                    for sample in &samples {
                        if let Some(state) = self.arrivals.take(sample) {
                            self.record(state, sample.stamp_ns, daemon);
                        }
                    }
                }
            }
        }
        self.publish(daemon);
        Ok(busy)
    }

    /// Makes the record of a state. A run that ends with it is published at once, so that its end is known with its samples.
    fn record(&mut self, state: State, stamp_ns: u64, daemon: &mut Daemon) {
        let gap = self.last.map_or(1, |last| state.seq - last.seq);
        let records = daemon.state.programme.progress == Progress::Driving;
        let place = if records { self.runs.place(gap) } else { None };
        // Outside a run the torques of an arm at rest are compared with the model's.
        let rests = |last: State| last.q_d == state.q_d;
        let phase = if place.is_none() && self.last.is_some_and(rests) { Phase::Hold } else { Phase::Excite };
        let (motion, tick) = place.map_or((0, 0), |place| (place.motion, place.tick));
        let desired = Setpoint { q: state.q_d, dq: JointVec::default(), ddq: JointVec::default() };
        self.records.push(Record {
            cycle: self.cycle,
            state,
            command: Command { seq: state.seq, desired, ..Command::default() },
            phase,
            motion,
            tick,
            model: self.model,
            stamp_ns,
            ..Record::default()
        });
        (self.cycle, self.last) = (self.cycle + 1, Some(state));
        if place.is_some_and(|place| place.last) {
            self.publish(daemon);
            if let Some(Run { number, name, .. }) = self.runs.next() {
                tracing::info!("{name} was recorded");
                daemon.state.programme.ended.push(number);
            }
            if self.runs.left.is_empty() {
                self.complete(daemon);
            }
        }
    }

    fn publish(&mut self, daemon: &mut Daemon) {
        if !self.records.is_empty() {
            daemon.server.publish(&self.records);
            daemon.state.take_records(&self.records, None);
            self.records.clear();
        }
    }

    /// Publishes the model that the daemon has accepted, for the program that controls the arm.
    fn serve_model(&mut self, daemon: &mut Daemon) {
        let gravity = match daemon.state.model_for_loop(&self.mounting) {
            Some((accepted, Verdict::Serve(gravity))) => {
                self.model = accepted.id;
                gravity
            }
            Some((_, Verdict::Refuse(_))) => {
                self.model = 0;
                self.mounting.gravity()
            }
            Some((_, Verdict::Wait)) | None => return,
        };
        daemon.publish_model(self.model, gravity.into(), self.mounting.gravity().into());
    }

    /// Reports counters, and a publisher that is absent, silent or unusable.
    fn report(&mut self, daemon: &mut Daemon, id: &RobotId) {
        let now = now_ns();
        if now < self.look_ns {
            return;
        }
        // A tenth of a second: a publisher is looked for in files.
        self.look_ns = now + SILENCE_NS / 10;
        let silent = now.saturating_sub(self.arrived_ns) > SILENCE_NS;
        let problem = match self.arrivals.unusable() {
            _ if silent && self.receiver.is_published() => {
                Some(format!("the publisher of the states of robot `{id}` sends none: its control loop stands"))
            }
            _ if silent => Some(format!(
                "nobody publishes the states of robot `{id}`: start the program that controls the arm and calls `Guest::publish`"
            )),
            unusable => unusable.map(|why| why.to_string()),
        };
        let counts = self.arrivals.counts(self.receiver.counts());
        let status = GuestStatus { counts, problem };
        if let Some(before) = daemon.state.history.guest.replace(status.clone())
            && before.problem != status.problem
        {
            match &status.problem {
                Some(problem) => tracing::warn!("{problem}; what was recorded so far is kept"),
                None => tracing::info!("states arrive again"),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_ends_with_its_last_sample_and_a_long_gap_takes_none_of_its_time() {
        let run = |number| Run { number, name: String::new(), ticks: 5010 };
        let mut runs = Runs { left: [run(1), run(2)].into(), tick: 0, part: 0, period: 1e-3 };
        // A part that is long enough, and one that is not: its time is given back.
        for _ in 0..5000 {
            runs.place(1);
        }
        runs.place(500);
        let mut places = Vec::new();
        for gap in [1, 1, 500, 1, 1, 4, 1, 1, 5, 1] {
            let place = runs.place(gap).unwrap();
            places.push((place.motion, place.tick, place.last));
            if place.last {
                runs.next();
            }
        }
        let expected = [1, 2, 0, 1, 2, 6, 7, 8, 9].map(|tick| (1, 5000 + tick, tick == 9));
        assert_eq!(places, [&expected[..], &[(2, 0, false)]].concat());
        runs.next();
        assert_eq!(runs.place(1), None);
    }
}

//! The arm in the loop.

// The walls of the real-time loop: clippy.toml.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use super::codes::{
    REFUSED_BEFORE_START, REFUSED_JUMP, REFUSED_NOT_FINITE, REFUSED_POSITION, REFUSED_REACH, REFUSED_STOPPED,
    REFUSED_UNSENT,
};
use super::connect::Info;
use super::error::ConnectError;
use super::limiter::{Limited, Objection};
use super::limits::{RobotLimits, narrow, widen};
use super::motion::{Answer, Motion};
use super::reference::{Followed, Point};
use super::session::Session;
use super::settings::{Interface, Purpose, Settings};
use super::tcp::{CommandLink, Gone};
use super::telemetry::{Arrivals, Recent, Telemetry};
use super::torque::Tracking;
use super::udp::{Found, StateLink};
use super::wire::{Protocol, RobotCommand, RobotState};
use plumbline_core::{Backend, Command, Fault, PERIOD, PERIOD_NS, State};
use plumbline_rt::os::now_ns;
use std::sync::Arc;
use std::time::Duration;

/// Datagrams that one read looks at, so that a flood can't hold it.
const MOST_PER_READ: u32 = 4096;
/// Commands in a row that the system may refuse.
const MOST_UNSENT: u32 = 20;
/// States in a row with smaller numbers than the last one before them that are no late ones: the numbers have started again.
const RESTARTED: u64 = 3;
/// Milliseconds behind the newest state beyond which none is late.
const LATEST: u64 = 1000;
/// Cycles of a motion before the arm's count of commands says something.
const RATE_FROM: u64 = 100;

/// Where a session is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Nothing was commanded yet.
    Ready,
    /// A motion runs.
    Moving,
    /// The motion is over, for this reason.
    Over(Fault),
    /// Stopped by us.
    Stopped,
}

/// A Franka arm with an open session. Made by [`super::connect()`]; dropping it ends its motion.
#[derive(Debug)]
pub struct FrankaArm {
    pub(super) commands: CommandLink,
    pub(super) states: StateLink,
    pub(super) telemetry: Arc<Telemetry>,
    pub(super) limits: RobotLimits,
    pub(super) settings: Settings,
    pub(super) phase: Phase,
    pub(super) motion: Motion,
    pub(super) recent: Recent,
    /// The newest state.
    pub(super) state: RobotState,
    /// The first state of a running motion that no longer shows it.
    pub(super) changed: Option<RobotState>,
    pub(super) followed: Followed,
    first_id: u64,
    begun: bool,
    /// When the newest state reached the kernel, and when it was read \[ns\].
    arrived_ns: Option<u64>,
    read_ns: u64,
    /// When the datagram before it reached the kernel \[ns\].
    before_ns: Option<u64>,
    unsent: u32,
}

impl FrankaArm {
    pub(super) fn new(
        settings: &Settings,
        session: Session,
        info: &Info,
        telemetry: Arc<Telemetry>,
    ) -> Result<FrankaArm, ConnectError> {
        let address = settings.address;
        let cant = |cause| ConnectError::Socket { address, what: "switching blocking off", cause };
        let state = info.state;
        let point = Point::at_rest(state.q_d);
        Ok(FrankaArm {
            commands: session.commands.into_nonblocking().map_err(cant)?,
            states: session.states,
            telemetry,
            limits: info.limits,
            settings: settings.clone(),
            phase: Phase::Ready,
            motion: Motion::new(settings, &info.limits, &state, info.protocol),
            recent: Recent::default(),
            state,
            changed: None,
            followed: Followed { point, alone: 0, own: true, shown_ns: None, late: false },
            first_id: state.message_id,
            begun: false,
            arrived_ns: None,
            read_ns: 0,
            before_ns: None,
            unsent: 0,
        })
    }

    pub(super) fn protocol(&self) -> Protocol {
        self.states.protocol()
    }

    /// Waits up to `timeout` for a state that is newer than the last, and takes the newest that is there.
    pub(super) fn take_newest(&mut self, timeout: Duration) -> Result<(), Fault> {
        let begin = now_ns();
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let before = self.state.message_id;
        let (mut taken, mut oldest_ns, mut interval_ns) = (0u64, None, None);
        // Of states with a smaller number than the last: how many, and the last of their numbers.
        let mut older = (0u64, 0u64);
        for _ in 0..MOST_PER_READ {
            match self.states.receive(taken == 0) {
                Found::State(state, at_ns) => {
                    if self.takes(&state) {
                        taken += 1;
                        oldest_ns = oldest_ns.or(at_ns);
                        interval_ns =
                            interval_ns.or(at_ns.zip(self.before_ns).map(|(now, last)| now.saturating_sub(last)));
                        self.before_ns = at_ns.or(self.before_ns);
                        self.arrived_ns = at_ns;
                        self.look_for_an_end(&state);
                        self.state = state;
                    } else if state.message_id < before && state.message_id > older.1 {
                        older = (older.0 + 1, state.message_id);
                    }
                }
                Found::Bad => self.telemetry.bad(),
                Found::Foreign => self.telemetry.foreign(),
                Found::Nothing if taken > 0 => break,
                Found::Nothing => {}
                Found::Broken => return Err(Fault::Disconnected),
            }
            if taken == 0 {
                if self.phase == Phase::Moving && self.hear().is_err() {
                    return Err(Fault::Disconnected);
                }
                let waited = now_ns().saturating_sub(begin);
                if waited >= timeout_ns {
                    if older.0 >= RESTARTED && before.saturating_sub(older.1) > LATEST {
                        self.telemetry.restarted(before, older.1);
                    }
                    // An arm that has closed the connection falls silent, too.
                    if self.hear().is_err() {
                        return Err(Fault::Disconnected);
                    }
                    return Err(Fault::Silent { waited_ms: (waited / 1_000_000).min(u64::from(u32::MAX)) as u32 });
                }
            }
        }
        if taken == 0 {
            return Err(Fault::Silent { waited_ms: (now_ns().saturating_sub(begin) / 1_000_000) as u32 });
        }
        self.read_ns = now_ns();
        // What queued up before the motion began is nobody's loss.
        let gap = if self.begun { self.state.message_id.saturating_sub(before) } else { taken };
        let lost = gap.saturating_sub(taken);
        let wake_ns = oldest_ns.map(|oldest| self.read_ns.saturating_sub(oldest)).filter(|_| self.begun);
        let interval_ns = interval_ns.filter(|_| self.begun);
        let arrivals =
            Arrivals { skipped: taken.saturating_sub(1), lost, gap: gap.saturating_sub(1), interval_ns, wake_ns };
        self.telemetry.took(&arrivals, self.state.robot_mode);
        self.recent.read(wake_ns.unwrap_or(0), interval_ns.unwrap_or(0), lost);
        self.begun = true;
        Ok(())
    }

    /// Lets go of the states that have queued up since the session was opened; the newest of them may be old, because a full socket
    /// keeps the oldest.
    pub(super) fn discard_backlog(&mut self) -> Result<(), Fault> {
        self.take_newest(self.settings.state_timeout)?;
        self.begun = false;
        self.take_newest(self.settings.state_timeout)?;
        self.recent = Recent::default();
        Ok(())
    }

    /// Whether `state` is newer than what was taken before; counts it otherwise.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn takes(&self, state: &RobotState) -> bool {
        match state.message_id.cmp(&self.state.message_id) {
            std::cmp::Ordering::Greater => true,
            std::cmp::Ordering::Equal => {
                self.telemetry.duplicate();
                false
            }
            std::cmp::Ordering::Less => {
                self.telemetry.out_of_order();
                false
            }
        }
    }

    /// Keeps the first state that no longer shows the running motion: its reasons are the ones to report.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn look_for_an_end(&mut self, state: &RobotState) {
        if self.phase == Phase::Moving && self.changed.is_none() && !self.motion.is_shown_by(state) {
            self.changed = Some(*state);
        }
    }

    /// Hears what the arm says about the motion over TCP.
    pub(super) fn hear(&mut self) -> Result<(), Gone> {
        let heard = self.take_answers();
        if let Err(Gone::Garbled(bytes)) = heard {
            self.telemetry.garbled(&bytes);
        }
        heard
    }

    fn take_answers(&mut self) -> Result<(), Gone> {
        let Some(id) = self.motion.call else { return self.commands.pass_over() };
        while let Some(status) = self.commands.move_answer(self.protocol(), id)? {
            self.motion.heard(status);
            self.telemetry.move_answered(status);
        }
        Ok(())
    }

    /// The newest state as the loop takes it.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn report(&self) -> State {
        let state = &self.state;
        let q_d = if self.phase == Phase::Moving { self.motion.position(&self.followed) } else { state.q_d };
        State {
            seq: state.message_id,
            time: state.message_id.saturating_sub(self.first_id) as f64 * PERIOD,
            q: widen(&state.q),
            dq: widen(&state.dq),
            tau: widen(&state.tau_j),
            q_d: widen(&q_d),
        }
    }

    /// One cycle of a running motion: the newest state, and whether the motion goes on.
    fn go_on(&mut self) -> Result<State, Fault> {
        let taken = self.take_newest(self.settings.state_timeout);
        let heard = self.hear();
        if self.changed.is_some() || self.motion.is_over() {
            return Err(self.conclude());
        }
        taken?;
        heard.map_err(|_| Fault::Disconnected)?;
        self.follow();
        if self.motion.cycles >= RATE_FROM {
            self.telemetry.rate(self.state.control_command_success_rate);
        }
        Ok(self.report())
    }

    /// Finds out where the arm goes on from.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(super) fn follow(&mut self) {
        self.followed = self.motion.follow(&self.state);
        let arrived_ns = self.arrived_ns.unwrap_or(self.read_ns);
        let round_trip_ns = self.followed.shown_ns.map(|sent_ns| arrived_ns.saturating_sub(sent_ns));
        self.telemetry.followed(self.followed.late, self.followed.own, round_trip_ns);
    }

    /// Sends `answer`, and remembers it if it has left.
    pub(super) fn send(&mut self, answer: &Answer) -> Result<(), Fault> {
        let command = self.motion.command(&self.state, answer);
        let sent = self.states.send(&command);
        let now = now_ns();
        if !sent {
            self.telemetry.unsent();
            self.unsent += 1;
            return if self.unsent >= MOST_UNSENT { Err(Fault::Refused { code: REFUSED_UNSENT }) } else { Ok(()) };
        }
        self.unsent = 0;
        self.motion.sent(self.state.message_id, now, answer);
        let work_ns = now.saturating_sub(self.read_ns);
        let slow = now.saturating_sub(self.arrived_ns.unwrap_or(self.read_ns)) > PERIOD_NS;
        self.telemetry.sent(work_ns, slow, answer.held, answer.returning);
        self.recent.sent(work_ns);
        Ok(())
    }

    /// Answers the newest state of a running motion.
    fn answer(&mut self, command: &Command) -> Result<(), Fault> {
        let refused = |code| Err(Fault::Refused { code });
        let (desired, dq_d) = (narrow(&command.desired.q), narrow(&command.desired.dq));
        let (tau_ff, tau_vendor) = (narrow(&command.tau_ff.0), narrow(&command.tau_vendor.0));
        // The arm's own controller adds `tau_vendor`.
        let ahead: [f64; 7] = std::array::from_fn(|j| tau_ff[j] - tau_vendor[j]);
        if desired.iter().chain(&dq_d).chain(&ahead).any(|value| !value.is_finite()) {
            return refused(REFUSED_NOT_FINITE);
        }
        let from = self.followed.point;
        match self.motion.limiter.objection(&from, &desired) {
            Some(Objection::NotFinite) => return refused(REFUSED_NOT_FINITE),
            Some(Objection::Position) => return refused(REFUSED_POSITION),
            Some(Objection::Jump) => return refused(REFUSED_JUMP),
            None => {}
        }
        let ticks = self.motion.ticks_since(self.state.message_id);
        if ticks == 0 {
            // This state was answered before; one command per state is all that the arm takes.
            return Ok(());
        }
        if self.settings.interface == Interface::Torque {
            let tracking = Tracking::of(desired, dq_d, &self.state);
            if self.motion.torque.out_of_reach(&tracking) {
                return refused(REFUSED_REACH);
            }
            let (tau, held) = self.motion.torque.torque(&tracking, &ahead);
            let point = Point { q: desired, dq: dq_d, ddq: [0.0; 7] };
            return self.send(&Answer { point, tau, held, ..Answer::default() });
        }
        let own = self.followed.own && self.followed.alone == 0;
        let Limited { point, held, returning, aim } = self.motion.step(&from, &desired, ticks, own);
        self.send(&Answer { point, held, returning, aim: Some(aim), ..Answer::default() })
    }
}

impl Backend for FrankaArm {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        let state = match self.phase {
            Phase::Over(fault) => return Err(fault),
            Phase::Ready if self.settings.purpose == Purpose::Drive => self.begin().map(|()| self.report()),
            Phase::Moving => self.go_on(),
            Phase::Ready if !self.begun => return self.discard_backlog().map(|()| self.report()),
            Phase::Ready | Phase::Stopped => {
                return self.take_newest(self.settings.state_timeout).map(|()| self.report());
            }
        };
        if let Err(fault) = state {
            self.telemetry.stalled(&self.recent.worst());
            self.phase = Phase::Over(fault);
        }
        state
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        match (self.settings.purpose, self.phase) {
            (Purpose::Monitor, _) => Ok(()),
            (Purpose::Drive, Phase::Moving) => self.answer(command),
            (Purpose::Drive, Phase::Ready) => Err(Fault::Refused { code: REFUSED_BEFORE_START }),
            (Purpose::Drive, Phase::Over(_) | Phase::Stopped) => Err(Fault::Refused { code: REFUSED_STOPPED }),
        }
    }

    fn stop(&mut self) {
        self.halt();
    }

    /// When the kernel took the newest state in: what lies between that and its being read is the wake-up.
    fn deadline_ns(&self) -> Option<u64> {
        self.arrived_ns
    }
}

impl Drop for FrankaArm {
    fn drop(&mut self) {
        self.halt();
    }
}

/// A command with nothing in it but the number of the state that it answers.
pub(super) fn answer_to(state: &RobotState) -> RobotCommand {
    RobotCommand { message_id: state.message_id, ..RobotCommand::default() }
}

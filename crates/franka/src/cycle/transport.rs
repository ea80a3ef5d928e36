//! The connections of an open session: states in, commands and calls out, answers in. Counts what it receives, and keeps what the arm reports of the
//! last call of Move.

use super::udp::{Received, StateLink};
use crate::codes::REFUSED_UNSENT;
use crate::tcp::{CommandLink, ConnectionLost};
use crate::telemetry::{Arrivals, Recent, Telemetry};
use crate::wire::{
    ControllerMode, MotionGeneratorMode, Move, MoveStatus, Protocol, Request, RobotCommand, RobotMode, RobotState,
};
use plumbline_core::{Fault, PERIOD_NS};
use plumbline_rt::os::now_ns;
use std::sync::Arc;
use std::time::Duration;

/// Datagrams per read, so that a flood does not block it.
const MAX_DATAGRAMS_PER_READ: u32 = 4096;
/// Commands in a row that the system may refuse.
const MAX_UNSENT: u32 = 20;
/// States in a row with smaller numbers than the last one before them that are not late: the arm has started its numbers again.
const RESTARTED_STATES: u64 = 3;
/// A state is late by at most so many milliseconds; one farther behind has a number of another count.
const MAX_LATE_MS: u64 = 1000;

/// One call of Move, as the arm reports it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MoveCall {
    id: u32,
    generator: MotionGeneratorMode,
    controller: ControllerMode,
    /// A state has shown the motion, and the session has not left it.
    pub running: bool,
    /// The first state of a running motion that no longer shows it: its reasons are the ones to report.
    pub ended_in: Option<RobotState>,
    /// The arm's final answer.
    pub answer: Option<MoveStatus>,
}

impl MoveCall {
    /// Whether `state` shows this motion running.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn is_shown_by(&self, state: &RobotState) -> bool {
        state.motion_generator_mode == self.generator
            && state.controller_mode == self.controller
            && state.robot_mode == RobotMode::Move
    }

    /// Whether the arm has reported the end, by a state or an answer.
    pub fn has_ended(&self) -> bool {
        self.ended_in.is_some() || self.answer.is_some()
    }
}

/// The connections of an open session.
#[derive(Debug)]
pub(crate) struct Transport {
    commands: CommandLink,
    states: StateLink,
    pub telemetry: Arc<Telemetry>,
    pub recent: Recent,
    /// The newest state.
    pub state: RobotState,
    /// The last call of Move.
    pub call: Option<MoveCall>,
    /// A state was taken since the session was opened, or since its backlog was discarded.
    pub has_read: bool,
    /// When the newest state reached the kernel, and when it was read \[ns\].
    arrived_ns: Option<u64>,
    read_ns: u64,
    /// When the datagram before it reached the kernel \[ns\].
    before_ns: Option<u64>,
    unsent: u32,
}

impl Transport {
    /// The connections of a session whose first state is `state`.
    ///
    /// # Errors
    /// The system does not switch blocking off.
    pub fn new(
        commands: CommandLink,
        states: StateLink,
        telemetry: Arc<Telemetry>,
        state: RobotState,
    ) -> std::io::Result<Transport> {
        Ok(Transport {
            commands: commands.into_nonblocking()?,
            states,
            telemetry,
            recent: Recent::default(),
            state,
            call: None,
            has_read: false,
            arrived_ns: None,
            read_ns: 0,
            before_ns: None,
            unsent: 0,
        })
    }

    pub fn protocol(&self) -> Protocol {
        self.states.protocol()
    }

    /// When the newest state reached the kernel \[ns\].
    pub fn arrived_ns(&self) -> Option<u64> {
        self.arrived_ns
    }

    /// When the newest state arrived: by the kernel's time stamp, else when it was read \[ns\].
    pub fn arrival_ns(&self) -> u64 {
        self.arrived_ns.unwrap_or(self.read_ns)
    }

    /// Waits up to `timeout` for a state that is newer than the last, and takes the newest that is there.
    pub fn take_newest(&mut self, timeout: Duration) -> Result<(), Fault> {
        let begin = now_ns();
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let before = self.state.message_id;
        let (mut taken, mut oldest_ns, mut interval_ns) = (0u64, None, None);
        // Of states with a smaller number than the last: how many, and the last of their numbers.
        let mut older = (0u64, 0u64);
        for _ in 0..MAX_DATAGRAMS_PER_READ {
            match self.states.receive(taken == 0) {
                Received::State(state, at_ns) => {
                    if self.is_newer(&state) {
                        taken += 1;
                        oldest_ns = oldest_ns.or(at_ns);
                        interval_ns =
                            interval_ns.or(at_ns.zip(self.before_ns).map(|(now, last)| now.saturating_sub(last)));
                        self.before_ns = at_ns.or(self.before_ns);
                        self.arrived_ns = at_ns;
                        self.check_end(&state);
                        self.state = state;
                    } else if state.message_id < before && state.message_id > older.1 {
                        older = (older.0 + 1, state.message_id);
                    }
                }
                Received::Bad => self.telemetry.bad(),
                Received::Foreign => self.telemetry.foreign(),
                Received::Nothing if taken > 0 => break,
                Received::Nothing => {}
                Received::Broken => return Err(Fault::Disconnected),
            }
            if taken == 0 {
                if self.is_moving() && self.read_answers().is_err() {
                    return Err(Fault::Disconnected);
                }
                let waited = now_ns().saturating_sub(begin);
                if waited >= timeout_ns {
                    if older.0 >= RESTARTED_STATES && before.saturating_sub(older.1) > MAX_LATE_MS {
                        self.telemetry.restarted(before, older.1);
                    }
                    // An arm that has closed the connection sends no states, too.
                    if self.read_answers().is_err() {
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
        // States that queued up before the first read are not lost.
        let gap = if self.has_read { self.state.message_id.saturating_sub(before) } else { taken };
        let lost = gap.saturating_sub(taken);
        let wake_ns = oldest_ns.map(|oldest| self.read_ns.saturating_sub(oldest)).filter(|_| self.has_read);
        let interval_ns = interval_ns.filter(|_| self.has_read);
        let arrivals =
            Arrivals { skipped: taken.saturating_sub(1), lost, gap: gap.saturating_sub(1), interval_ns, wake_ns };
        self.telemetry.took(&arrivals, self.state.robot_mode);
        self.recent.read(wake_ns.unwrap_or(0), interval_ns.unwrap_or(0), lost);
        self.has_read = true;
        Ok(())
    }

    /// Discards the states that have queued up since the session was opened; the newest of them may be old, because a full socket
    /// keeps the oldest.
    pub fn discard_backlog(&mut self, timeout: Duration) -> Result<(), Fault> {
        self.take_newest(timeout)?;
        self.has_read = false;
        self.take_newest(timeout)?;
        self.recent = Recent::default();
        Ok(())
    }

    /// Whether `state` is newer than the last; counts it otherwise.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn is_newer(&self, state: &RobotState) -> bool {
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

    /// Keeps the first state that no longer shows the running motion.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn check_end(&mut self, state: &RobotState) {
        if let Some(call) = &mut self.call
            && call.running
            && call.ended_in.is_none()
            && !call.is_shown_by(state)
        {
            call.ended_in = Some(*state);
        }
    }

    fn is_moving(&self) -> bool {
        self.call.as_ref().is_some_and(|call| call.running)
    }

    /// Asks for a motion.
    pub fn call_move(&mut self, request: Move) -> Result<(), ConnectionLost> {
        let id = self.commands.post(self.protocol(), &Request::Move(request))?;
        let generator = request.generator.shown().shown_at(self.protocol());
        let controller = request.controller.shown();
        self.call = Some(MoveCall { id, generator, controller, running: false, ended_in: None, answer: None });
        Ok(())
    }

    /// Asks the arm to stop by itself.
    pub fn call_stop(&mut self) -> Result<(), ConnectionLost> {
        self.commands.post(self.protocol(), &Request::StopMove).map(drop)
    }

    /// Whether the newest state shows the motion of the last call.
    pub fn shows_motion(&self) -> bool {
        self.call.as_ref().is_some_and(|call| call.is_shown_by(&self.state))
    }

    /// The motion runs from now on, or the session leaves it.
    pub fn set_running(&mut self, running: bool) {
        if let Some(call) = &mut self.call {
            call.running = running;
        }
    }

    /// Whether the arm has reported the end of the motion.
    pub fn motion_has_ended(&self) -> bool {
        self.call.as_ref().is_some_and(|call| call.has_ended())
    }

    /// The first state of a running motion that no longer shows it.
    pub fn ended_in(&self) -> Option<&RobotState> {
        self.call.as_ref().and_then(|call| call.ended_in.as_ref())
    }

    /// The arm's final answer about the motion.
    pub fn answer(&self) -> Option<MoveStatus> {
        self.call.as_ref().and_then(|call| call.answer)
    }

    /// Takes the answers about the motion that have come over TCP.
    pub fn read_answers(&mut self) -> Result<(), ConnectionLost> {
        let read = self.take_answers();
        if let Err(ConnectionLost::Garbled(bytes)) = read {
            self.telemetry.garbled(&bytes);
        }
        read
    }

    fn take_answers(&mut self) -> Result<(), ConnectionLost> {
        let Some(id) = self.call.as_ref().map(|call| call.id) else { return self.commands.skip_arrived() };
        while let Some(status) = self.commands.move_answer(self.protocol(), id)? {
            if let Some(call) = self.call.as_mut().filter(|_| status != MoveStatus::MotionStarted) {
                call.answer = Some(status);
            }
            self.telemetry.move_answered(status);
        }
        Ok(())
    }

    /// Sends a command; when it left \[ns\], `None` where the system did not take it.
    pub fn send(&mut self, command: &RobotCommand) -> Result<Option<u64>, Fault> {
        let sent = self.states.send(command);
        let now = now_ns();
        if sent {
            self.unsent = 0;
            return Ok(Some(now));
        }
        self.telemetry.unsent();
        self.unsent += 1;
        if self.unsent >= MAX_UNSENT { Err(Fault::Refused { code: REFUSED_UNSENT }) } else { Ok(None) }
    }

    /// Counts a command that left at `now` \[ns\].
    pub fn count_sent(&mut self, now: u64, held: bool, returning: bool) {
        let work_ns = now.saturating_sub(self.read_ns);
        let slow = now.saturating_sub(self.arrival_ns()) > PERIOD_NS;
        self.telemetry.sent(work_ns, slow, held, returning);
        self.recent.sent(work_ns);
    }
}

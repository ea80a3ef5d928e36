//! The loop: read, reference, feed-forward, guard, write, record.
//!
//! It runs on its own thread and is paced by the arm's blocking `read`. One pass per state takes at most one order and one model, sends one
//! command and makes one record. A failure of the arm ends the loop; a failure of a command causes a controlled stop, and the loop then
//! holds until an operator resumes it.
//!
//! - The feed-forward torque is that of the served model at the desired setpoint, in every cycle, also at rest. Models change between two
//!   cycles; the torque changes within the torque-rate limit. A model whose torque breaks a limit is not evaluated again: the model before
//!   it serves, or the torque returns to zero ([`torque`](super::torque)).
//! - A lost state is a cycle of the arm without a command. Motions follow the arm's counter: the next sample is the one that is due, and the
//!   guard differences over the time that has passed.

mod outcome;

pub use outcome::{End, Outcome};

use super::checkpoint::Checkpoint;
use super::guard::{Guard, Violation};
use super::motion::{Finished, Motion};
use super::moves::{NoMotion, Planner, seconds};
use super::order::{Event, Handles, Inlets, Order, OrderKind, StopReason, TimedEvent, rings};
use super::os::now_ns;
use super::recorder::Flight;
use super::retired::Retired;
use super::rights::{Rights, become_realtime};
use super::settings::{CycleSettings, SetupError};
use super::stats::Tally;
use super::torque::{Answer, TorqueSource, Torques};
use assert_no_alloc::{assert_no_alloc, reset_violation_count, violation_count};
use plumbline_core::{
    Backend, Command, JointVec, Kinematics, LoopStatistics, MAX_JOINTS, Record, Reference, Sink, State, Validity,
};

/// The loop and its memory, allocated before it starts.
pub struct Cycle<B: Backend, S: Sink> {
    backend: B,
    sink: S,
    joints: usize,
    tracking: JointVec,
    max_lost: u64,
    heartbeat_timeout: Option<u64>,
    /// Count of heartbeats, and cycles of the arm since the last.
    last_heartbeat: (u64, u64),
    rights: Rights,
    must_be_realtime: bool,
    inlets: Inlets,
    /// Orders with an older permission than this are discarded.
    permission: u32,
    motion: Motion,
    torque: TorqueSource,
    guard: Guard,
    /// A reference that waits for room in the ring; no order or model is taken before it has been pushed.
    leaving: Option<Box<dyn Reference>>,
    tally: Tally,
    work_ns: u64,
    /// Time at which the present cycle's state was read \[ns\].
    stamp_ns: u64,
    /// Orders taken out of the queue so far.
    orders: u32,
    unanswered: Option<State>,
    flight: Flight,
    stops: u32,
    last_stop: Option<StopReason>,
}

/// A command with its torque.
type Next = (Command, Answer);

/// Builds the loop and the outside end of its rings.
pub fn new<B: Backend, S: Sink>(
    backend: B,
    sink: S,
    kinematics: Option<Box<dyn Kinematics>>,
    settings: CycleSettings,
) -> Result<(Cycle<B, S>, Handles), SetupError> {
    let joints = backend.joints();
    settings.check(joints, kinematics.is_some())?;
    let (inlets, handles) = rings(settings.queue);
    let planner = Planner::new(joints, settings.guard.limits, settings.moves);
    let cycle = Cycle {
        backend,
        sink,
        joints,
        tracking: settings.guard.tracking,
        max_lost: settings.max_consecutive_lost,
        heartbeat_timeout: settings.heartbeat_timeout,
        last_heartbeat: (0, 0),
        rights: settings.rights,
        must_be_realtime: settings.must_be_realtime,
        inlets,
        permission: 0,
        motion: Motion::new(joints, planner),
        torque: TorqueSource::new(joints, &settings.guard.limits.dtau),
        guard: Guard::new(joints, settings.guard, settings.moves.brake, kinematics),
        leaving: None,
        tally: Tally::new(),
        work_ns: 0,
        stamp_ns: 0,
        orders: 0,
        unanswered: None,
        flight: Flight::new(settings.flight),
        stops: 0,
        last_stop: None,
    };
    Ok((cycle, handles))
}

impl<B: Backend, S: Sink> Cycle<B, S> {
    /// Runs until the loop ends; call it on the real-time thread.
    pub fn run(&mut self) -> Outcome {
        let granted = become_realtime(&self.rights);
        // Published before the first cycle, so that the supervisor can report a degraded loop while it runs.
        let _ = self.inlets.granted.set(granted.clone());
        let watched = allocations_are_watched();
        let before = violation_count();
        let end = if self.must_be_realtime && granted.refusals().next().is_some() {
            self.backend.stop();
            End::NotRealTime
        } else {
            assert_no_alloc(|| self.cycles())
        };
        Outcome {
            end,
            stops: self.stops,
            last_stop: self.last_stop,
            summary: self.tally.summary(),
            granted,
            allocations: watched.then(|| violation_count().wrapping_sub(before)),
            flight: self.flight.in_order(),
            unanswered: self.unanswered,
        }
    }

    /// Runs passes until one ends the loop.
    #[cfg_attr(feature = "rtsan", rtsan_standalone::nonblocking)]
    fn cycles(&mut self) -> End {
        loop {
            if let Err(end) = self.cycle() {
                self.backend.stop();
                break end;
            }
        }
    }

    /// Continues from the state of another loop; call it before [`run`](Cycle::run). Counts restart, cycle numbers continue.
    ///
    /// # Errors
    /// [`NoMotion`] when the interrupted motion can't be planned again.
    pub fn restore(&mut self, checkpoint: Checkpoint) -> Result<(), NoMotion> {
        let Checkpoint { doing, last, models } = checkpoint;
        let [.., newest] = &last;
        if matches!(doing, super::checkpoint::Doing::Stopped) {
            self.inlets.controls.wait_for_permission();
        }
        self.motion.restore(doing, newest)?;
        self.guard.restore(&last);
        self.tally.restore(newest);
        let Command { desired, tau_ff, tau_vendor, .. } = newest.command;
        self.torque.restore(models, &desired, Torques { tau_ff, tau_vendor }, newest.validity);
        Ok(())
    }

    /// After a panic in [`run`](Cycle::run): stops the arm by its own means, then hands out the last cycles, oldest first, and the state
    /// that was not answered.
    pub fn after_panic(&mut self) -> (Vec<Record>, Option<State>) {
        self.backend.stop();
        (self.flight.in_order(), self.unanswered)
    }

    /// One pass.
    fn cycle(&mut self) -> Result<(), End> {
        if self.inlets.controls.wants_quit() && (self.motion.is_holding() || self.motion.is_stopped()) {
            return Err(End::Quit);
        }
        // Read: the arm paces the loop.
        let state = self.backend.read().map_err(End::Fault)?;
        let stamp_ns = now_ns();
        (self.stamp_ns, self.unanswered) = (stamp_ns, Some(state));
        let gap = self.arrived(&state, stamp_ns)?;
        // Reference: requests first, then the motion's place by the arm's clock.
        self.advance(gap);
        self.listen(gap)?;
        // Feed-forward: the served model at the desired setpoint.
        let mut next = self.answer(state.seq);
        // Guard: a command that breaks a limit is not sent; the first sample of the stop is sent instead.
        if self.motion.is_stopping() {
            next = self.check_brake(gap, next, Some(&state))?;
        } else if let Err(violation) = self.guard.check(seconds(gap), &next.0, &next.1.asked, &state) {
            self.brake(StopReason::Guard(violation), gap)?;
            let first = self.answer(state.seq);
            next = self.check_brake(gap, first, None)?;
        }
        // Write and record.
        let (command, answer) = next;
        let written = self.backend.write(&command);
        self.motion.sent(&command.desired);
        self.torque.sent(&answer);
        let doubtful = answer.validity == Validity::Valid && self.inlets.controls.doubts(self.torque.id());
        let validity = if doubtful { Validity::Doubtful } else { answer.validity };
        self.record(state, command, validity, stamp_ns);
        self.unanswered = None;
        written.map_err(End::Fault)
    }

    /// The sample of a stop that is sent. A stop continues without a model that breaks limits; any other violation ends the loop.
    fn check_brake(&mut self, gap: u64, next: Next, state: Option<&State>) -> Result<Next, End> {
        let mut next = next;
        // The model, the one before it, and none.
        loop {
            let (command, answer) = &next;
            let Err(violation) = self.guard.check_brake(seconds(gap), command, &answer.asked, state) else {
                return Ok(next);
            };
            if !self.distrust(violation) {
                return Err(End::Unsafe(violation));
            }
            next = self.answer(command.seq);
        }
    }

    /// Counts the state; the first one is where the arm holds.
    fn arrived(&mut self, state: &State, stamp_ns: u64) -> Result<u64, End> {
        let first = self.tally.summary.cycles == 0;
        let gap = self.tally.arrived(state.seq, stamp_ns)?;
        if let Some(deadline_ns) = self.backend.deadline_ns() {
            self.tally.woke(stamp_ns.saturating_sub(deadline_ns));
            self.tally.due(deadline_ns);
        }
        if first {
            // The arm's own desired position, unless it is too far from the measured one.
            let agrees = |j: usize| (state.q_d[j] - state.q[j]).abs() <= self.tracking[j];
            self.motion.start(if (0..self.joints.min(MAX_JOINTS)).all(agrees) { state.q_d } else { state.q });
            self.guard.start(self.motion.sample().q);
        }
        Ok(gap)
    }

    fn advance(&mut self, gap: u64) {
        match self.motion.advance(gap) {
            None => {}
            Some(Finished::Order { motion, reference }) => {
                self.retire(reference);
                self.emit(Event::Ended { motion });
            }
            Some(Finished::Brake) => {
                self.inlets.controls.wait_for_permission();
                self.emit(Event::Stopped);
            }
        }
    }

    /// Takes requests: permission, stop, one model, one order.
    fn listen(&mut self, gap: u64) -> Result<(), End> {
        if let Some(reference) = self.leaving.take() {
            self.retire(Some(reference));
        }
        self.torque.hand_out(&mut self.inlets.retired);
        // The stop is read before the permission. Otherwise a stop that follows a permission could meet an arm that still waits for that
        // permission: it would count as carried out, and the arm would continue.
        let stop = self.inlets.controls.take_stop();
        let permission = self.inlets.controls.permission();
        if self.motion.is_stopped() && permission != self.permission {
            self.permission = permission;
            self.motion.resume();
            self.emit(Event::Resumed);
        }
        let lost = gap.saturating_sub(1);
        // At rest the arm holds: without a reference that it could miss, there is nothing to stop.
        if lost > self.max_lost && !self.motion.is_holding() {
            self.brake(StopReason::LostStates { lost }, gap)?;
        }
        self.check_heartbeat(gap)?;
        if stop {
            self.brake(StopReason::Requested, gap)?;
        }
        if self.inlets.controls.wants_quit() {
            return if self.motion.is_holding() { Ok(()) } else { self.brake(StopReason::Quit, gap) };
        }
        self.take_model();
        self.take_order(gap)
    }

    /// Brakes a moving arm when the supervisor's heartbeat has timed out. At rest the arm holds.
    fn check_heartbeat(&mut self, gap: u64) -> Result<(), End> {
        let heartbeats = self.inlets.controls.heartbeats();
        let cycles = if heartbeats == self.last_heartbeat.0 { self.last_heartbeat.1.saturating_add(gap) } else { 0 };
        self.last_heartbeat = (heartbeats, cycles);
        match self.heartbeat_timeout {
            Some(most) if cycles > most && !self.motion.is_holding() => {
                self.brake(StopReason::HeartbeatLost { cycles }, gap)
            }
            _ => Ok(()),
        }
    }

    /// Takes over a model between two cycles. The replaced model is pushed to the ring, so nothing is freed here.
    fn take_model(&mut self) {
        if self.leaving.is_some() || !self.torque.has_room(&self.inlets.retired) {
            return;
        }
        if let Ok(model) = self.inlets.models.pop() {
            let id = model.id();
            self.torque.serve(model, &mut self.inlets.retired);
            self.emit(Event::Serving { model: id });
        }
    }

    /// Begins the next order when the present one has ended; discards one that was given before a stop was resumed.
    fn take_order(&mut self, gap: u64) -> Result<(), End> {
        let Ok(waiting) = self.inlets.orders.peek() else { return Ok(()) };
        let outdated = waiting.permission != self.permission || self.motion.is_stopping();
        // An order under a newer permission waits until the loop has seen that permission itself.
        let early = waiting.permission.wrapping_sub(self.permission).cast_signed() > 0;
        if early || !(outdated || self.motion.is_holding()) || !self.can_retire() {
            return Ok(());
        }
        let Ok(permitted) = self.inlets.orders.pop() else { return Ok(()) };
        self.orders = self.orders.wrapping_add(1);
        if outdated {
            self.discard(permitted.order);
            return Ok(());
        }
        let motion = permitted.order.motion;
        let aim = match &permitted.order.kind {
            OrderKind::MoveTo { target, .. } => self.guard.check_target(target).map_err(StopReason::Guard),
            OrderKind::Follow(_) | OrderKind::Dwell { .. } => Ok(()),
        };
        // Begun in either case, so that events and records name the order that the stop belongs to.
        match aim.and(self.motion.begin(permitted.order)) {
            Ok(()) => {
                self.emit(Event::Started { motion });
                Ok(())
            }
            Err(reason) => self.brake(reason, gap),
        }
    }

    fn discard(&mut self, order: Order) {
        self.tally.summary.discarded_orders += 1;
        self.emit(Event::Discarded { motion: order.motion });
        if let OrderKind::Follow(reference) = order.kind {
            self.retire(Some(reference));
        }
    }

    /// Controlled stop from the setpoint sent last; no effect during a stop.
    fn brake(&mut self, reason: StopReason, gap: u64) -> Result<(), End> {
        if self.motion.is_stopping() {
            return Ok(());
        }
        self.stops = self.stops.saturating_add(1);
        self.last_stop = Some(reason);
        self.emit(Event::Stopping { motion: self.motion.number(), reason });
        if let StopReason::Guard(violation) = reason {
            self.distrust(violation);
        }
        let reference = self.motion.brake(gap).map_err(|_| End::NoBrake)?;
        self.retire(reference);
        Ok(())
    }

    /// Rejects the serving model where its torque is the `violation`; whether it did.
    fn distrust(&mut self, violation: Violation) -> bool {
        if !violation.is_of_model() {
            return false;
        }
        let Some((model, instead)) = self.torque.fall_back() else { return false };
        self.emit(Event::Distrusted { model, instead });
        true
    }

    /// The present sample of the motion with its torque.
    fn answer(&mut self, seq: u64) -> Next {
        let desired = self.motion.sample();
        let answer = self.torque.answer(&desired, self.motion.is_stopping());
        let Torques { tau_ff, tau_vendor } = answer.served;
        (Command { seq, desired, tau_ff, tau_vendor }, answer)
    }

    fn record(&mut self, state: State, command: Command, validity: Validity, stamp_ns: u64) {
        let record = Record {
            cycle: self.tally.summary.cycles.saturating_sub(1),
            state,
            command,
            phase: self.motion.phase(),
            motion: self.motion.number(),
            tick: self.motion.tick(),
            model: self.torque.id(),
            validity,
            stamp_ns,
            wake_ns: self.backend.deadline_ns().map_or(0, |deadline_ns| stamp_ns.saturating_sub(deadline_ns)),
            work_ns: self.work_ns,
        };
        self.work_ns = now_ns().saturating_sub(stamp_ns);
        self.tally.worked(self.work_ns);
        self.flight.keep(&record);
        if !self.sink.put(&record) {
            self.tally.summary.dropped_records += 1;
        }
        let LoopStatistics { cycles, lost, dropped_records, .. } = self.tally.summary;
        self.inlets.controls.show(record.phase, cycles, lost, self.tally.late(), dropped_records);
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn can_retire(&self) -> bool {
        self.leaving.is_none() && self.inlets.retired.slots() > 1
    }

    /// Pushes a box to the ring, to be freed outside. With a full ring the box waits in `leaving`.
    fn retire(&mut self, reference: Option<Box<dyn Reference>>) {
        let Some(reference) = reference else { return };
        if let Err(rtrb::PushError::Full(Retired::Reference(reference))) =
            self.inlets.retired.push(Retired::Reference(reference))
        {
            self.leaving = Some(reference);
        }
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn emit(&mut self, event: Event) {
        let cycle = self.tally.summary.cycles.saturating_sub(1);
        let timed = TimedEvent { cycle, seq: self.tally.last(), stamp_ns: self.stamp_ns, orders: self.orders, event };
        if self.inlets.events.push(timed).is_err() {
            self.tally.summary.dropped_events += 1;
        }
    }
}

/// Stops the arm however the loop's thread ends, by a panic in a model, too.
impl<B: Backend, S: Sink> Drop for Cycle<B, S> {
    fn drop(&mut self) {
        self.backend.stop();
    }
}

/// Whether the program's allocator counts: allocates once under watch, and takes the count back.
fn allocations_are_watched() -> bool {
    let before = violation_count();
    assert_no_alloc(|| {
        drop(std::hint::black_box(Box::new(before)));
        let watched = violation_count() != before;
        // Taken back in here, because a count that has grown is reported on leaving.
        reset_violation_count();
        watched
    })
}

#[cfg(test)]
mod tests;

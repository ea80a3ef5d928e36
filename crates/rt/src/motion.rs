//! The present motion. Every mode is a source of setpoints, so the loop has no modes.

use super::checkpoint;
use super::moves::{NoMotion, Planner, seconds};
use super::order::{Order, OrderKind, StopReason};
use plumbline_core::{JointVec, MAX_JOINTS, MAX_MISSED_COMMANDS, Phase, Record, Reference, Setpoint};

/// Largest distance of a reference's start from the arm's rest position; more would be a step \[rad\].
const START_TOLERANCE: f64 = 1e-6;

enum Doing {
    Hold,
    Move { phase: Phase },
    Follow { reference: Box<dyn Reference>, last_tick: u64 },
    Dwell { ticks: u64 },
    Brake,
    Stopped,
}

impl Doing {
    /// The number of samples is read once, not in every cycle.
    fn follow(reference: Box<dyn Reference>) -> Doing {
        let last_tick = reference.ticks().saturating_sub(1);
        Doing::Follow { reference, last_tick }
    }
}

/// The end of a motion, noticed in the first cycle after its last sample.
pub(super) enum Finished {
    /// An order has ended; its reference, if any, is no longer used.
    Order { motion: u32, reference: Option<Box<dyn Reference>> },
    /// The brake has brought the arm to rest.
    Brake,
}

/// The present motion and its sample number.
pub(super) struct Motion {
    joints: usize,
    planner: Planner,
    doing: Doing,
    number: u32,
    tick: u64,
    /// The setpoint sent last.
    last: Setpoint,
}

impl Motion {
    /// Holds at zero until [`start`](Motion::start).
    pub fn new(joints: usize, planner: Planner) -> Motion {
        let joints = joints.min(MAX_JOINTS);
        Motion { joints, planner, doing: Doing::Hold, number: 0, tick: 0, last: Setpoint::default() }
    }

    /// Holds at `q`; entries past the arm's joints are dropped.
    pub fn start(&mut self, q: JointVec) {
        self.last = self.only_own_joints(Setpoint { q, ..Setpoint::default() });
        self.doing = Doing::Hold;
    }

    /// Continues `doing` after `last`.
    pub fn restore(&mut self, doing: checkpoint::Doing, last: &Record) -> Result<(), NoMotion> {
        (self.number, self.tick, self.last) = (last.motion, last.tick, last.command.desired);
        self.doing = match doing {
            checkpoint::Doing::Hold => Doing::Hold,
            checkpoint::Doing::Move { phase, from, target } => {
                self.planner.move_to(&from, &target)?;
                Doing::Move { phase }
            }
            checkpoint::Doing::Follow(reference) => Doing::follow(reference),
            checkpoint::Doing::Dwell { ticks } => Doing::Dwell { ticks },
            checkpoint::Doing::Brake { from } => {
                self.planner.stop(&from)?;
                Doing::Brake
            }
            checkpoint::Doing::Stopped => Doing::Stopped,
        };
        Ok(())
    }

    /// Moves on by `gap` cycles of the arm. A motion whose last sample has been sent ends here.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn advance(&mut self, gap: u64) -> Option<Finished> {
        if self.is_moving() && self.tick >= self.last_tick() {
            return Some(match std::mem::replace(&mut self.doing, Doing::Hold) {
                Doing::Brake => {
                    self.doing = Doing::Stopped;
                    Finished::Brake
                }
                Doing::Follow { reference, .. } => Finished::Order { motion: self.number, reference: Some(reference) },
                _ => Finished::Order { motion: self.number, reference: None },
            });
        }
        if self.is_moving() {
            self.tick = self.tick.saturating_add(gap);
        }
        None
    }

    /// Begins an order from the present rest. On an error the order's reference is kept as the present motion, so that
    /// [`brake`](Motion::brake) hands it back.
    pub fn begin(&mut self, order: Order) -> Result<(), StopReason> {
        let motion = order.motion;
        (self.number, self.tick) = (motion, 0);
        match order.kind {
            OrderKind::MoveTo { target, phase } => {
                self.planner.move_to(&self.last, &target).map_err(|NoMotion| StopReason::NoPath { motion })?;
                self.doing = Doing::Move { phase };
            }
            OrderKind::Dwell { ticks } => self.doing = Doing::Dwell { ticks },
            OrderKind::Follow(reference) => {
                let first = reference.at(0).q;
                self.doing = Doing::follow(reference);
                for (joint, (first, last)) in first.iter().zip(&self.last.q).enumerate().take(self.joints) {
                    let distance = first - last;
                    if distance.is_nan() || distance.abs() > START_TOLERANCE {
                        return Err(StopReason::NotAtStart { motion, joint, distance });
                    }
                }
            }
        }
        Ok(())
    }

    /// Brakes from the setpoint sent last, `gap` cycles of the arm ago. Returns the reference under way, which is no longer used.
    ///
    /// For lost states the arm has extrapolated at constant acceleration, as the FCI does. The stop begins at the extrapolated setpoint;
    /// otherwise its first sample would be a jump. Where no stop can begin there, it begins at the setpoint sent last, at that time.
    pub fn brake(&mut self, gap: u64) -> Result<Option<Box<dyn Reference>>, NoMotion> {
        let missed = gap.saturating_sub(1).min(u64::from(MAX_MISSED_COMMANDS));
        let planned = match self.planner.stop(&extrapolate(&self.last, seconds(missed))) {
            Ok(()) => {
                self.tick = gap - missed;
                Ok(())
            }
            Err(NoMotion) => {
                self.tick = gap;
                self.planner.stop(&self.last)
            }
        };
        let reference = match std::mem::replace(&mut self.doing, Doing::Brake) {
            Doing::Follow { reference, .. } => Some(reference),
            _ => None,
        };
        planned.map(|()| reference)
    }

    /// Allows orders again after a stop.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn resume(&mut self) {
        if matches!(self.doing, Doing::Stopped) {
            self.doing = Doing::Hold;
        }
    }

    /// The setpoint of this cycle.
    pub fn sample(&mut self) -> Setpoint {
        let sample = match &self.doing {
            Doing::Hold | Doing::Dwell { .. } | Doing::Stopped => Setpoint { q: self.last.q, ..Setpoint::default() },
            Doing::Move { .. } | Doing::Brake => self.planner.at(self.tick),
            Doing::Follow { reference, last_tick } => reference.at(self.tick.min(*last_tick)),
        };
        self.only_own_joints(sample)
    }

    /// Stores the sent setpoint.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn sent(&mut self, desired: &Setpoint) {
        self.last = *desired;
    }

    /// Phase in the records of this cycle.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn phase(&self) -> Phase {
        match &self.doing {
            Doing::Hold | Doing::Dwell { .. } => Phase::Hold,
            Doing::Move { phase } => *phase,
            Doing::Follow { .. } => Phase::Excite,
            Doing::Brake => Phase::Stop,
            Doing::Stopped => Phase::Stopped,
        }
    }

    /// Number of the present or last order, 0 before the first.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Sample of the present motion; in the rest after it, the last one.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Ready for the next order.
    pub fn is_holding(&self) -> bool {
        matches!(self.doing, Doing::Hold)
    }

    /// At rest after a stop, waiting for permission.
    pub fn is_stopped(&self) -> bool {
        matches!(self.doing, Doing::Stopped)
    }

    /// Braking, or at rest after it.
    pub fn is_stopping(&self) -> bool {
        matches!(self.doing, Doing::Brake | Doing::Stopped)
    }

    fn is_moving(&self) -> bool {
        !matches!(self.doing, Doing::Hold | Doing::Stopped)
    }

    fn last_tick(&self) -> u64 {
        match &self.doing {
            Doing::Hold | Doing::Stopped => 0,
            Doing::Move { .. } | Doing::Brake => self.planner.last_tick(),
            Doing::Follow { last_tick, .. } => *last_tick,
            Doing::Dwell { ticks } => ticks.saturating_sub(1),
        }
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn only_own_joints(&self, mut setpoint: Setpoint) -> Setpoint {
        for values in [&mut setpoint.q, &mut setpoint.dq, &mut setpoint.ddq] {
            values.iter_mut().skip(self.joints).for_each(|value| *value = 0.0);
        }
        setpoint
    }
}

/// The setpoint that a stop began from whose first sample was number `tick`, `gap` cycles of the arm after `last` had been sent.
pub fn braked_from(last: &Setpoint, gap: u64, tick: u64) -> Setpoint {
    let missed = gap.saturating_sub(1).min(u64::from(MAX_MISSED_COMMANDS));
    if tick.saturating_add(missed) == gap { extrapolate(last, seconds(missed)) } else { *last }
}

/// Where a setpoint leads at constant acceleration in `t` seconds.
#[cfg_attr(no_panic, no_panic::no_panic)]
fn extrapolate(from: &Setpoint, t: f64) -> Setpoint {
    let mut to = *from;
    for j in 0..MAX_JOINTS {
        to.q[j] += t * (from.dq[j] + 0.5 * t * from.ddq[j]);
        to.dq[j] += t * from.ddq[j];
    }
    to
}

#[cfg(test)]
mod tests {
    use super::super::moves::MoveFactors;
    use super::*;
    use plumbline_core::Limits;
    use plumbline_core::PERIOD_S;

    fn planner() -> Planner {
        let of = |value: f64| [value; MAX_JOINTS];
        let limits = Limits {
            q_min: of(-3.0),
            q_max: of(3.0),
            dq: of(2.0),
            ddq: of(10.0),
            jerk: of(5000.0),
            tau: of(80.0),
            dtau: of(1000.0),
        };
        Planner::new(2, limits, MoveFactors::default())
    }

    #[test]
    fn a_stop_begins_at_the_extrapolated_setpoint() {
        let sent = Setpoint {
            q: [0.1, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            dq: [0.5, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            ddq: [4.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        };
        // Cycles since the last command, cycles that the arm extrapolated, and the sample of the stop that is due.
        for (gap, missed, tick) in [(1, 0.0, 1), (2, 1.0, 1), (8, 7.0, 1), (21, 20.0, 1), (26, 20.0, 6)] {
            let t = missed * PERIOD_S;
            let mut from = sent;
            for j in 0..2 {
                from.q[j] = sent.q[j] + sent.dq[j] * t + sent.ddq[j] * t * t / 2.0;
                from.dq[j] = sent.dq[j] + sent.ddq[j] * t;
            }
            let mut expected = planner();
            expected.stop(&from).unwrap();
            let mut motion = Motion::new(2, planner());
            motion.start(sent.q);
            motion.sent(&sent);
            assert!(motion.brake(gap).unwrap().is_none());
            assert_eq!(motion.tick(), tick);
            let (found, expected) = (motion.sample(), expected.at(tick));
            // What a replay takes for the setpoint that this stop began at.
            let began = braked_from(&sent, gap, tick);
            for j in 0..2 {
                let pairs = [
                    (found.q[j], expected.q[j]),
                    (found.dq[j], expected.dq[j]),
                    (found.ddq[j], expected.ddq[j]),
                    (began.q[j], from.q[j]),
                    (began.dq[j], from.dq[j]),
                    (began.ddq[j], from.ddq[j]),
                ];
                assert!(pairs.iter().all(|(found, expected)| (found - expected).abs() < 1e-12), "{gap}: {pairs:?}");
            }
            // Where no stop began there, it began at what was sent, as if it had begun then.
            if gap > 1 {
                assert_eq!(braked_from(&sent, gap, gap), sent);
            }
        }
    }
}

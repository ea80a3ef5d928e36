//! The orders of a session: decides from events what the loop is ordered next, without acting.

use crate::recording::about::{APPROACH, RETURN, RecordedOrder, Series};
use crate::setup::programme::{self, Role, Stage};
use plumbline_core::{JointVec, MAX_JOINTS, Phase};
use plumbline_excite::{ExciteError, Fourier, PeriodicMotion};
use plumbline_rt::{Event, Order, OrderKind};
use std::collections::VecDeque;

/// Rest before a motion starts \[ms\].
const SETTLE: u64 = 500;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    Continue,
    /// Hold until there is a model, then give the orders that are left.
    AwaitModel,
    /// The stage is over and the arm is back where it started.
    Over,
    /// The arm was stopped; nothing more is driven.
    Aborted,
}

/// An order, and the same as data.
pub struct Planned {
    pub order: Order,
    pub given: RecordedOrder,
}

impl Planned {
    fn move_to(motion: u32, target: JointVec, phase: Phase) -> Planned {
        let given = RecordedOrder::Move { motion, target, phase: phase as u32 };
        Planned { order: Order { motion, kind: OrderKind::MoveTo { target, phase } }, given }
    }

    fn dwell(motion: u32, ticks: u64) -> Planned {
        Planned {
            order: Order { motion, kind: OrderKind::Dwell { ticks } },
            given: RecordedOrder::Dwell { motion, ticks },
        }
    }

    fn follow(motion: u32, fourier: &Fourier, periods: u32) -> Result<Planned, ExciteError> {
        let rows = |of: &nalgebra::DMatrix<f64>| of.row_iter().map(|row| row.iter().copied().collect()).collect();
        let (a, b) = (rows(&fourier.a), rows(&fourier.b));
        let series = Series { period: fourier.period, periods, q0: fourier.q0.clone(), a, b };
        let reference = Box::new(PeriodicMotion::new(fourier, periods)?);
        let order = Order { motion, kind: OrderKind::Follow(reference) };
        Ok(Planned { order, given: RecordedOrder::Follow { motion, series } })
    }
}

pub struct Script {
    /// Orders up to and with the motion after which the model is needed; all of them where none is.
    before: VecDeque<Planned>,
    after: VecDeque<Planned>,
    barrier: Option<u32>,
    /// The last motion that is driven without a model.
    idle_after: Option<u32>,
}

impl Script {
    /// Nothing to drive: the loop holds.
    pub fn hold() -> Script {
        Script { before: VecDeque::new(), after: VecDeque::new(), barrier: None, idle_after: None }
    }

    /// Approach, settle and drive every motion of the stage that is not among the `done`, then return to `rest`.
    pub fn of(stage: &Stage, rest: JointVec, done: &[u32]) -> Result<Script, ExciteError> {
        let mut script = Script::hold();
        for motion in &stage.motions {
            if done.contains(&motion.number) {
                // What comes after it still waits for the model.
                if motion.role == Role::Identify {
                    script.barrier = Some(motion.number);
                }
                continue;
            }
            // A motion that another program drives needs no order.
            let Some(planned) = motion.planned() else { continue };
            let target = start_of(planned);
            let approach = motion.number + APPROACH;
            let periods = (planned.periods + planned.lead_in) as u32;
            script.push(Planned::move_to(approach, target, Phase::Approach));
            script.push(Planned::dwell(approach, SETTLE));
            script.push(Planned::follow(motion.number, &planned.fourier, periods)?);
            if motion.role == Role::Identify {
                script.barrier = Some(motion.number);
                script.idle_after.get_or_insert(motion.number);
            }
        }
        script.push(Planned::move_to(RETURN, rest, Phase::Return));
        Ok(script)
    }

    fn push(&mut self, order: Planned) {
        let queue = if self.barrier.is_some() { &mut self.after } else { &mut self.before };
        queue.push_back(order);
    }

    /// The next order that may be given now.
    pub fn next(&mut self, model: bool) -> Option<Planned> {
        self.before.pop_front().or_else(|| if model { self.after.pop_front() } else { None })
    }

    /// Whether the only orders left are those that need the model.
    pub fn awaits_model(&self) -> bool {
        self.before.is_empty() && !self.after.is_empty()
    }

    /// Whether the loop has nothing left to drive after `event`, until there is a model.
    pub fn is_idle_after(&self, event: &Event) -> bool {
        matches!(*event, Event::Ended { motion } if Some(motion) == self.idle_after) && self.awaits_model()
    }

    /// A rest of so many cycles before the next motion; `None` where the way back comes next, whose end is that of the stage.
    pub fn rest(&self, ticks: u64) -> Option<Planned> {
        let next = self.after.front().map(|next| next.order.motion).filter(|motion| *motion != RETURN)?;
        Some(Planned::dwell(next, ticks))
    }

    pub fn first_target(&self) -> Option<JointVec> {
        self.before.iter().chain(&self.after).find_map(|planned| match planned.order.kind {
            OrderKind::MoveTo { target, .. } => Some(target),
            _ => None,
        })
    }

    pub fn after(&mut self, event: &Event) -> Next {
        match *event {
            Event::Ended { motion: RETURN } => Next::Over,
            Event::Ended { motion } if Some(motion) == self.barrier => Next::AwaitModel,
            Event::Stopping { .. } => {
                *self = Script::hold();
                Next::Aborted
            }
            _ => Next::Continue,
        }
    }
}

fn start_of(motion: &programme::Planned) -> JointVec {
    let mut start = [0.0; MAX_JOINTS];
    for (slot, &q) in start.iter_mut().zip(&motion.plan.q0) {
        *slot = q;
    }
    start
}

//! The arm that a job drives, connected.

use super::desk::Desk;
use super::session::RING;
use crate::app::Failure;
use crate::backend::Clock;
use crate::backend::sim::{Gate, Pace, SimArm};
use crate::model::gravity::Mounting;
use crate::rt::{Backend, os};
use std::sync::Arc;

/// `CLOCK_MONOTONIC` for arms that keep wall-clock time.
struct Monotonic;

impl Clock for Monotonic {
    fn now_ns(&self) -> u64 {
        os::now_ns()
    }

    fn sleep_until(&self, deadline_ns: u64) {
        os::sleep_until(deadline_ns);
    }
}

/// A connected arm.
pub struct Connected {
    /// The arm itself.
    pub arm: Box<dyn Backend>,
    /// Back-pressure of an arm that runs as fast as it can.
    pub gate: Option<Arc<Gate>>,
}

/// Connects to the arm of a job, mounted as given.
pub fn connect(desk: &Desk, mounting: Mounting) -> Result<Connected, Failure> {
    let Desk { job, robot, .. } = desk;
    let truth = desk.truth.as_ref().ok_or_else(|| Failure::job("there is no simulated arm to drive"))?;
    let gate = job.backend.is_fast().then(|| Arc::new(Gate::new(RING as u64 / 2)));
    let pace = gate.clone().map_or_else(|| Pace::WallClock(Box::new(Monotonic)), Pace::Fast);
    let arm = SimArm::new(&robot.chain, truth, mounting, desk.rest, job.backend.seed, pace).map_err(Failure::job)?;
    Ok(Connected { arm: Box::new(arm), gate })
}

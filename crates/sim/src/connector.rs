//! The simulated arm as a backend of the daemon.

use crate::{Gate, Pace, SimArm, Truth};
use plumbline_core::{
    ArmConnector, ArmError, Clock, ConnectOptions, Connected, JointVec, MAX_MISSED_COMMANDS, Purpose, TimeGate,
};
use plumbline_model::Chain;
use std::sync::Arc;

/// Missing commands after which a monitored arm stops: those of a minute.
const MONITOR_MISSED_COMMANDS: u32 = 60_000;

/// Connects to a simulated arm: each connection is a new arm at rest in `start`.
pub struct SimConnector {
    /// Kinematics.
    pub chain: Chain,
    /// Masses, friction, sensors and effects.
    pub truth: Truth,
    /// Position at connection \[rad\].
    pub start: JointVec,
    /// Seed of noise and losses.
    pub seed: u64,
    /// Makes the clock of an arm in wall-clock time; `None` runs simulated time as fast as the records are consumed.
    pub clock: Option<fn() -> Box<dyn Clock>>,
    /// Missing commands in a row that a driven arm tolerates, at least as many as a Franka.
    pub max_missed: u32,
}

impl ArmConnector for SimConnector {
    fn connect(&self, options: &ConnectOptions) -> Result<Connected, ArmError> {
        let (pace, gate) = match self.clock {
            Some(clock) => (Pace::WallClock(clock()), None),
            None => {
                let gate = Arc::new(Gate::new(options.max_ahead));
                (Pace::Fast(Arc::clone(&gate)), Some(gate as Arc<dyn TimeGate>))
            }
        };
        let arm = SimArm::under(&self.chain, &self.truth, options.gravity.into(), self.start, self.seed, pace)?;
        let arm = arm.with_max_missed(match options.purpose {
            Purpose::Drive => self.max_missed.max(MAX_MISSED_COMMANDS),
            Purpose::Monitor => MONITOR_MISSED_COMMANDS,
        });
        // Its controller compensates the true gravity.
        Ok(Connected { backend: Box::new(arm), compensates: options.gravity, gate, hardware: None })
    }
}

impl TimeGate for Gate {
    fn open(&self) {
        Gate::open(self);
    }

    fn shut(&self) {
        Gate::shut(self);
    }

    fn consumed(&self, records: u64) {
        Gate::consumed(self, records);
    }

    fn under_way(&self) -> u64 {
        Gate::under_way(self)
    }
}

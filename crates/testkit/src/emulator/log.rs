//! Output of the emulator: events as text, cycles as CSV.

use plumbline_franka::wire::RobotState;
use plumbline_rt::os::now_ns;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

pub struct Log {
    start: u64,
    speaks: bool,
    cycles: Option<BufWriter<File>>,
}

impl Log {
    /// Events go to standard error where it `speaks`; cycles to a CSV file where one is given.
    ///
    /// # Errors
    /// The file can't be created.
    pub fn new(speaks: bool, cycles: Option<&Path>) -> std::io::Result<Log> {
        let mut cycles = cycles.map(File::create).transpose()?.map(BufWriter::new);
        if let Some(file) = &mut cycles {
            let joints = |name: &'static str| (1..=7).map(move |j| format!(",{name}{j}"));
            let columns: String = ["q_d", "dq_d", "q", "dq", "tau_J"].into_iter().flat_map(joints).collect();
            writeln!(file, "message_id,robot_mode,errors,reflex_reason,success_rate{columns}")?;
        }
        Ok(Log { start: now_ns(), speaks, cycles })
    }

    /// One event, with the time since the emulator's start.
    pub fn event(&self, text: &str) {
        if self.speaks {
            eprintln!("{:10.3} {text}", (now_ns() - self.start) as f64 * 1e-9);
        }
    }

    /// One millisecond; errors as masks, bit i for error i.
    pub fn cycle(&mut self, state: &RobotState) {
        let Some(file) = &mut self.cycles else { return };
        let numbers: String = [&state.q_d, &state.dq_d, &state.q, &state.dq, &state.tau_j]
            .into_iter()
            .flatten()
            .map(|value| format!(",{value}"))
            .collect();
        let head = (state.message_id, state.robot_mode.code(), state.errors.bits(), state.reflex_reason.bits());
        let rate = state.control_command_success_rate;
        // A full disk ends the log, not the robot.
        if writeln!(file, "{},{},{},{},{rate}{numbers}", head.0, head.1, head.2, head.3).is_err() {
            self.cycles = None;
        }
    }
}

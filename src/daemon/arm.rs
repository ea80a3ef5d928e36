//! The arm that a job drives, connected.

use super::Daemon;
use super::desk::Desk;
use super::session::RING;
use crate::config::job::franka::Recovery;
use crate::failure::Failure;
use nalgebra::Vector3;
use plumbline_core::{Backend, Clock, Fault, JointVec, LONGEST_ALONE};
use plumbline_franka::{Info, Telemetry};
use plumbline_identify::Side;
use plumbline_ipc::Link;
use plumbline_model::Mounting;
use plumbline_rt::cycle::End;
use plumbline_rt::os;
use plumbline_sim::{Gate, Pace, SimArm};
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

/// What an arm is connected for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To be there: a robot with a controller of its own is only watched, and stands by its own means.
    Hold,
    /// To move.
    Drive,
}

/// Missing commands that end the standing of a simulated arm: those of a minute.
const STANDING: u32 = 60_000;

/// A connected arm.
pub struct Connected {
    /// The arm itself.
    pub arm: Box<dyn Backend>,
    /// Back-pressure of an arm that runs as fast as it can.
    pub gate: Option<Arc<Gate>>,
    /// The robot at the other end of a network.
    pub robot: Option<Robot>,
    /// Gravity in the base frame that the arm's own controller compensates \[m/s2\]: the robot's; of a simulated arm, that of its mounting.
    pub vendor: Vector3<f64>,
}

/// A robot at the other end of a network.
pub struct Robot {
    info: Info,
    telemetry: Arc<Telemetry>,
    /// The mode that was spoken of last.
    mode: plumbline_franka::wire::RobotMode,
}

/// Connects to the arm of a job, mounted as given.
pub fn connect(daemon: &mut Daemon, mounting: Mounting, purpose: Purpose) -> Result<Connected, Failure> {
    let Desk { job, robot, .. } = &daemon.desk;
    if let Some(franka) = &job.backend.franka {
        let purpose = match purpose {
            Purpose::Hold => plumbline_franka::Purpose::Watch,
            Purpose::Drive => plumbline_franka::Purpose::Drive,
        };
        let settings = franka.settings(job, purpose)?;
        let connected = daemon.meanwhile(|| plumbline_franka::connect(&settings))?;
        let (arm, plumbline_franka::Connection { info, telemetry }) = connected.map_err(Failure::job)?;
        tracing::info!("connected to {}", words(&info));
        let vendor = Vector3::from(info.compensates);
        return Ok(Connected { arm: Box::new(arm), gate: None, robot: Some(Robot::new(info, telemetry)), vendor });
    }
    let truth = daemon.desk.truth.as_ref().ok_or_else(|| Failure::job("there is no simulated arm to drive"))?;
    let gate = job.backend.is_fast().then(|| Arc::new(Gate::new(RING as u64 / 2)));
    let pace = gate.clone().map_or_else(|| Pace::WallClock(Box::new(Monotonic)), Pace::Fast);
    let arm =
        SimArm::new(&robot.chain, truth, mounting, daemon.desk.rest, job.backend.seed, pace).map_err(Failure::job)?;
    // As patient as a Franka, or as the job where that allows more. An arm that only stands needs no commands: it is left alone for a minute.
    let arm = arm.with_patience(match purpose {
        Purpose::Drive => job.safety.max_lost.max(LONGEST_ALONE),
        Purpose::Hold => STANDING,
    });
    Ok(Connected { arm: Box::new(arm), gate, robot: None, vendor: mounting.gravity() })
}

impl Robot {
    fn new(info: Info, telemetry: Arc<Telemetry>) -> Robot {
        Robot { info, telemetry, mode: plumbline_franka::wire::RobotMode::Idle }
    }

    /// Says it when somebody or something has changed the mode of an arm that is only watched: nothing else would.
    pub fn watch(&mut self) {
        self.speak_of(self.telemetry.newest_mode());
    }

    fn speak_of(&mut self, mode: plumbline_franka::wire::RobotMode) {
        if std::mem::replace(&mut self.mode, mode) == mode {
            return;
        }
        match plumbline_franka::next_step(mode) {
            Some(next) => tracing::warn!("the arm's mode is now `{mode}`, no motion can start. {next}"),
            None => tracing::info!("the arm's mode is now `{mode}`"),
        }
    }

    /// The limits that the arm and its adapter hold commands to.
    pub fn limits(&self) -> &plumbline_franka::RobotLimits {
        &self.info.limits
    }

    /// Where the arm stood when it was connected \[rad\].
    pub fn pose(&self) -> JointVec {
        self.info.pose()
    }

    /// Direction of gravity in the base frame that the robot's sensors show, or its own constant without any; a unit vector.
    pub fn gravity(&self) -> Option<[f64; 3]> {
        self.info.gravity.as_ref().map(|gravity| gravity.direction)
    }

    /// What the arm's own accelerometers say of gravity, as one side of the mounting check; the constant that the robot believes in is
    /// none.
    pub fn side(&self) -> Option<Side> {
        let gravity =
            self.info.gravity.as_ref().filter(|gravity| gravity.source == plumbline_franka::Source::Accelerometers)?;
        Some(Side {
            name: "the robot's accelerometers",
            gravity: gravity.direction.into(),
            std: gravity.spread.max(gravity.accelerometers.unwrap_or(0.0)),
        })
    }

    /// What an operator does after `fault`.
    pub fn next_step(&self, fault: &Fault) -> String {
        plumbline_franka::explain(fault, &self.telemetry.snapshot()).next.to_string()
    }

    /// What the session says of its network; `fault` ended it.
    pub fn link(&self, fault: Option<&Fault>) -> Link {
        let of = self.telemetry.snapshot();
        Link {
            robot: words(&self.info),
            states: of.states,
            lost: of.lost,
            passed_over: of.skipped,
            odd: of.out_of_order + of.duplicates + of.bad_packets + of.foreign_packets,
            late: of.late_commands,
            limited: of.limited,
            success: (of.success_rate.mean > 0.0).then_some([of.success_rate.min, of.success_rate.mean]),
            turnaround: of.work,
            wake: of.wake,
            round_trip: of.round_trip,
            interval: of.interval,
            gravity: self.gravity(),
            compensates: Some(self.info.compensates),
            fault: fault.map(|fault| plumbline_franka::explain(fault, &of).to_string()),
        }
    }
}

/// Whether the daemon may go on by itself after a loop that ended so: by the job's own rule, after lost communication alone, not more often than
/// that says, and never where somebody wanted the end or something else had stopped the arm before.
pub fn goes_on(desk: &Desk, end: &End) -> bool {
    let (Some(franka), End::Fault(fault)) = (&desk.job.backend.franka, end) else { return false };
    let lost_communication = match fault {
        Fault::Reflex { code } => *code == plumbline_franka::wire::ErrorBit::CommunicationConstraintsViolation as u32,
        Fault::Silent { .. } | Fault::Disconnected => true,
        Fault::Refused { .. } => false,
    };
    let again = franka.recovery == Recovery::Automatic && desk.recoveries < franka.max_recoveries;
    !desk.is_over() && again && lost_communication
}

/// Lets a robot that stopped by itself move again. Only where [`goes_on`] says so.
pub fn recover(daemon: &mut Daemon) -> Result<(), Failure> {
    let job = &daemon.desk.job;
    let Some(franka) = &job.backend.franka else { return Ok(()) };
    let settings = franka.settings(job, plumbline_franka::Purpose::Watch)?;
    daemon.meanwhile(|| plumbline_franka::recover_communication(&settings))?.map_err(Failure::job)
}

fn words(info: &Info) -> String {
    format!("{}, protocol {}", info.image, info.protocol.number())
}

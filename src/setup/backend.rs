//! The backends that a job can name, each by one line of [`connector`].

use crate::config::job::{BackendKind, Job};
use crate::failure::Failure;
use plumbline_core::{ArmConnector, ArmError, Clock, ConnectOptions, Connected};
use plumbline_model::Robot;
use plumbline_rt::os::Monotonic;
use plumbline_sim::{SimConnector, Truth};

const ARMS: [(&str, &str); 2] = [
    ("sim-panda", include_str!("../../config/arms/sim-panda.toml")),
    ("sim-paper-2dof", include_str!("../../config/arms/sim-paper-2dof.toml")),
];

/// The arm that a job drives. Connects to nothing.
pub fn connector(job: &Job, robot: &Robot) -> Result<Box<dyn ArmConnector>, Failure> {
    let backend = &job.backend;
    Ok(match (backend.kind, &backend.franka) {
        (BackendKind::Franka, Some(franka)) => Box::new(franka.connector(job)?),
        // `check` of the job refuses one without its table.
        (BackendKind::Franka, None) => return Err(Failure::job("the job has no `backend.franka`")),
        (BackendKind::Sim, _) => Box::new(simulated(job, robot)?),
        (BackendKind::Guest, _) => Box::new(HeldElsewhere),
    })
}

/// An arm that another program holds: it is listened to (`daemon::guest`), and a connection that could command it is refused.
struct HeldElsewhere;

impl ArmConnector for HeldElsewhere {
    fn connect(&self, _options: &ConnectOptions) -> Result<Connected, ArmError> {
        Err("the job's arm is held by another program (backend.kind = \"guest\"): plumbline never commands it".into())
    }
}

fn simulated(job: &Job, robot: &Robot) -> Result<SimConnector, Failure> {
    let arm = job.backend.arm.as_ref().ok_or_else(|| Failure::job("there is no simulated arm to drive"))?;
    let (file, text) = arm.read("backend.arm", &ARMS)?;
    let wall_clock = !job.backend.is_fast();
    Ok(SimConnector {
        chain: robot.chain.clone(),
        truth: Truth::parse(&file, &text)?,
        start: super::rest(job, robot)?,
        seed: job.backend.seed,
        clock: wall_clock.then_some(monotonic),
        max_missed: job.safety.max_lost,
    })
}

fn monotonic() -> Box<dyn Clock> {
    Box::new(Monotonic)
}

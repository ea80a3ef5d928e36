//! The backends that a job can name, each by one line of [`connector`].

use crate::config::job::{BackendKind, Job};
use crate::failure::Failure;
use plumbline_core::{ArmConnector, ArmError, Clock, ConnectOptions, Connected, JointVec};
use plumbline_model::{Body, Robot};
use plumbline_rt::os::Monotonic;
use plumbline_sim::{Known, SimConnector, Truth};

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
    let (truth, start) = (Truth::parse(&file, &text)?, super::rest(job, robot)?);
    truth.check_step(&file, &robot.chain, &start, &robot.limits.q_min, &robot.limits.q_max)?;
    Ok(SimConnector {
        chain: robot.chain.clone(),
        truth,
        start,
        seed: job.backend.seed,
        clock: wall_clock.then_some(monotonic),
        max_missed: job.safety.max_lost,
    })
}

/// Text of an arm file (`backend.arm`) for a robot of which bodies, limits and maybe friction are known, and what is other than known.
pub fn simulated_arm(
    name: &str,
    robot: &Robot,
    bodies: &[Body],
    friction: &[[Option<f64>; 2]],
    start: &JointVec,
) -> (String, Option<String>) {
    let (chain, limits) = (&robot.chain, &robot.limits);
    let truth = Truth::typical(&Known { robot: name, chain, limits, bodies, friction, start });
    let lowered = friction.iter().zip(&truth.joints).enumerate().filter(|(_, ([fv, fc], joint))| {
        // Gains are rounded to three digits.
        let less = |known: &Option<f64>, now: f64| known.is_some_and(|known| now < 0.99 * known);
        less(fv, joint.fv) || less(fc, joint.fc)
    });
    let joints: Vec<String> = lowered.map(|(j, _)| (j + 1).to_string()).collect();
    let note = (!joints.is_empty()).then(|| {
        format!(
            "the URDF's friction is lowered in joints {}: with so little inertia its integration would be unstable",
            joints.join(", ")
        )
    });
    let about = "bodies of its URDF, friction of its URDF or chosen, gains with which the integration is stable";
    let said = note.iter().map(|note| format!("# {note}.\n")).collect::<String>();
    (format!("# A simulated arm for {name}: {about}.\n{said}{}", truth.text()), note)
}

fn monotonic() -> Box<dyn Clock> {
    Box::new(Monotonic)
}

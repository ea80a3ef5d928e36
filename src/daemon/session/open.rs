//! The opening of a session: connection, limits, guard, model, orders, and the start of the loop.

use super::super::Daemon;
use super::super::gravity::uncompensated;
use super::super::job_setup::JobSetup;
use super::super::labels::GravityLabels;
use super::super::schedule::RecordSchedule;
use super::super::script::Script;
use super::super::state::DaemonState;
use super::thread::{BELOW_LOOP, rights, run_to_end};
use super::{DRAIN, RING, Session};
use crate::config::job::{Job, OnRefusal};
use crate::failure::Failure;
use crate::setup::{planner, programme};
use nalgebra::Vector3;
use plumbline_core::{
    CommandMode, ConnectOptions, Connected, Hardware, Histogram, Limits, MAX_JOINTS, MeasuredGravity, Purpose,
};
use plumbline_identify::GravitySource;
use plumbline_ipc::{Progress, now_ns};
use plumbline_model::{Mounting, Reach};
use plumbline_rt::Rights;
use plumbline_rt::{CycleSettings, GuardSettings, become_realtime, cycle, recorder};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Records that the loop itself keeps: the most that the bridge thread may be behind at the end, whatever has become of the ring.
const FLIGHT: usize = 2048;
/// Time without a heartbeat after which the loop brakes an arm that moves \[ms\]: the bridge thread or the stop relay hangs.
const HEARTBEAT_TIMEOUT_MS: u64 = 1000;

impl Session {
    /// Connects to the arm in `mounting` and starts the loop. The loop requests real-time rights when the arm keeps wall-clock time.
    ///
    /// After a stop or a request to end during the connection, the loop gets no order and ends at once.
    pub fn open(
        daemon: &mut Daemon,
        name: String,
        mounting: Mounting,
        purpose: Purpose,
        script: Script,
    ) -> Result<Session, Failure> {
        let options = ConnectOptions { purpose, gravity: mounting.gravity().into(), max_ahead: RING as u64 / 2 };
        let connector = Arc::clone(&daemon.state.setup.arm);
        let connected = daemon.meanwhile(|| connector.connect(&options))?.map_err(Failure::job)?;
        let Connected { backend, compensates, gate, hardware } = connected;
        let vendor = Vector3::from(compensates);
        let state = &mut daemon.state;
        let unwanted = purpose == Purpose::Drive && state.is_over();
        let script = if unwanted { Script::hold() } else { script };
        let uncompensated =
            purpose == Purpose::Drive && state.setup.commands_torques() && uncompensated(&mounting.gravity(), &vendor);
        state.models.recent.clear();
        let own = hardware.as_ref().and_then(|hardware| hardware.accelerometers.as_ref()).map(by_accelerometers);
        state.gravity.connect(mounting, own, vendor, uncompensated);
        let settings = loop_settings(&state.setup, purpose, hardware.as_ref(), gate.is_some())?;
        if let Some(hardware) = &hardware {
            tracing::info!("connected to {}", hardware.monitor.name());
            check_hardware(&state.setup, purpose, hardware, &settings.guard.limits, &script)?;
        }
        let (sink, drain) = recorder::ring(RING);
        let reach = Box::new(Reach(state.setup.robot.chain.clone()));
        let (mut cycle, handles) = cycle::new(backend, sink, Some(reach), settings.clone()).map_err(Failure::job)?;
        // The bridge's own priority goes up before the loop starts, and stays below it.
        if gate.is_none() {
            become_realtime(&rights(&state.setup.job.realtime, BELOW_LOOP));
        }
        // From here on a stop reaches this loop directly; one that came before holds.
        daemon.stops.connect(Some(Arc::clone(&handles.controls)));
        if let Some(order) = daemon.stops.attend(Some(&handles.controls)) {
            state.take_stop(order, Some(&handles.controls));
        }
        let unwanted = purpose == Purpose::Drive && state.is_over();
        let script = if unwanted { Script::hold() } else { script };
        let tape = state.recorder.tape(&state.setup, mounting, &name, &settings, &handles.controls);
        let mut session = Session {
            name,
            mounting,
            handles,
            drain,
            gate,
            monitor: hardware.map(|hardware| hardware.monitor),
            thread: None,
            tape,
            script,
            purpose,
            model: 0,
            rights_reported: false,
            records_due: RecordSchedule::default(),
            gravity: mounting.gravity(),
            vendor,
            labels: GravityLabels::new(mounting.gravity()),
            events: VecDeque::new(),
            paused: false,
            newest: 0,
            parked: None,
            model_due_ns: None,
            bridged: Histogram::default(),
            records: Vec::with_capacity(DRAIN),
        };
        // The connection took its time: the model is handed over for the inclinometer's present reading.
        state.poll_gravity(now_ns(), false);
        // The model and the first orders are there before the first cycle, so that a seed gives the same motion every time.
        session.hand_over_model(state);
        let held_by_model =
            session.model != 0 && state.setup.arm.command_mode() == CommandMode::Torque { feed_forward: true };
        if uncompensated && !unwanted && !held_by_model {
            return Err(Failure::job(falls(&vendor, state)));
        }
        // A programme that was interrupted after its identification motions.
        let awaits_model = session.needs_model(state) && session.script.awaits_model();
        session.give_orders(state);
        if unwanted {
            session.handles.controls.quit();
        } else if awaits_model {
            state.programme.progress = Progress::AwaitingModel;
            session.shut_gate();
        }
        let thread = std::thread::Builder::new().name("plumbline-loop".into());
        session.thread = Some(thread.spawn(move || run_to_end(&mut cycle)).map_err(Failure::job)?);
        Ok(session)
    }
}

/// Settings of the loop. A physical arm that is only monitored is sent nothing: it may be outside the job's limits, and be guided by hand.
fn loop_settings(
    setup: &JobSetup,
    purpose: Purpose,
    hardware: Option<&Hardware>,
    simulated_time: bool,
) -> Result<CycleSettings, Failure> {
    let JobSetup { job, robot, names, .. } = setup;
    let (limits, envelope) = planner::held_to(job, robot, hardware.map(|hardware| &hardware.limits))?;
    let monitored = purpose == Purpose::Monitor && hardware.is_some();
    let mut settings = CycleSettings::new(GuardSettings {
        limits: if monitored { anywhere(limits) } else { limits },
        envelope,
        workspace: Some(job.workspace(&robot.workspace)).filter(|_| !monitored),
        tracking: [if monitored { TAU } else { job.safety.tracking_error }; MAX_JOINTS],
    });
    settings.max_consecutive_lost = u64::from(job.safety.max_lost);
    settings.queue = 3 * names.len() + 8;
    settings.rights = if simulated_time { Rights::NONE } else { rights(&job.realtime, 0) };
    settings.heartbeat_timeout = (!simulated_time).then_some(HEARTBEAT_TIMEOUT_MS);
    settings.must_be_realtime = job.realtime.on_refusal == OnRefusal::Refuse;
    settings.flight = FLIGHT;
    Ok(settings)
}

/// Checks a physical arm before it is driven.
/// Errors: other limits than the programme was checked under, a position outside the `limits`, or no free way to the first motion.
fn check_hardware(
    setup: &JobSetup,
    purpose: Purpose,
    hardware: &Hardware,
    limits: &Limits,
    script: &Script,
) -> Result<(), Failure> {
    let JobSetup { job, robot, arm_limits, .. } = setup;
    if purpose == Purpose::Drive && arm_limits.as_ref() != Some(&hardware.limits) {
        return Err(other_limits(job));
    }
    // A physical arm is wherever people left it.
    if let Some(target) = script.first_target() {
        check_position(limits, &hardware.q[..robot.chain.len()])?;
        programme::free_way(job, robot, &hardware.limits, &hardware.q, &target)?;
    }
    Ok(())
}

/// The robot's own accelerometers as one side of the mounting check.
fn by_accelerometers(measured: &MeasuredGravity) -> GravitySource {
    GravitySource { name: "the robot's accelerometers", gravity: measured.direction.into(), std: measured.std }
}

/// Why an arm whose own controller compensates another gravity is not driven without a model.
fn falls(vendor: &Vector3<f64>, state: &DaemonState) -> String {
    let [x, y, z]: [f64; 3] = (*vendor).into();
    let why = state.gravity.refused();
    let why = why.as_deref().unwrap_or("no model is there that is checked and used");
    format!(
        "the arm compensates gravity along [{x:.2}, {y:.2}, {z:.2}] m/s2, which is not the one that acts: commanded by torques it would fall \
         without a model from the first cycle on ({why}). Start the daemon with `--model` and the backend's torque feed-forward, let the arm \
         rest before the start, or command positions"
    )
}

/// The arm is another one than when the daemon started, or was updated since.
fn other_limits(job: &Job) -> Failure {
    let job = job.file.display();
    Failure::job(format!(
        "the connected arm has other limits than when this daemon started, and the programme was not checked under them; nothing \
         has moved. Start again, which plans under them: `plumbline run {job}`, or restart the service"
    ))
}

/// The limits for an arm whose position is not checked.
fn anywhere(limits: Limits) -> Limits {
    Limits { q_min: limits.q_min.map(|q| q - TAU), q_max: limits.q_max.map(|q| q + TAU), ..limits }
}

/// An arm outside the limits could only be stopped by them, whatever it is commanded.
fn check_position(limits: &Limits, q: &[f64]) -> Result<(), Failure> {
    let Some((j, [min, max])) = programme::outside(limits, q) else { return Ok(()) };
    let joint = j + 1;
    Err(Failure::job(format!(
        "joint {joint} stands at {:.4} rad, outside the range of job and arm, {min:.4} to {max:.4} rad; nothing has moved. Move joint {joint} \
         inside by hand (guiding mode), and start again",
        q[j]
    )))
}

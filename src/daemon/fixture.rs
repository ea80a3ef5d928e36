//! State, arm and models that unit tests of the daemon share.

use super::check::check;
use super::job_setup::JobSetup;
use super::recorder::Recorder;
use super::state::DaemonState;
use crate::config::job::Job;
use crate::process::signals::Ending;
use plumbline_core::{Backend, Command, Fault, Limits, MAX_JOINTS, Phase, Record, State};
use plumbline_ipc::{Proposal, Request, Response, RobotId, Served};
use plumbline_model::term::Sample;
use plumbline_model::{Mounting, Robot};
use plumbline_rt::Rights;
use plumbline_rt::cycle::Cycle;
use plumbline_rt::recorder::{RingSink, ring};
use plumbline_rt::{Checkpoint, Controls, CycleSettings, Doing, GuardSettings, Handles, Succession, cycle};
use std::sync::Arc;
use std::time::Duration;

pub const JOB: &str = "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"sim\"\narm = \"sim-panda\"\npace = \"wall-clock\"\n\
    [recorder]\nspan = \"0 s\"\n";
pub const MODEL: &str = include_str!("../../config/models/panda-paper-table3.toml");

/// The state of a daemon for [`JOB`], and the folder of its files.
pub fn new_state() -> (DaemonState, tempfile::TempDir) {
    state_of(JOB)
}

pub fn state_of(job: &str) -> (DaemonState, tempfile::TempDir) {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("job.toml");
    std::fs::write(&file, job).unwrap();
    let job = Job::load(&file, &[]).unwrap();
    let robot = Robot::load(&job.robot, None).unwrap();
    let id = RobotId::parse("test", "robot", "panda").unwrap();
    let recorder = Recorder::start(&job, &id, place.path()).unwrap();
    let arm = crate::setup::backend::connector(&job, &robot).unwrap().into();
    let rest = crate::setup::rest(&job, &robot).unwrap();
    let setup = JobSetup { job, robot, arm, arm_limits: None, rest, names: Vec::new() };
    (DaemonState::new(setup, recorder, Ending::default()).unwrap(), place)
}

pub fn ask(state: &mut DaemonState, request: Request) -> Response {
    state.answer(request, &Served::default(), None)
}

pub fn offer() -> Request {
    Request::OfferModel { toml: MODEL.to_string() }
}

#[track_caller]
pub fn refusal(answer: Response) -> String {
    let Response::Refused { reason } = answer else { panic!("{answer:?}") };
    reason
}

pub fn rest(state: &mut DaemonState, mounting: &Mounting) {
    let model = check(&state.setup.robot, &state.mounting, "test", MODEL).unwrap().model;
    for k in 0..8 {
        let q = [0.1 * f64::from(k), -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
        let tau = model.evaluator(&mounting.gravity()).torque(&Sample { q, ..Sample::default() }).0;
        let mut record = Record { phase: Phase::Hold, ..Record::default() };
        (record.state.q, record.state.tau, record.command.desired.q) = (q, tau, q);
        state.gravity.take(&vec![record; 400]);
    }
}

/// An ideal arm that loses two states before its third, and its connection after its fifth.
pub struct ShortLived(State);

impl Backend for ShortLived {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        self.0.seq += match self.0.seq {
            2 => 3,
            7 => return Err(Fault::Disconnected),
            _ => 1,
        };
        // Late by two periods, every time.
        std::thread::sleep(Duration::from_millis(12));
        Ok(self.0)
    }

    fn write(&mut self, _: &Command) -> Result<(), Fault> {
        Ok(())
    }

    fn stop(&mut self) {}

    fn deadline_ns(&self) -> Option<u64> {
        Some(plumbline_rt::os::now_ns())
    }
}

/// A loop and its outside end. It has room for two records.
pub fn real_time_loop(limits: Limits) -> (Cycle<ShortLived, RingSink>, Handles) {
    let guard = GuardSettings { limits, envelope: None, workspace: None, tracking: [0.1; MAX_JOINTS] };
    let settings = CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) };
    let q = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
    let arm = ShortLived(State { q, q_d: q, ..State::default() });
    cycle::new(arm, ring(2).0, None, settings).unwrap()
}

/// Controls of a loop whose arm rests after a stop and waits for a permission.
pub fn waiting(state: &DaemonState) -> Arc<Controls> {
    let (mut cycle, handles) = real_time_loop(state.setup.robot.limits);
    let doing = Doing::Stopped;
    cycle.restore(Checkpoint { doing, last: [Record::default(); 3], models: Succession::default() }).unwrap();
    assert!(handles.controls.is_waiting());
    Arc::clone(&handles.controls)
}

/// A text of a model that holds where axis 1 is vertical alone: the same parameters but two.
pub fn vertical() -> String {
    let lacks = |line: &&str| !line.contains("name = \"lx1\"") && !line.contains("name = \"ly1\"");
    let lines: Vec<&str> = MODEL.lines().filter(lacks).collect();
    lines.join("\n").replace("kind = \"GBS\"", "kind = \"VBS\"").replace("rho = 1.57", "rho = 0.0 # 1.57")
}

/// A text of the same model that has another identity.
pub fn another(number: u32) -> String {
    format!("{MODEL}\n# {number}\n")
}

pub fn offered(state: &mut DaemonState, toml: String) -> u64 {
    match ask(state, Request::OfferModel { toml }) {
        Response::ModelAccepted { model } => model,
        other => panic!("{other:?}"),
    }
}

pub fn proposed(state: &mut DaemonState, toml: String) -> Response {
    let proposal = Proposal { what: "payload".into(), ..Proposal::default() };
    ask(state, Request::ProposeModel { toml, proposal })
}

//! The recipe "Add a backend" of CONTRIBUTING.md, followed: a made-up arm passes the conformance suite, and the daemon's own sessions drive it.

use super::fixture::{JOB, state_of};
use super::*;
use crate::setup::planner::{self, Planner};
use crate::setup::programme::{Course, Motion, Planned, Role, Stage};
use plumbline_core::{
    ArmError, ArmLimits, ArmMonitor, Backend, Command, ConnectOptions, Connected, Explanation, Fault, Hardware,
    JointVec, Link, MeasuredGravity, ModeChange, PERIOD_NS, PERIOD_S, State,
};
use plumbline_ipc::RobotId;
use plumbline_rt::os;
use plumbline_testkit::conformance::conformance;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// A made-up arm: it is at once where it is commanded to be, and refuses what is no number.
struct MadeUpArm {
    state: State,
    next_ns: u64,
    stopped: bool,
    /// States until the connection is lost.
    lifetime: u64,
}

impl MadeUpArm {
    fn new(q: JointVec, lifetime: u64) -> MadeUpArm {
        let state = State { q, q_d: q, ..State::default() };
        MadeUpArm { state, next_ns: os::now_ns(), stopped: false, lifetime }
    }
}

impl Backend for MadeUpArm {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        if self.state.seq == self.lifetime {
            return Err(Fault::Disconnected);
        }
        self.next_ns += PERIOD_NS;
        os::sleep_until(self.next_ns);
        self.state.seq += 1;
        self.state.time = self.state.seq as f64 * PERIOD_S;
        Ok(self.state)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        let q = command.desired.q;
        if self.stopped || !q.iter().all(|q| q.is_finite()) {
            return Err(Fault::Refused { code: 1 });
        }
        (self.state.q, self.state.q_d, self.state.dq) = (q, q, command.desired.dq);
        Ok(())
    }

    fn stop(&mut self) {
        (self.stopped, self.state.dq) = (true, JointVec::default());
    }
}

/// Everything of the made-up arm that is not in the loop. Its first connection is lost after half a second.
struct MadeUpConnector {
    q: JointVec,
    limits: ArmLimits,
    connections: AtomicU32,
    recoveries: AtomicU32,
}

impl ArmConnector for MadeUpConnector {
    fn read_limits(&self) -> Result<Option<ArmLimits>, ArmError> {
        Ok(Some(self.limits))
    }

    fn connect(&self, options: &ConnectOptions) -> Result<Connected, ArmError> {
        let lifetime = if self.connections.fetch_add(1, Relaxed) == 0 { 500 } else { u64::MAX };
        let [x, y, z] = options.gravity;
        let length = x.hypot(y).hypot(z);
        let direction = options.gravity.map(|of| of / length);
        let hardware = Hardware {
            limits: self.limits,
            q: self.q,
            accelerometers: Some(MeasuredGravity { direction, std: 0.01 }),
            monitor: Box::new(MadeUpMonitor),
        };
        let backend = Box::new(MadeUpArm::new(self.q, lifetime));
        Ok(Connected { backend, compensates: options.gravity, gate: None, hardware: Some(hardware) })
    }

    fn max_recoveries(&self, fault: &Fault) -> u32 {
        u32::from(*fault == Fault::Disconnected)
    }

    fn recover(&self) -> Result<(), ArmError> {
        self.recoveries.fetch_add(1, Relaxed);
        Ok(())
    }
}

struct MadeUpMonitor;

impl ArmMonitor for MadeUpMonitor {
    fn name(&self) -> String {
        "made-up arm".into()
    }

    fn mode_change(&mut self) -> Option<ModeChange> {
        None
    }

    fn explain(&self, fault: &Fault) -> Explanation {
        Explanation { what: format!("made up: {fault}"), cause: None, next: "Nothing.".into() }
    }

    fn link(&self) -> Link {
        Link { robot: self.name(), states: 500, ..Link::default() }
    }
}

#[test]
fn a_made_up_backend_conforms() {
    conformance(|| MadeUpArm::new([0.1, -0.7, 0.0, -2.3, 0.0, 1.5, 0.7, 0.0], u64::MAX));
}

#[test]
fn a_made_up_backend_is_driven_recovered_and_driven_to_the_end() {
    let job = JOB.to_string()
        + "[realtime]\npriority = 0\nlock-memory = false\n[excitation]\nperiod = \"1 s\"\nharmonics = 3\n[safety]\nmax-lost = 1000\n";
    let (mut state, place) = state_of(&job);
    // The one line of `setup::backend`, for this test.
    let limits = ArmLimits { joints: 7, limits: state.setup.robot.limits, envelope: None };
    let (connections, recoveries) = (AtomicU32::new(0), AtomicU32::new(0));
    let arm = Arc::new(MadeUpConnector { q: state.setup.rest, limits, connections, recoveries });
    (state.setup.arm, state.setup.arm_limits) = (arm.clone(), Some(limits));

    let JobSetup { job, robot, .. } = &state.setup;
    let mounting = Mounting::UPRIGHT;
    let plan = Planner::of(job, robot, Some(&limits)).unwrap().random(&mounting, 1).unwrap();
    let (fourier, name) = (planner::motion(&plan).unwrap(), "validate-upright-1".to_string());
    let course = Course::Planned(Box::new(Planned { plan, fourier, periods: 1, lead_in: 0 }));
    let motion = Motion { number: 1, name, role: Role::Validate, mounting, course };
    let programme = Programme { stages: vec![Stage { mounting, motions: vec![motion] }] };

    let id = RobotId::parse("test", "robot", &format!("made-up-{}", std::process::id())).unwrap();
    let lock = Lock::take_in(place.path(), &id).unwrap();
    let stops = StopRelay::start(StopListener::open(&lock).unwrap(), || ()).unwrap();
    let server = Server::open(&id, ServerSettings { retain: 10_000, ..ServerSettings::default() }).unwrap();
    let checker = Checker::start(state.setup.robot.clone(), server.epoch()).unwrap();
    let (service, share) = (Service::of_environment(), RequestShare::default());
    let mut daemon = Daemon { stops, server, checker, state, service, share, published: Default::default() };

    daemon.state.programme.start = true;
    daemon.drive(&programme).unwrap();

    let DaemonState { programme, history, .. } = &daemon.state;
    assert_eq!((programme.progress, programme.ended.contains(&1)), (Progress::Done, true), "{:?}", programme.ended);
    assert_eq!((arm.connections.load(Relaxed), arm.recoveries.load(Relaxed)), (2, 1));
    let faults: Vec<_> = history.sessions.iter().map(|session| session.link.as_ref().unwrap().fault.clone()).collect();
    let lost = "made up: the connection to the arm is gone. Next: Nothing.".to_string();
    assert_eq!(faults, [Some(lost), None]);
}

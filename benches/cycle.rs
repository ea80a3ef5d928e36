//! The cycle's own work, reading and writing the arm excluded: `cargo bench --bench cycle [-- --quick]`.
//!
//! Everything that a cycle of the daemon does is here: the motion, the paper's whole model of a Panda with more terms beside it, the guard with the
//! end effector's kinematics, the records into the ring, the statistics. Once as fast as possible, and once at the daemon's pace: one cycle per
//! millisecond by the clock, when the caches hold something else. The arm itself is an echo that costs nothing.

use hdrhistogram::Histogram;
use plumbline::store::ModelFile;
use plumbline_core::{
    Backend, Command, Fault, FeedForward, JointVec, Kinematics, MAX_JOINTS, PERIOD_NS, Reference, Setpoint, State,
    Torque,
};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_model::term::Sample;
use plumbline_model::{Chain, Evaluator, Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_rt::Rights;
use plumbline_rt::os::{now_ns, sleep_until};
use plumbline_rt::recorder::ring;
use plumbline_rt::{CycleSettings, Event, GuardSettings, Order, OrderKind, cycle};
use std::sync::Arc;
use std::sync::Mutex;

/// Goals of the cycle's own work \[us\].
const GOAL: (f64, f64) = (5.0, 20.0);

/// An arm that reaches every command at once and reads the clock at each call of the loop.
struct Echo {
    state: State,
    deadline_ns: Option<u64>,
    /// Time at which the loop resumed, and its execution time in this cycle so far \[ns\].
    released_ns: u64,
    worked_ns: u64,
    work: Arc<Mutex<Histogram<u64>>>,
    begun: bool,
}

impl Backend for Echo {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        let worked = self.worked_ns + now_ns() - self.released_ns;
        if self.begun {
            // Not contended: the loop is its only user while it runs.
            if let Ok(mut work) = self.work.try_lock() {
                work.saturating_record(worked.max(1));
            }
        }
        self.begun = true;
        if let Some(deadline_ns) = &mut self.deadline_ns {
            *deadline_ns += PERIOD_NS;
            sleep_until(*deadline_ns);
        }
        self.state.seq += 1;
        self.worked_ns = 0;
        self.released_ns = now_ns();
        Ok(self.state)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.worked_ns += now_ns() - self.released_ns;
        (self.state.q, self.state.q_d, self.state.dq) = (command.desired.q, command.desired.q, command.desired.dq);
        self.released_ns = now_ns();
        Ok(())
    }

    fn stop(&mut self) {}
}

struct Served(Evaluator);

impl FeedForward for Served {
    fn id(&self) -> u64 {
        1
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        let &Setpoint { q, dq, ddq } = desired;
        self.0.torque(&Sample { q, dq, ddq })
    }

    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        self.0.rest(q)
    }
}

struct Reach(Chain);

impl Kinematics for Reach {
    fn end_effector(&self, q: &JointVec) -> [f64; 3] {
        self.0.end_effector(q).into()
    }
}

/// The paper's parameters, with an offset and a rotor's inertia in every joint beside rigid body and friction.
fn model(robot: &Robot) -> Evaluator {
    let file = format!("{}/config/models/panda-paper-table3.toml", env!("CARGO_MANIFEST_DIR"));
    let paper =
        ModelFile::load(file.as_ref(), |name| Robot::load(name, None).map(|robot| robot.chain)).expect("shipped").model;
    let reduction = Reduction::any_mounting(&robot.chain);
    let structure = Structure::of(robot.chain.clone(), reduction, &["friction", "torque-offset", "rotor-inertia"])
        .expect("known terms");
    let beta = paper.beta();
    let known = paper.structure().columns().iter().map(|column| column.name.clone()).zip(beta.iter().copied());
    let known: std::collections::HashMap<String, f64> = known.collect();
    let values: Vec<_> =
        structure.columns().iter().map(|column| (known.get(&column.name).copied().unwrap_or(0.01), None)).collect();
    let columns = values.len();
    let model = TorqueModel::new("panda", structure, Vec::new(), &values).expect("its columns");
    println!(
        "model: {columns} parameters (rigid body, friction, torque offset, rotor inertia), gravity of the wall mounting"
    );
    model.evaluator(&Mounting::WALL.gravity())
}

/// Ten seconds of a fast motion of all joints, from rest to rest.
fn motion(periods: u32) -> PeriodicMotion {
    let pose = vec![0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5];
    let mut fourier = Fourier::still(10.0, pose, 5).expect("a pose");
    for j in 0..7 {
        for k in 0..5 {
            let angle = 1.7 * j as f64 + 2.3 * k as f64 + 0.4;
            (fourier.a[(j, k)], fourier.b[(j, k)]) = (0.08 * angle.sin(), 0.08 * angle.cos());
        }
    }
    fourier.project();
    PeriodicMotion::new(&fourier, periods).expect("a motion from rest to rest")
}

fn measure(what: &str, paced: bool, periods: u32, robot: &Robot) -> bool {
    let motion = motion(periods);
    let start = motion.at(0).q;
    let work = Arc::new(Mutex::new(Histogram::new_with_bounds(1, 10_000_000_000, 3).expect("constant bounds")));
    let arm = Echo {
        state: State { seq: 1, q: start, q_d: start, ..State::default() },
        deadline_ns: paced.then(now_ns),
        released_ns: now_ns(),
        worked_ns: 0,
        work: Arc::clone(&work),
        begun: false,
    };
    let guard = GuardSettings {
        limits: robot.limits,
        envelope: robot.envelope,
        workspace: Some(robot.workspace),
        tracking: [0.1; MAX_JOINTS],
    };
    let settings =
        CycleSettings { rights: if paced { Rights::default() } else { Rights::NONE }, ..CycleSettings::new(guard) };
    let (sink, mut drain) = ring(8192);
    let (mut cycle, mut handles) =
        cycle::new(arm, sink, Some(Box::new(Reach(robot.chain.clone()))), settings).expect("sound settings");
    assert!(handles.models.serve(Box::new(Served(model(robot)))).is_ok());
    assert!(handles.orders.give(Order { motion: 1, kind: OrderKind::Follow(Box::new(motion)) }).is_ok());
    let looping = std::thread::spawn(move || cycle.run());
    let mut ended = false;
    while !looping.is_finished() {
        while drain.pop().is_some() {}
        while let Ok(event) = handles.events.pop() {
            assert!(!matches!(event.event, Event::Stopping { .. }), "the motion was stopped: {event:?}");
            if matches!(event.event, Event::Ended { .. }) {
                ended = true;
                handles.controls.quit();
            }
        }
        std::thread::sleep(std::time::Duration::from_micros(200));
    }
    let outcome = looping.join().expect("the loop does not panic");
    assert!(ended && outcome.summary.accounted());
    for refusal in outcome.granted.refusals().filter(|_| paced) {
        println!("degraded: {refusal}");
    }
    let work = work.lock().expect("nobody panicked");
    let us = |quantile| work.value_at_quantile(quantile) as f64 / 1e3;
    let (p50, p999) = (us(0.5), us(0.999));
    let held = p50 <= GOAL.0 && p999 <= GOAL.1;
    println!(
        "{what}: {} cycles, own work p50 {p50:.2} p99 {:.2} p99.9 {p999:.2} max {:.1} us; goal p50 <= {} and p99.9 <= {}: {}",
        work.len(),
        us(0.99),
        work.max() as f64 / 1e3,
        GOAL.0,
        GOAL.1,
        if held { "held" } else { "NOT HELD" }
    );
    held
}

fn main() {
    let quick = std::env::args().any(|arg| arg == "--quick");
    let robot = Robot::load("panda", None).expect("a shipped robot");
    measure("as fast as it goes", false, if quick { 1 } else { 20 }, &robot);
    measure("one cycle per ms of the clock", true, if quick { 1 } else { 6 }, &robot);
}

//! Fixtures for tests of the simulated arm.

use plumbline_core::{Clock, Command, JointVec, MAX_JOINTS, Setpoint};
use plumbline_model::{Chain, Mounting, Robot};
use plumbline_sim::{Pace, SimArm, Truth};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::time::{Duration, Instant};

/// A pose in the middle of the Panda's range.
pub const READY: JointVec = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5, 0.0];

/// Effects of the sensor, of the friction and of a body that comes later, for a truth file's end.
pub const THREE_EFFECTS: &str = r#"
[[effect]]
id = "torque-offset"
joint = 1
offset = 0.3

[[effect]]
id = "presliding"
joint = 4
delta = 0.002

[[effect]]
id = "payload"
mass = 0.73
com = [0.0, 0.0, 0.15]
inertia = [0.001, 0.0, 0.0, 0.0025, 0.0, 0.0017]
from = 60.0
"#;

pub fn panda() -> Chain {
    Robot::load("panda", None).expect("a shipped robot").chain
}

/// A shipped simulated arm: `config/arms/NAME.toml`.
pub fn arm(name: &str) -> Truth {
    arm_with(name, "")
}

/// A shipped simulated arm with `more` text behind its file's.
pub fn arm_with(name: &str, more: &str) -> Truth {
    let path = crate::path(format!("config/arms/{name}.toml"));
    let text = std::fs::read_to_string(&path).expect("a shipped arm") + more;
    Truth::parse(&path.display().to_string(), &text).unwrap_or_else(|error| panic!("{error}"))
}

/// The shipped Panda without noise, steps and losses.
pub fn silent_panda() -> Truth {
    let mut truth = arm("sim-panda");
    for joint in &mut truth.joints {
        (joint.torque_noise, joint.torque_quantum, joint.velocity_noise) = (0.0, 0.0, 0.0);
        (joint.position_noise, joint.position_quantum) = (0.0, 0.0);
    }
    truth
}

pub fn sim(truth: &Truth, seed: u64, pace: Pace) -> SimArm {
    SimArm::new(&panda(), truth, Mounting::WALL, READY, seed, pace).expect("truth fits the chain")
}

/// A periodic motion about [`READY`] that starts at rest, with peaks of about 1.5 rad/s.
pub fn excitation(tick: u64) -> Setpoint {
    let t = tick as f64 * 1e-3;
    let mut desired = Setpoint { q: READY, ..Setpoint::default() };
    for j in 0..MAX_JOINTS - 1 {
        for (harmonic, amplitude) in [(1.0, 0.35), (2.0 + (j % 3) as f64, 0.12)] {
            let omega = TAU / 5.0 * harmonic;
            // 1 - cos starts at rest; sin^2 fades the acceleration in over the first second.
            let fade = if t < 1.0 { (FRAC_PI_2 * t).sin().powi(4) } else { 1.0 };
            let side = if j % 2 == 0 { 1.0 } else { -1.0 };
            desired.q[j] += side * fade * amplitude * (1.0 - (omega * t).cos());
        }
    }
    desired
}

pub fn command(seq: u64, desired: Setpoint) -> Command {
    Command { seq, desired, ..Command::default() }
}

pub struct TestClock(pub Instant);

impl Clock for TestClock {
    fn now_ns(&self) -> u64 {
        self.0.elapsed().as_nanos() as u64
    }

    fn sleep_until(&self, ns: u64) {
        std::thread::sleep(Duration::from_nanos(ns.saturating_sub(self.now_ns())));
    }
}

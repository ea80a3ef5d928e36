//! Every hook of an effect does to the arm what its physics says. The torque an effect leaves is found by the estimator's own
//! Newton-Euler recursion, which shares nothing with the simulation.

mod catalogue;
mod friction;
mod sensors;
mod transmission;
mod world;

use super::*;
use crate::{Exact, Gate, Pace, SimArm};
use plumbline_core::{Backend, Command, MAX_JOINTS, State};
use plumbline_model::{Chain, Joint, JointKind, LinkParameters, Mounting, Placement, rnea};
use std::sync::Arc;

const N: usize = 3;
const START: JointVec = [0.3, -0.4, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0];

/// Turn, turn, slide.
fn chain() -> Chain {
    let joint = |kind, a, alpha, d| Joint { kind, a, alpha, d, theta: 0.0 };
    let joints = vec![
        joint(JointKind::Revolute, 0.0, 0.0, 0.3),
        joint(JointKind::Revolute, 0.1, -1.3, 0.0),
        joint(JointKind::Prismatic, 0.2, 1.1, 0.1),
    ];
    Chain::modified(joints, Placement::identity())
}

fn parsed(effects: &str) -> Result<Truth, BadInput> {
    let text = format!(
        "robot = 'turn-turn-slide'
        link = [
            {{ mass = 3.0, com = [0.02, 0.03, -0.1], inertia = [0.03, 0.0, 0.0, 0.03, 0.0, 0.02] }},
            {{ mass = 2.0, com = [0.15, 0.01, 0.02], inertia = [0.01, 0.001, 0.0, 0.02, 0.0, 0.02] }},
            {{ mass = 1.0, com = [0.01, 0.02, 0.1], inertia = [0.01, 0.0, 0.001, 0.01, 0.0, 0.003] }},
        ]
        joint = [
            {{ fv = 0.1, fc = 0.5, stiffness = 3000, damping = 60 }},
            {{ fv = 0.2, fc = 0.3, stiffness = 3000, damping = 60 }},
            {{ fv = 0.3, fc = 0.4, stiffness = 5000, damping = 100 }},
        ]
        {effects}"
    );
    Truth::parse("test", &text)
}

fn truth(effects: &str) -> Truth {
    parsed(effects).unwrap_or_else(|error| panic!("{error}"))
}

fn desired(tick: u64) -> Setpoint {
    let t = tick as f64 * 1e-3;
    let mut setpoint = Setpoint { q: START, ..Setpoint::default() };
    for (j, omega) in [6.0, 9.0, 7.5].into_iter().enumerate() {
        setpoint.q[j] += 0.05 * (1.0 - (omega * t).cos()).powi(2);
    }
    setpoint
}

/// Moves an arm for `ticks` milliseconds, mounted upright as far as it knows.
fn run(truth: &Truth, effects: Vec<Box<dyn Effect>>, ticks: usize) -> Vec<(State, Exact)> {
    let mut all = truth.build_effects();
    all.extend(effects);
    let pace = Pace::Fast(Arc::new(Gate::unlimited()));
    let mut arm = SimArm::with_effects(&chain(), truth, Mounting::UPRIGHT.gravity(), START, 0, pace, all).unwrap();
    let mut step = || {
        let state = arm.read().unwrap();
        let command = Command { seq: state.seq, desired: desired(state.seq), ..Command::default() };
        let exact = *arm.exact();
        arm.write(&command).unwrap();
        (state, exact)
    };
    (0..ticks).map(|_| step()).collect()
}

/// What rigid bodies `links` and the declared friction leave of the torque.
fn left(truth: &Truth, links: &[LinkParameters], gravity: Mounting, exact: &Exact) -> JointVec {
    let mut tau = [0.0; MAX_JOINTS];
    rnea(&chain(), links, &gravity.gravity(), &exact.q, &exact.dq, &exact.ddq, &mut tau);
    std::array::from_fn(|j| match truth.joints.get(j) {
        Some(joint) => exact.tau[j] - tau[j] - joint.fv * exact.dq[j] - joint.fc * (100.0 * exact.dq[j]).tanh(),
        None => 0.0,
    })
}

#[track_caller]
fn assert_close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} instead of {expected}");
}

struct Tilted;
impl Effect for Tilted {
    fn gravity(&self, _t: f64, gravity: &mut Vector3<f64>) {
        *gravity = Mounting::WALL.gravity();
    }
}

#[test]
fn gravity_is_what_the_effect_says() {
    let truth = truth("");
    let mut differs = 0.0f64;
    for (_, exact) in run(&truth, vec![Box::new(Tilted)], 500) {
        let wall = left(&truth, &truth.link_parameters(), Mounting::WALL, &exact);
        let upright = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact);
        (0..N).for_each(|j| assert_close(wall[j], 0.0, 1e-9));
        differs = differs.max(upright[1].abs());
    }
    assert!(differs > 1.0, "{differs} Nm");
}

struct Rotor;
impl Effect for Rotor {
    fn armature(&self, _t: f64, joint: usize) -> f64 {
        if joint == 1 { 0.2 } else { 0.0 }
    }
}

#[test]
fn a_rotor_takes_torque_of_its_own_joint_alone() {
    let truth = truth("");
    for (_, exact) in run(&truth, vec![Box::new(Rotor)], 500) {
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact);
        assert_close(left[0], 0.0, 1e-9);
        assert_close(left[1], 0.2 * exact.ddq[1], 1e-9);
        assert_close(left[2], 0.0, 1e-9);
    }
}

#[test]
fn a_payload_is_there_from_its_moment_on() {
    let text = "effect = [{ id = 'payload', mass = 0.7, com = [0.1, 0.0, 0.2], inertia = [0.002, 0, 0, 0.002, 0, 0.001], from = 0.3 }]";
    let truth = truth(text);
    let empty = truth.link_parameters();
    let mut loaded = empty.clone();
    // By hand: inertia about the origin, first moments, mass.
    let (m, x, z) = (0.7, 0.1, 0.2);
    let body =
        [0.002 + m * z * z, 0.0, -m * x * z, 0.002 + m * (x * x + z * z), 0.0, 0.001 + m * x * x, m * x, 0.0, m * z, m];
    loaded[2].iter_mut().zip(body).for_each(|(slot, part)| *slot += part);
    for (state, exact) in run(&truth, vec![], 600) {
        // The state at the moment itself is the last without it: the body is taken up by the millisecond that follows.
        let links = if state.seq <= 300 { &empty } else { &loaded };
        let left = left(&truth, links, Mounting::UPRIGHT, &exact);
        (0..N).for_each(|j| assert_close(left[j], 0.0, 1e-9));
    }
}

struct Push;
impl Effect for Push {
    fn wrench(&self, _at: &At) -> Option<External> {
        let point = Vector3::new(0.05, -0.1, 0.3);
        Some(External { link: 2, point, force: Vector3::new(5.0, -3.0, 8.0), moment: Vector3::new(0.4, 0.2, -0.6) })
    }
}

#[test]
fn a_wrench_takes_the_torque_of_its_jacobian() {
    let truth = truth("");
    let push = Push.wrench(&At::default()).unwrap();
    for (_, exact) in run(&truth, vec![Box::new(Push)], 300) {
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact);
        let mut frames = vec![];
        let mut frame = Placement::identity();
        for (joint, &q) in chain().joints().iter().zip(&exact.q) {
            frame = frame.then(&joint.placement(q));
            frames.push((joint.kind, frame));
        }
        let point = frame.rotation * push.point + frame.origin;
        for (j, (kind, frame)) in frames.iter().enumerate() {
            let axis: Vector3<f64> = frame.rotation.column(2).into();
            let work = match kind {
                JointKind::Revolute => axis.dot(&(push.moment + (point - frame.origin).cross(&push.force))),
                JointKind::Prismatic => axis.dot(&push.force),
            };
            // tau + J' w is what moves the arm.
            assert_close(left[j], -work, 1e-9);
        }
    }
}

struct EncoderZero;
impl Effect for EncoderZero {
    fn encoder(&self, _at: &At, _x: &[f64], _dx: &mut [f64], q: &mut JointVec, _dq: &mut JointVec) {
        q[1] += 0.005;
    }
}

#[test]
fn an_encoder_error_fools_the_controller_too() {
    let truth = truth("");
    let states = run(&truth, vec![Box::new(EncoderZero)], 600);
    for (state, exact) in &states {
        assert_close(state.q[1], exact.q[1] + 0.005, 1e-15);
    }
    let (state, exact) = states[599];
    assert!((state.q[1] - state.q_d[1]).abs() < 2e-3, "the encoder says that the arm is where it should be");
    assert!((exact.q[1] - state.q_d[1]).abs() > 3e-3, "it is not");
}

struct LateTorque(JointVec);
impl Effect for LateTorque {
    fn sense(&mut self, _at: &At, _x: &[f64], reading: &mut Reading) {
        std::mem::swap(&mut self.0, &mut reading.tau);
    }
}

#[test]
fn a_channel_can_be_late_and_offset() {
    let truth = truth("effect = [{ id = 'torque-offset', joint = 2, offset = -0.25 }]");
    let states = run(&truth, vec![Box::new(LateTorque(START))], 300);
    for pair in states.windows(2) {
        let ((_, before), (state, _)) = (&pair[0], &pair[1]);
        for (j, offset) in [0.0, -0.25, 0.0].into_iter().enumerate() {
            assert_close(state.tau[j], before.tau[j] + offset, 1e-12);
        }
    }
}

/// A sprung and damped stage between motor and link; its states are twist and twist rate. Crude: its inertia feels the twist alone.
struct FlexibleJoint;
const ROTOR: f64 = 0.1;
const SPRING: f64 = 8000.0;
impl Effect for FlexibleJoint {
    fn states(&self) -> usize {
        2
    }

    fn torque(&self, _at: &At, x: &[f64], dx: &mut [f64], tau: &mut JointVec) {
        let twist = SPRING * x[0] + 20.0 * x[1];
        dx[0] = x[1];
        dx[1] = (tau[1] - twist) / ROTOR;
        tau[1] = twist;
    }

    fn sense(&mut self, _at: &At, x: &[f64], reading: &mut Reading) {
        reading.tau[1] = SPRING * x[0] + 20.0 * x[1];
    }
}

/// An effect with states of its own can stand between the motor and the link; a sensor behind it measures what the link gets.
#[test]
fn an_elastic_transmission_carries_what_the_link_needs() {
    let truth = truth("");
    let mut most = 0.0f64;
    for (state, exact) in run(&truth, vec![Box::new(FlexibleJoint)], 500) {
        let measured = Exact { tau: state.tau, ..exact };
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &measured);
        // Friction acts on the motor's side of the spring, before it.
        let friction = truth.joints[1].fv * exact.dq[1] + truth.joints[1].fc * (100.0 * exact.dq[1]).tanh();
        assert_close(left[0], 0.0, 1e-9);
        assert_close(left[1] + friction, 0.0, 1e-9);
        most = most.max((exact.tau[1] - state.tau[1]).abs());
    }
    assert!(most > 0.3, "motor and link differ by {most} Nm");
}

/// Dahl's law in closed form: from full friction, a reversal at q0 gives `-fc + 2 fc exp(-|q - q0| / delta)`.
#[test]
fn presliding_friction_follows_the_displacement_since_the_reversal() {
    let truth = truth("effect = [{ id = 'presliding', joint = 1, delta = 0.002 }]");
    let states = run(&truth, vec![], 1500);
    let fc = truth.joints[0].fc;
    let friction = |exact: &Exact| {
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, exact);
        assert_close(left[1], 0.0, 1e-9);
        left[0] + fc * (100.0 * exact.dq[0]).tanh()
    };
    let mut reversals = 0;
    for k in 400..1400 {
        let (before, after) = (&states[k].1, &states[k + 1].1);
        if before.dq[0] * after.dq[0] >= 0.0 || (friction(before).abs() - fc).abs() > 1e-3 * fc {
            continue;
        }
        // Where the velocity crossed zero; the friction there is the full one of the old direction.
        let (way, t) = (after.dq[0].signum(), before.dq[0] / (before.dq[0] - after.dq[0]) * 1e-3);
        let q0 = before.q[0] + before.dq[0] * t / 2.0;
        let onward = states[k + 1..].iter().map(|(_, exact)| exact).take_while(|exact| exact.dq[0] * way > 0.0);
        for exact in onward.take(100) {
            let bent = way * (fc - 2.0 * fc * (-(exact.q[0] - q0).abs() / 0.002).exp());
            assert_close(friction(exact), bent, 0.01 * fc);
        }
        reversals += 1;
    }
    assert!(reversals >= 2, "{reversals} reversals");
}

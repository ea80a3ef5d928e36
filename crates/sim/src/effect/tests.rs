//! Every hook of an effect against its physics. The torque of an effect is computed with the model's Newton-Euler recursion, which shares no code with the simulation.

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

/// Moves an arm for `ticks` milliseconds, declared upright.
fn run(truth: &Truth, ticks: usize) -> Vec<(State, Exact)> {
    let pace = Pace::Fast(Arc::new(Gate::unlimited()));
    let mut arm = SimArm::new(&chain(), truth, Mounting::UPRIGHT, START, 0, pace).unwrap();
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

#[test]
fn a_rotor_changes_the_torque_of_its_joint_only() {
    let truth = truth("effect = [{ id = 'rotor-inertia', joint = 2, inertia = 0.2 }]");
    for (_, exact) in run(&truth, 500) {
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact);
        assert_close(left[0], 0.0, 1e-9);
        assert_close(left[1], 0.2 * exact.ddq[1], 1e-9);
        assert_close(left[2], 0.0, 1e-9);
    }
}

#[test]
fn a_payload_acts_from_its_onset_on() {
    let text = "effect = [{ id = 'payload', mass = 0.7, com = [0.1, 0.0, 0.2], inertia = [0.002, 0, 0, 0.002, 0, 0.001], from = 0.3 }]";
    let truth = truth(text);
    let empty = truth.link_parameters();
    let mut loaded = empty.clone();
    // By hand: inertia about the origin, first moments, mass.
    let (m, x, z) = (0.7, 0.1, 0.2);
    let body =
        [0.002 + m * z * z, 0.0, -m * x * z, 0.002 + m * (x * x + z * z), 0.0, 0.001 + m * x * x, m * x, 0.0, m * z, m];
    loaded[2].iter_mut().zip(body).for_each(|(slot, part)| *slot += part);
    for (state, exact) in run(&truth, 600) {
        // The state at the moment itself is the last without it: the body is taken up by the millisecond that follows.
        let links = if state.seq <= 300 { &empty } else { &loaded };
        let left = left(&truth, links, Mounting::UPRIGHT, &exact);
        (0..N).for_each(|j| assert_close(left[j], 0.0, 1e-9));
    }
}

#[test]
fn a_wrench_gives_the_torque_of_its_jacobian() {
    let contact = "id = 'contact', point = [0.05, -0.1, 0.3], force = [5, -3, 8], moment = [0.4, 0.2, -0.6], edge = 0.002, to = 1.0";
    let truth = truth(&format!("effect = [{{ {contact} }}]"));
    let push = truth.build_effects()[0].wrench(&At { t: 0.5, ..At::default() }).unwrap();
    // From the end of the edge on.
    for (_, exact) in run(&truth, 300).into_iter().skip(2) {
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

/// Dahl's law in closed form: from full friction, a reversal at q0 gives `-fc + 2 fc exp(-|q - q0| / delta)`.
#[test]
fn presliding_friction_follows_the_displacement_since_the_reversal() {
    let truth = truth("effect = [{ id = 'presliding', joint = 1, delta = 0.002 }]");
    let states = run(&truth, 1500);
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

//! Friction and other torques inside the arm: actuator torque less rigid bodies against the law, along the true motion.

use super::*;
use crate::truth::Truth;

/// Runs the arm and checks what the actuators give beyond rigid bodies and declared friction.
#[track_caller]
fn takes(effects: &str, law: impl Fn(&Exact, f64) -> JointVec) {
    let truth = truth(&format!("effect = [{effects}]"));
    let mut size = 0.0f64;
    for (state, exact) in run(&truth, 900) {
        assert_eq!(state.tau[..N], exact.tau[..N], "the sensor says what the actuators do");
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact);
        let expected = law(&exact, state.time);
        (0..N).for_each(|j| assert_close(left[j], expected[j], 1e-9));
        size = expected.iter().fold(size, |size, torque| size.max(torque.abs()));
    }
    assert!(size > 0.01, "{size} Nm at most");
}

fn on(joint: usize, torque: f64) -> JointVec {
    let mut tau = [0.0; MAX_JOINTS];
    tau[joint - 1] = torque;
    tau
}

fn s(dq: f64) -> f64 {
    (100.0 * dq).tanh()
}

#[test]
fn asymmetric_friction_follows_its_law() {
    takes("{ id = 'asymmetric-coulomb', joint = 1, asymmetry = 0.2 }", |at, _| on(1, 0.2 * s(at.dq[0]).abs()));
    takes("{ id = 'asymmetric-viscous', joint = 2, asymmetry = -0.1 }", |at, _| on(2, -0.1 * at.dq[1].abs()));
}

#[test]
fn friction_over_speed_follows_its_law() {
    takes("{ id = 'stribeck', joint = 2, excess = 0.2, velocity = 0.05 }", |at, _| {
        on(2, 0.2 * (-(at.dq[1] * at.dq[1]) / 0.0025).exp() * s(at.dq[1]))
    });
    takes("{ id = 'coulomb-slope', joint = 2, size = 0.3, velocity = 0.03 }", |at, _| {
        on(2, 0.3 * ((at.dq[1] / 0.03).tanh() - s(at.dq[1])))
    });
    takes("{ id = 'coulomb-slope', joint = 2, size = 0.3, velocity = 0.02, form = 'arctan' }", |at, _| {
        on(2, 0.3 * ((at.dq[1] / 0.02).atan() * 2.0 / std::f64::consts::PI - s(at.dq[1])))
    });
    // Gaz et al. 2019: phi1 / (1 + exp(-phi2 (dq + phi3))) - phi1 / (1 + exp(-phi2 phi3)).
    let [phi1, phi2, phi3] = [0.55, 5.0, 0.04];
    takes(
        "{ id = 'nonlinear-viscous', joint = 1, form = 'sigmoid', size = 0.55, velocity = 0.2, shift = 0.04 }",
        |at, _| on(1, phi1 / (1.0 + (-phi2 * (at.dq[0] + phi3)).exp()) - phi1 / (1.0 + (-phi2 * phi3).exp())),
    );
    takes("{ id = 'nonlinear-viscous', joint = 3, form = 'cubic', size = 0.4 }", |at, _| on(3, 0.4 * at.dq[2].powi(3)));
    takes("{ id = 'nonlinear-viscous', joint = 3, form = 'quadratic', size = 0.4 }", |at, _| {
        on(3, 0.4 * at.dq[2].powi(2) * at.dq[2].signum())
    });
}

/// The load is the torque of the links, an undeclared body included, by the model's recursion.
#[test]
fn friction_grows_with_the_true_load() {
    let effects = "{ id = 'payload', mass = 0.7, com = [0, 0, 0.2] },
        { id = 'load-dependent-friction', joint = 2, coulomb = 0.05, viscous = 0.02 }";
    let truth = truth(&format!("effect = [{effects}]"));
    let mut links = truth.link_parameters();
    let (m, z) = (0.7, 0.2);
    links[2].iter_mut().zip([m * z * z, 0.0, 0.0, m * z * z, 0.0, 0.0, 0.0, 0.0, m * z, m]).for_each(|(a, b)| *a += b);
    let mut most = 0.0f64;
    for (_, exact) in run(&truth, 900) {
        let mut load = [0.0; MAX_JOINTS];
        let gravity = Mounting::UPRIGHT.gravity();
        rnea(&chain(), &links, &gravity, &exact.q, &exact.dq, &exact.ddq, &mut load);
        let left = left(&truth, &links, Mounting::UPRIGHT, &exact);
        let friction = load[1].abs() * (0.05 * s(exact.dq[1]) + 0.02 * exact.dq[1]);
        assert_close(left[1], friction, 1e-9);
        assert_close(left[0], 0.0, 1e-9);
        most = most.max(friction.abs());
    }
    assert!(most > 0.05, "{most} Nm");
}

#[test]
fn friction_drifts_as_the_arm_warms_up() {
    let declared = |at: &Exact| {
        [0.1 * at.dq[0] + 0.5 * s(at.dq[0]), 0.2 * at.dq[1] + 0.3 * s(at.dq[1]), 0.3 * at.dq[2] + 0.4 * s(at.dq[2])]
    };
    let warm = |t: f64| if t < 0.2 { 0.0 } else { 1.0 - (-(t - 0.2) / 0.4).exp() };
    takes("{ id = 'friction-drift', joint = 2, share = -0.5, time = 0.4, from = 0.2 }", |at, t| {
        on(2, -0.5 * warm(t) * declared(at)[1])
    });
    // A linear loss ends where nothing is left.
    takes("{ id = 'friction-drift', share = -1.0, time = 0.5, trend = 'linear' }", |at, t| {
        let mut tau = [0.0; MAX_JOINTS];
        tau.iter_mut().zip(declared(at)).for_each(|(slot, friction)| *slot = -(t / 0.5).min(1.0) * friction);
        tau
    });
}

#[test]
fn friction_and_ripple_over_position_follow_their_laws() {
    takes("{ id = 'position-dependent-friction', joint = 1, order = 3, sine = 0.2, cosine = -0.1 }", |at, _| {
        on(1, (0.2 * (3.0 * at.q[0]).sin() - 0.1 * (3.0 * at.q[0]).cos()) * s(at.dq[0]))
    });
    takes("{ id = 'position-ripple', joint = 1, order = 30, sine = 0.2, cosine = -0.1, on = 'joint' }", |at, _| {
        on(1, 0.2 * (30.0 * at.q[0]).sin() - 0.1 * (30.0 * at.q[0]).cos())
    });
}

#[test]
fn springs_pull_towards_their_rest() {
    takes("{ id = 'spring', joint = 1, stiffness = 2, cubic = 5, rest = 0.35 }", |at, _| {
        let x = at.q[0] - 0.35;
        on(1, 2.0 * x + 5.0 * x.powi(3))
    });
    takes("{ id = 'spring', joint = 1, stiffness = 2, rest = 0.35, side = 'above' }", |at, _| {
        on(1, if at.q[0] > 0.35 { 2.0 * (at.q[0] - 0.35) } else { 0.0 })
    });
    takes("{ id = 'spring', joint = 1, stiffness = 2, rest = 0.35, side = 'below' }", |at, _| {
        on(1, if at.q[0] < 0.35 { 2.0 * (at.q[0] - 0.35) } else { 0.0 })
    });
}

#[test]
fn coupled_joints_share_friction() {
    takes("{ id = 'transmission-coupling', joint = 2, other = 1, fc = 0.2, fv = 0.1 }", |at, _| {
        on(2, 0.2 * s(at.dq[0]) + 0.1 * at.dq[0])
    });
    takes("{ id = 'transmission-coupling', joint = 2, other = 1, ratio = -0.5, fc = 0.2, fv = 0.1 }", |at, _| {
        let u = at.dq[1] - 0.5 * at.dq[0];
        let f = 0.2 * s(u) + 0.1 * u;
        let mut tau = on(2, f);
        tau[0] = -0.5 * f;
        assert!(tau[0] * at.dq[0] + tau[1] * at.dq[1] >= 0.0, "friction takes power");
        tau
    });
}

#[test]
fn foreign_effects_are_as_documented() {
    let g = |x: f64| (-x * x).exp();
    let start = "id = 'foreign', joint = 1, size = 0.3";
    let form = |rest: &str| format!("{{ {start}, {rest} }}");
    takes(&form("form = 'windowed-sine', first = 2, order = 12, second = 1, middle = 0.4, width = 0.1"), |at, _| {
        on(1, 0.3 * (12.0 * at.q[1]).sin() * g((at.q[0] - 0.4) / 0.1))
    });
    takes(
        &form("form = 'bump', first = 2, middle = -0.3, width = 0.1, second = 3, speed = 0.2, spread = 0.4"),
        |at, _| on(1, 0.3 * g((at.q[1] + 0.3) / 0.1) * g((at.dq[2] - 0.2) / 0.4)),
    );
    takes(&form("form = 'region', first = 2, middle = -0.3, width = 0.02"), |at, _| {
        on(1, 0.3 / (1.0 + (-2.0 * (at.q[1] + 0.3) / 0.02).exp()))
    });
    takes(&form("form = 'product', first = 2, width = 0.3, second = 3"), |at, _| {
        on(1, 0.3 * (at.q[1] / 0.3).tanh() * at.dq[2])
    });
    takes(&form("form = 'beat', every = 0.5"), |_, t| {
        let x = t / 0.5 - (t / 0.5).floor();
        on(1, 0.3 * (4.0 * std::f64::consts::PI * x).sin() * (std::f64::consts::PI * x).sin().powi(2))
    });
}

/// Drives an effect alone along `q(t) = amplitude sin(t)`, 20 000 steps a cycle, and gives the torque it takes over the last of three cycles.
fn loop_of(effect: &str, amplitude: f64) -> Vec<(f64, f64)> {
    let truth: Truth = truth(&format!("effect = [{effect}]"));
    let mut effect = truth.build_effects().remove(0);
    let (steps, mut x) = (20_000usize, vec![0.0; effect.states()]);
    let mut taken = Vec::new();
    for k in 0..3 * steps {
        let t = std::f64::consts::TAU * k as f64 / steps as f64;
        let mut at = At { n: N, ..At::default() };
        (at.q[0], at.dq[0]) = (amplitude * t.sin(), amplitude * t.cos());
        effect.begin_step(&at);
        let (mut tau, mut dx) = ([0.0; MAX_JOINTS], vec![0.0; x.len()]);
        effect.torque(&at, &x, &mut dx, &mut tau);
        x.iter_mut().zip(&dx).for_each(|(x, dx)| *x += dx * std::f64::consts::TAU / steps as f64);
        if k >= 2 * steps {
            taken.push((at.q[0], -tau[0]));
        }
    }
    taken
}

/// Energy that a closed loop of torque over position takes \[J\].
fn area(points: &[(f64, f64)]) -> f64 {
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|(a, b)| 0.5 * (a.1 + b.1) * (b.0 - a.0)).sum()
}

/// An element of fc share_i that slides after delta_i takes 4 fc share_i (A - delta_i) in a cycle of amplitude A, and nothing where it does not slide.
#[test]
fn maxwell_slip_dissipates_the_energy_of_its_elements() {
    let elements =
        "elements = [{ share = 0.5, delta = 0.001 }, { share = 0.3, delta = 0.01 }, { share = 0.2, delta = 0.1 }]";
    let effect = format!("{{ id = 'presliding', joint = 1, {elements} }}");
    for amplitude in [0.0005, 0.005, 0.03, 0.3] {
        let points = loop_of(&effect, amplitude);
        let slides = |(share, delta): &(f64, f64)| 4.0 * 0.5 * share * (amplitude - delta).max(0.0);
        let energy: f64 = [(0.5, 0.001), (0.3, 0.01), (0.2, 0.1)].iter().map(slides).sum();
        assert_close(area(&points), energy, 1e-3 * energy + 1e-9);
        // Nonlocal memory: the loop is odd, and its top is the sum of the sprung and the slid.
        let top = points.iter().fold(0.0f64, |top, (_, tau)| top.max(*tau));
        let expected: f64 = [(0.5, 0.001), (0.3, 0.01), (0.2, 0.1)]
            .iter()
            .map(|(share, delta)| 0.5 * share * (amplitude / delta).min(1.0))
            .sum();
        assert_close(top, expected, 1e-3);
    }
}

/// Dahl's law integrated around a cycle of amplitude A takes 4 fc (A - delta tanh(A / delta)).
#[test]
fn a_bristle_dissipates_the_energy_of_its_loop() {
    for amplitude in [0.001, 0.004, 0.02] {
        let points = loop_of("{ id = 'presliding', joint = 1, delta = 0.004 }", amplitude);
        let energy = 4.0 * 0.5 * (amplitude - 0.004 * (amplitude / 0.004f64).tanh());
        assert_close(area(&points), energy, 0.01 * energy);
    }
}

/// Before it breaks away a joint holds more than it slides with.
#[test]
fn both_forms_break_away_alike() {
    for form in ["delta = 0.002", "elements = [{ share = 1.0, delta = 0.002 }]"] {
        let effect = format!("{{ id = 'presliding', joint = 1, {form}, breakaway = 1.5, stribeck-velocity = 0.02 }}");
        let truth = truth(&format!("effect = [{effect}]"));
        let mut effect = truth.build_effects().remove(0);
        let mut slide = |dq: f64| {
            let (mut at, mut x) = (At { n: N, ..At::default() }, vec![0.0; effect.states()]);
            let mut taken = [0.0; MAX_JOINTS];
            for _ in 0..50_000 {
                at.q[0] += dq * 1e-6 / dq.abs();
                at.dq[0] = dq;
                effect.begin_step(&at);
                taken = [0.0; MAX_JOINTS];
                let mut dx = vec![0.0; x.len()];
                effect.torque(&at, &x, &mut dx, &mut taken);
                x.iter_mut().zip(&dx).for_each(|(x, dx)| *x += dx * 1e-6 / dq.abs());
            }
            -taken[0]
        };
        assert_close(slide(1e-5), 0.75, 1e-3);
        assert_close(slide(0.5), 0.5, 1e-3);
        assert_close(slide(-1e-5), -0.75, 1e-3);
    }
}

//! Mounting, base motion and contact.

use super::*;

#[test]
fn a_tilted_base_is_a_declared_mounting() {
    let gravity = |effect: &str, declared: Mounting| {
        let mut gravity = declared.gravity();
        truth(&format!("effect = [{{ id = 'mounting', {effect} }}]")).build_effects()[0].gravity(0.0, &mut gravity);
        gravity
    };
    // Bitwise the gravity of an arm with this declared mounting.
    let truly = Mounting { rho: 1.4, phi: 0.3 };
    assert_eq!(gravity("rho = 1.4, phi = 0.3", Mounting::UPRIGHT), truly.gravity());
    assert_eq!(gravity("tilt = [0, 0, 0]", truly), truly.gravity());
    // Upright, turned by a quarter about y: base x now points down.
    let quarter = std::f64::consts::FRAC_PI_2;
    let wall = gravity(&format!("tilt = [0, {quarter}, 0]"), Mounting::UPRIGHT);
    assert!((wall - Mounting::WALL.gravity()).norm() < 1e-12, "{wall}");
}

/// An arm with the declared mounting as an effect moves bitwise as without the effect.
#[test]
fn an_effect_with_the_declared_mounting_changes_nothing() {
    let upright = Mounting::UPRIGHT;
    let effect = format!("effect = [{{ id = 'mounting', rho = {:?}, phi = {:?} }}]", upright.rho, upright.phi);
    assert_eq!(run(&truth(&effect), 300), run(&truth(""), 300));
}

#[test]
fn a_tilt_gives_the_torque_of_the_true_gravity() {
    let truth = truth("effect = [{ id = 'mounting', rho = 3.0, phi = 0.5 }]");
    let mut differs = 0.0f64;
    for (_, exact) in run(&truth, 300) {
        let truly = left(&truth, &truth.link_parameters(), Mounting { rho: 3.0, phi: 0.5 }, &exact);
        (0..N).for_each(|j| assert_close(truly[j], 0.0, 1e-9));
        differs = differs.max(left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact)[1].abs());
    }
    assert!(differs > 0.05, "{differs} Nm");
}

/// In a base that accelerates by a(t), everything weighs as if gravity were a_g - a(t).
#[test]
fn base_motion_acts_as_gravity() {
    let effect =
        "{ id = 'base-motion', frequency = 7.3, amplitude = 0.5, direction = [3, 0, 4], phase = 0.2, from = 0.1 }";
    let truth = truth(&format!("effect = [{effect}]"));
    for (state, exact) in run(&truth, 400) {
        let t = state.time - 0.1;
        let a = if t < 0.0 { 0.0 } else { 0.5 * (std::f64::consts::TAU * 7.3 * t + 0.2).sin() };
        let gravity = Mounting::UPRIGHT.gravity() - a * Vector3::new(0.6, 0.0, 0.8);
        let mut tau = [0.0; MAX_JOINTS];
        rnea(&chain(), &truth.link_parameters(), &gravity, &exact.q, &exact.dq, &exact.ddq, &mut tau);
        for (j, joint) in truth.joints.iter().enumerate() {
            tau[j] += joint.fv * exact.dq[j] + joint.fc * (100.0 * exact.dq[j]).tanh();
            assert_close(exact.tau[j], tau[j], 1e-9);
        }
    }
}

#[test]
fn a_contact_rises_falls_and_repeats() {
    let effect = "id = 'contact', link = 2, point = [0.1, 0, 0], force = [0, 0, -8], moment = [1, 0, 0], from = 0.2, to = 0.5, edge = 0.1";
    let force = |rest: &str, t: f64| {
        let truth = truth(&format!("effect = [{{ {effect}{rest} }}]"));
        let wrench = truth.build_effects()[0].wrench(&At { t, ..At::default() });
        wrench.map_or(0.0, |wrench| {
            assert_eq!((wrench.link, wrench.point), (1, Vector3::new(0.1, 0.0, 0.0)));
            assert_close(wrench.moment.x, -wrench.force.z / 8.0, 1e-12);
            wrench.force.z
        })
    };
    for (t, share) in
        [(0.0, 0.0), (0.199, 0.0), (0.25, 0.5), (0.3, 1.0), (0.35, 1.0), (0.45, 0.5), (0.501, 0.0), (9.0, 0.0)]
    {
        assert_close(force("", t), -8.0 * share, 1e-9);
        for k in [0.0, 1.0, 7.0] {
            assert_close(force(", every = 2.0", t.min(1.0) + 2.0 * k), -8.0 * share, 1e-9);
        }
    }
    // It moves the arm by its Jacobian's torque; that is `a_wrench_gives_the_torque_of_its_jacobian`. Nothing before and after.
    let truth = truth(&format!("effect = [{{ {effect} }}]"));
    for (state, exact) in run(&truth, 700) {
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, &exact);
        let size = left[0].abs() + left[1].abs();
        assert_eq!(size > 1e-9, state.time > 0.2 && state.time < 0.5, "{size} Nm at {} s", state.time);
        assert_close(left[2], 0.0, 1e-9);
    }
}

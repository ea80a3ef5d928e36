//! Effects of the sensors, which change readings and not the arm.

use super::*;

/// Runs the arm with effects that only report something else: its true motion is that of the plain arm, bit by bit.
fn reported(effects: &str, ticks: usize) -> Vec<(State, Exact)> {
    let states = run(&truth(&format!("effect = [{effects}]")), ticks);
    for (with, without) in states.iter().zip(run(&truth(""), ticks)) {
        assert_eq!(with.1, without.1);
    }
    states
}

#[test]
fn gain_and_offset_act_in_their_order() {
    let gain = "{ id = 'torque-gain', joint = 2, gain = 1.03 }";
    let offset = "{ id = 'torque-offset', joint = 2, offset = 0.5 }";
    for (state, exact) in reported(&format!("{gain}, {offset}"), 200) {
        assert_close(state.tau[1], 1.03 * exact.tau[1] + 0.5, 1e-12);
        assert_eq!([state.tau[0], state.tau[2]], [exact.tau[0], exact.tau[2]]);
    }
    for (state, exact) in reported(&format!("{offset}, {gain}"), 200) {
        assert_close(state.tau[1], 1.03 * (exact.tau[1] + 0.5), 1e-12);
    }
}

#[test]
fn an_offset_drifts_from_its_onset_on() {
    let warm = "{ id = 'offset-drift', joint = 3, drift = 0.5, time = 0.3, from = 0.1 }";
    let steady = "{ id = 'offset-drift', joint = 1, drift = -0.2, time = 0.3, trend = 'linear' }";
    for (state, exact) in reported(&format!("{warm}, {steady}"), 900) {
        let course = if state.time < 0.1 { 0.0 } else { 1.0 - (-(state.time - 0.1) / 0.3).exp() };
        assert_close(state.tau[2] - exact.tau[2], 0.5 * course, 1e-12);
        assert_close(state.tau[0] - exact.tau[0], -0.2 * state.time / 0.3, 1e-12);
    }
}

#[test]
fn crosstalk_adds_a_share_of_the_other_joints_torque() {
    for (state, exact) in reported("{ id = 'torque-crosstalk', joint = 1, other = 2, share = -0.02 }", 200) {
        assert_close(state.tau[0], exact.tau[0] - 0.02 * exact.tau[1], 1e-12);
        assert_eq!(state.tau[1..], exact.tau[1..]);
    }
}

#[test]
fn a_sensor_ripple_follows_its_law() {
    for (state, exact) in reported("{ id = 'position-ripple', joint = 1, order = 40, sine = 0.2, cosine = -0.1 }", 400)
    {
        let angle = 40.0 * exact.q[0];
        assert_close(state.tau[0] - exact.tau[0], 0.2 * angle.sin() - 0.1 * angle.cos(), 1e-12);
    }
}

/// A whole number of milliseconds is exact; a fraction equals Neville's scheme over six neighbours.
#[test]
fn a_delayed_torque_is_an_earlier_one() {
    let states = reported("{ id = 'delay', delay = 0.003 }", 300);
    for k in 3..300 {
        (0..N).for_each(|j| assert_close(states[k].0.tau[j], states[k - 3].1.tau[j], 1e-12));
        assert_eq!(states[k].0.q[..N], states[k].1.q[..N], "positions come at once");
    }
    assert_close(states[1].0.tau[1], states[0].1.tau[1], 1e-12);
    for (delay, joint) in [(2.35, ", joint = 1"), (0.4, "")] {
        let states = reported(&format!("{{ id = 'delay', delay = {}{joint} }}", delay * 1e-3), 300);
        let mut moved = 0.0f64;
        for k in 20..290 {
            let mut table: [f64; 6] = std::array::from_fn(|i| states[k + 2 - i].1.tau[0]);
            for width in 1..6 {
                for i in 0..6 - width {
                    let (left, right) = (i as f64 - 2.0 - delay, (i + width) as f64 - 2.0 - delay);
                    table[i] = (right * table[i] - left * table[i + 1]) / (right - left);
                }
            }
            assert_close(states[k].0.tau[0], table[0], 2e-3);
            moved = moved.max((states[k].0.tau[0] - states[k].1.tau[0]).abs());
            let other = if joint.is_empty() { states[k].0.tau[1] != states[k].1.tau[1] } else { false };
            assert_eq!(other, joint.is_empty());
        }
        assert!(moved > 0.005, "{moved} Nm");
    }
}

#[test]
fn encoder_offset_and_eccentricity_change_position_and_velocity() {
    let effects = "effect = [{ id = 'encoder-offset', joint = 3, offset = -0.004 },
        { id = 'encoder-eccentricity', joint = 1, amplitude = 0.003, phase = 0.7, order = 2 }]";
    let states = run(&truth(effects), 900);
    for (k, (state, exact)) in states.iter().enumerate() {
        assert_close(state.q[2], exact.q[2] - 0.004, 1e-15);
        assert_close(state.q[0], exact.q[0] + 0.003 * (2.0 * exact.q[0] + 0.7).sin(), 1e-15);
        // The reported velocity is that of the reported position.
        if (1..899).contains(&k) {
            let slope = (states[k + 1].0.q[0] - states[k - 1].0.q[0]) / 2e-3;
            assert_close(state.dq[0], slope, 2e-3);
        }
    }
    let off = |j: usize, k: usize| states[k].1.q[j] - states[k].0.q_d[j];
    assert!((off(2, 899) - 0.004).abs() < 1e-3, "the arm stands where its encoder says: {}", off(2, 899));
}

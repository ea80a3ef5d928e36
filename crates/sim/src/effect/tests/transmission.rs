//! Deflections of transmissions: the encoder on the motor's side measures the twist.

use super::*;

/// Measured deflection of `joint`, and the law's value at the measured torque. Checks the velocities, too.
fn deflections(effects: &str, joint: usize, law: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    let truth = truth(&format!("effect = [{effects}]"));
    let states = run(&truth, 900);
    for (_, exact) in &states {
        // What the sensor measures is still what moves the links: nothing is lost in between.
        let left = left(&truth, &truth.link_parameters(), Mounting::UPRIGHT, exact);
        (0..N).for_each(|j| assert_close(left[j], 0.0, 1e-9));
    }
    for k in 101..899 {
        let slope = (states[k + 1].0.q[joint] - states[k - 1].0.q[joint]) / 2e-3;
        assert_close(states[k].0.dq[joint], slope, 0.02);
    }
    states[100..].iter().map(|(state, exact)| (state.q[joint] - exact.q[joint], law(exact.tau[joint]))).collect()
}

#[test]
fn an_elastic_joint_twists_by_torque_over_stiffness() {
    let points = deflections("{ id = 'joint-elasticity', joint = 2, stiffness = 8000 }", 1, |tau| tau / 8000.0);
    let most = points.iter().fold(0.0f64, |most, (found, expected)| {
        assert_close(*found, *expected, 2e-5);
        most.max(expected.abs())
    });
    assert!(most > 5e-4, "{most} rad");
}

/// The stiffer, the less it is there; in the limit it is the rigid arm.
#[test]
fn a_stiff_joint_is_a_rigid_one() {
    let rigid = run(&truth(""), 500);
    let apart = |stiffness: f64| {
        let effect = format!("effect = [{{ id = 'joint-elasticity', joint = 2, stiffness = {stiffness} }}]");
        let states = run(&truth(&effect), 500);
        let pairs = states.iter().zip(&rigid).skip(100);
        pairs.map(|(a, b)| (a.1.q[1] - b.1.q[1]).abs()).fold(0.0, f64::max)
    };
    let [soft, stiff, hard] = [1e4, 1e6, 1e8].map(apart);
    assert!(soft > 1e-4 && stiff < 0.02 * soft && hard < 1e-3 * soft, "{soft} {stiff} {hard}");
}

/// The gap lies on the flank of the torque's sign; joint 1 carries no gravity, so its torque changes sign often.
#[test]
fn play_lies_on_the_flank_of_the_load() {
    let law = |tau: f64| 0.001 * (tau / 0.3).tanh();
    let points = deflections("{ id = 'backlash', joint = 1, gap = 0.002, load = 0.3 }", 0, law);
    let on_flank = points.iter().filter(|(_, expected)| expected.abs() > 0.95e-3);
    let (mut above, mut below) = (0, 0);
    for (found, expected) in on_flank {
        // Within a step of the integration after the crossing.
        if (found - expected).abs() < 2e-5 {
            if *found > 0.0 { above += 1 } else { below += 1 }
        }
    }
    assert!(above > 50 && below > 50, "{above} above, {below} below");
    let rms =
        (points.iter().map(|(found, expected)| (found - expected).powi(2)).sum::<f64>() / points.len() as f64).sqrt();
    assert!(rms < 5e-5, "{rms} rad");
}

/// An encoder's own error in front does not change what the transmission does, wherever it is written.
#[test]
fn deflections_act_last() {
    let elasticity = "{ id = 'joint-elasticity', joint = 2, stiffness = 8000 }";
    let offset = "{ id = 'encoder-offset', joint = 2, offset = 0.003 }";
    let one = run(&truth(&format!("effect = [{elasticity}, {offset}]")), 400);
    let other = run(&truth(&format!("effect = [{offset}, {elasticity}]")), 400);
    assert_eq!(one, other);
    for (state, exact) in &one[300..] {
        assert_close(state.q[1] - exact.q[1], 0.003 + exact.tau[1] / 8000.0, 2e-5);
    }
}

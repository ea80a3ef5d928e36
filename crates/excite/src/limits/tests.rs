use super::*;
use plumbline_model::{Capsule, Joint, JointKind, Placement, Robot};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Three revolute joints with parallel axes; the last two are 0.5 m out.
fn three_links() -> Chain {
    let joint = |a: f64| Joint { kind: JointKind::Revolute, a, alpha: 0.0, d: 0.0, theta: 0.0 };
    Chain::modified(vec![joint(0.0), joint(0.5), joint(0.0)], Placement::identity())
}

/// One revolute joint about z with the end effector 0.5 m out along x.
fn pendulum() -> Chain {
    let joint = Joint { kind: JointKind::Revolute, a: 0.0, alpha: 0.0, d: 0.0, theta: 0.0 };
    let mut flange = Placement::identity();
    flange.origin.x = 0.5;
    Chain::modified(vec![joint], flange)
}

fn limits() -> Limits {
    let all = |x: f64| [x; MAX_JOINTS];
    Limits {
        q_min: all(-1.0),
        q_max: all(1.0),
        dq: all(2.0),
        ddq: all(5.0),
        jerk: all(50.0),
        tau: all(10.0),
        dtau: all(100.0),
    }
}

fn sine(amplitude: f64) -> Fourier {
    let mut fourier = Fourier::still(2.0, vec![0.0], 1).unwrap();
    fourier.a[(0, 0)] = amplitude;
    fourier
}

#[test]
fn peaks_of_a_sine_are_exact() {
    let (chain, limits) = (pendulum(), limits());
    let margins = Margins::default();
    let bounds = Bounds::new(&chain, &limits, margins);
    let tau = |q: &JointVec, _: &JointVec, ddq: &JointVec| {
        let mut tau = [0.0; MAX_JOINTS];
        tau[0] = 2.0 * ddq[0] + 3.0 * q[0].sin();
        tau
    };
    let check = verify(&bounds, &sine(0.5), Some(&tau));
    let w = std::f64::consts::PI;
    let value = |quantity| check.peaks.iter().find(|p| p.quantity == quantity).unwrap().value;
    assert!((value(Quantity::PositionMax) - 0.5).abs() < 1e-9);
    assert!((value(Quantity::PositionMin) + 0.5).abs() < 1e-9);
    assert!((value(Quantity::Velocity) - 0.5 * w).abs() < 1e-9);
    assert!((value(Quantity::Acceleration) - 0.5 * w * w).abs() < 1e-9);
    assert!((value(Quantity::Jerk) - 0.5 * w * w * w).abs() < 1e-9);
    // At the turning point: 2 * 0.5 w^2 - 3 sin 0.5.
    assert!((value(Quantity::Torque) - (w * w - 3.0 * 0.5_f64.sin())).abs() < 1e-6);
    assert!((value(Quantity::TorqueRate) - (0.5 * w * (2.0 * w * w - 3.0))).abs() < 1e-3);
    assert_eq!(check.violations().map(|p| p.quantity).collect::<Vec<_>>(), [Quantity::Acceleration]);
}

#[test]
fn a_violation_is_described_by_joint_time_value_and_limit() {
    let (chain, limits) = (pendulum(), limits());
    let bounds = Bounds::new(&chain, &limits, Margins::default());
    let check = verify(&bounds, &sine(0.98), None);
    let text = check.violations().next().unwrap().to_string();
    assert_eq!(text, "joint 1 position -0.9800 rad at 1.500 s, expected at least -0.9500 rad");
}

#[test]
fn the_end_effector_is_checked_against_box_and_sphere() {
    let (chain, limits) = (pendulum(), limits());
    let space =
        |y: f64, radius: f64| Workspace { box_min: [-1.0, -y, -1.0], box_max: [1.0, y, 1.0], base_radius: radius };
    let violated = |workspace: Workspace| {
        let bounds = Bounds { workspace: Some(&workspace), ..Bounds::new(&chain, &limits, Margins::default()) };
        verify(&bounds, &sine(0.3), None).violations().map(|p| p.quantity).collect::<Vec<_>>()
    };
    assert_eq!(violated(space(0.2, 0.3)), []);
    assert_eq!(violated(space(0.15, 0.3)), [Quantity::BoxMin(1), Quantity::BoxMax(1)]);
    assert_eq!(violated(space(0.2, 0.49)), [Quantity::BaseSphere]);
}

#[test]
fn link_surfaces_are_checked_against_the_box_and_each_other() {
    let (chain, limits) = (three_links(), limits());
    let capsule = |link, length| Capsule { link, from: [0.0; 3], to: [length, 0.0, 0.0], radius: 0.05 };
    let shape = Shape::new(
        vec![Capsule { to: [0.0, 0.0, 0.2], ..capsule(0, 0.0) }, capsule(1, 0.5), capsule(3, 0.4)],
        &[[1, 3]],
    );
    // Folded until the tip of link 3, at x = 0.5 + 0.4 cos q2, y = 0.4 sin q2, comes near the base.
    let mut fourier = Fourier::still(2.0, vec![0.0, 2.6, 0.0], 1).unwrap();
    fourier.a[(1, 0)] = 0.2;
    let wide: Limits = Limits { q_max: [3.0; MAX_JOINTS], ..limits };
    let workspace = Workspace { box_min: [-1.0, -0.2, -1.0], box_max: [1.0, 1.0, 1.0], base_radius: 0.0 };
    let bounds = Bounds {
        workspace: Some(&workspace),
        shape: Some(&shape),
        links_in_box: true,
        ..Bounds::new(&chain, &wide, Margins { clearance: 0.04, ..Margins::default() })
    };
    let check = verify(&bounds, &fourier, None);
    let peak = |quantity| *check.peaks.iter().find(|p| p.quantity == quantity).unwrap();
    // Nearest at q2 = 2.8, when the tip is 0.5 + 0.4 cos 2.8 = 0.1231 and 0.1340 away.
    let clearance = peak(Quantity::Clearance(0, 3));
    let tip = (0.5 + 0.4 * 2.8_f64.cos(), 0.4 * 2.8_f64.sin());
    assert!((clearance.value - (tip.0.hypot(tip.1) - 0.1)).abs() < 1e-9, "{clearance}");
    assert!(!clearance.is_violation());
    let side = peak(Quantity::LinkBoxMin(1));
    assert!((side.value + 0.05).abs() < 1e-9 && side.joint == Some(3), "{side}");
    // Without `links_in_box` the box applies to the end effector only.
    let free = verify(&Bounds { links_in_box: false, ..bounds }, &fourier, None);
    assert!(free.peaks.iter().all(|p| !matches!(p.quantity, Quantity::LinkBoxMin(_) | Quantity::LinkBoxMax(_))));
    let near = Bounds { margins: Margins { clearance: 0.09, ..bounds.margins }, ..bounds };
    let text = verify(&near, &fourier, None).violations().next().unwrap().to_string();
    assert!(
        text.starts_with("distance of link 3 from the base 0.0820 m at 0.500 s, expected at least 0.0900"),
        "{text}"
    );
    assert_eq!(check_pose(&near, &[0.0, 2.8, 0.0]).violations().count(), 1);
    assert!(check_pose(&near, &[0.0, 2.0, 0.0]).is_feasible());
}

#[test]
fn the_speed_limit_falls_towards_the_end_of_the_range() {
    let (chain, limits) = (pendulum(), limits());
    let envelope = SpeedEnvelope { offset: [0.2; MAX_JOINTS], deceleration: [2.0; MAX_JOINTS] };
    let margins = Margins { velocity: 0.5, ..Margins::default() };
    let bounds = Bounds { envelope: Some(&envelope), ..Bounds::new(&chain, &limits, margins) };
    let near = |one: [f64; 2], other: [f64; 2]| (0..2).all(|i| (one[i] - other[i]).abs() < 1e-12);
    // Upwards at q = 0.9: sqrt(2 * 2 * 0.1) - 0.2; downwards the full 2 rad/s.
    assert!(near(bounds.speeds(0, 0.9), [1.0, 0.5 * (0.4_f64.sqrt() - 0.2)]));
    assert!(near(bounds.speeds(0, 0.999), [1.0, 0.0]));
    assert!(near(bounds.speeds(0, 0.0), [0.9, 0.9]));
    let h = 1e-6;
    for room in [0.05, 0.4, 3.0] {
        let difference = (envelope.at(0, room + h, 2.0).0 - envelope.at(0, room - h, 2.0).0) / (2.0 * h);
        assert!((envelope.at(0, room, 2.0).1 - difference).abs() < 1e-6);
    }
    // The sine's peak speed is 0.3 pi = 0.94, allowed in the middle; it is too fast for a joint that is shifted to the end.
    assert!(
        verify(&Bounds { margins: Margins { velocity: 1.0, ..margins }, ..bounds }, &sine(0.3), None).is_feasible()
    );
    let mut high = sine(0.3);
    high.q0[0] = 0.6;
    let check = verify(&Bounds { margins: Margins { velocity: 1.0, ..margins }, ..bounds }, &high, None);
    assert_eq!(check.violations().map(|p| p.quantity).collect::<Vec<_>>(), [Quantity::Velocity]);
}

#[test]
fn a_motion_with_nan_is_not_feasible() {
    let (chain, limits) = (pendulum(), limits());
    let bounds = Bounds::new(&chain, &limits, Margins::default());
    let mut motion = sine(0.1);
    motion.a[(0, 0)] = f64::NAN;
    assert!(!verify(&bounds, &motion, None).is_feasible());
}

/// More than a fifth of random poses within the joint limits satisfy workspace and clearances.
#[test]
fn the_workspace_of_every_shipped_robot_contains_poses() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for name in Robot::names() {
        let Robot { chain, limits, workspace, shape, .. } = Robot::load(name, None).unwrap();
        assert!(!shape.pairs().is_empty(), "{name} has no bodies");
        let bounds = Bounds {
            workspace: Some(&workspace),
            shape: Some(&shape),
            ..Bounds::new(&chain, &limits, Margins::default())
        };
        let free = |_: &usize| {
            let q: Vec<f64> = (0..chain.len()).map(|j| rng.random_range(limits.q_min[j]..limits.q_max[j])).collect();
            check_pose(&bounds, &q).is_feasible()
        };
        let share = (0..1000).filter(free).count() as f64 / 1000.0;
        assert!(share > 0.2, "{name}: {share}");
    }
}

//! Dynamics and kinematics as identities between two routes.

use nalgebra::{DMatrix, DVector, Matrix4, RowVector4, Vector3};
use plumbline_model::{Chain, G, Joint, JointKind, LINK_COLUMNS, Mounting, Placement, StandardDh, regressor};
use plumbline_testkit::arms::{all, any_mounting, chain, draw, random_chain, torque};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn newton_euler_is_regressor_times_parameters() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let named = all().into_iter().map(|(_, chain)| chain);
    let random: Vec<Chain> = (0..60).map(|_| random_chain(&mut rng)).collect();
    for chain in named.chain(random) {
        let n = chain.len();
        let mut y = DMatrix::zeros(n, n * LINK_COLUMNS);
        for _ in 0..20 {
            let delta = draw(&mut rng, n * LINK_COLUMNS, 2.0);
            let gravity = any_mounting(&mut rng).gravity();
            let (q, dq, ddq) = (draw(&mut rng, n, 3.0), draw(&mut rng, n, 3.0), draw(&mut rng, n, 10.0));
            regressor(&chain, &gravity, &q, &dq, &ddq, &mut y);
            let recursive = torque(&chain, &delta, &gravity, &q, &dq, &ddq);
            let difference = (&y * DVector::from_vec(delta) - &recursive).amax();
            assert!(difference < 1e-11 * recursive.amax().max(1.0), "{difference:e}");
        }
    }
}

#[test]
fn a_pendulum_on_a_wall_is_the_textbook_one() {
    let joint = Joint { kind: JointKind::Revolute, a: 0.0, alpha: 0.0, d: 0.4, theta: 0.0 };
    let pendulum = Chain::modified(vec![joint], Placement::identity());
    let (m, l, q, dq, ddq) = (2.0, 0.3, 0.7, 1.1, -2.3);
    let delta = [0.0, 0.0, 0.0, 0.0, 0.0, m * l * l, m * l, 0.0, 0.0, m];
    // Base x points down: the angle from hanging is q.
    let tau = torque(&pendulum, &delta, &Mounting::WALL.gravity(), &[q], &[dq], &[ddq]);
    assert!((tau[0] - (m * l * l * ddq + m * G * l * q.sin())).abs() < 1e-12);
    // Upright, axis 1 carries no weight.
    let tau = torque(&pendulum, &delta, &Mounting::UPRIGHT.gravity(), &[q], &[dq], &[ddq]);
    assert!((tau[0] - m * l * l * ddq).abs() < 1e-12);
}

#[test]
fn a_prismatic_joint_lifts_its_weight() {
    let joint = Joint { kind: JointKind::Prismatic, a: 0.0, alpha: 0.0, d: 0.0, theta: 0.0 };
    let lift = Chain::modified(vec![joint], Placement::identity());
    let mut delta = [0.0; 10];
    delta[9] = 3.0;
    let tau = torque(&lift, &delta, &Mounting::UPRIGHT.gravity(), &[0.1], &[0.5], &[2.0]);
    assert!((tau[0] - 3.0 * (G + 2.0)).abs() < 1e-12);
}

#[test]
fn holding_torque_of_axis_1_is_the_papers_equation_8() {
    let panda = chain("panda");
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..50 {
        let mounting = any_mounting(&mut rng);
        let (lx1, ly1) = (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        let mut delta = vec![0.0; 70];
        (delta[6], delta[7]) = (lx1, ly1);
        let q = draw(&mut rng, 7, 3.0);
        let tau = torque(&panda, &delta, &mounting.gravity(), &q, &[0.0; 7], &[0.0; 7]);
        let (sp, cp) = mounting.phi.sin_cos();
        let (s1, c1) = q[0].sin_cos();
        let expected = G * mounting.rho.sin() * (lx1 * (cp * s1 - sp * c1) + ly1 * (cp * c1 + sp * s1));
        assert!((tau[0] - expected).abs() < 1e-12);
        assert!(tau.rows(1, 6).amax() < 1e-12);
    }
}

/// Power into the arm is the rate of its energy: kinetic from the mass matrix, potential from the positions of the masses.
#[test]
fn power_is_the_rate_of_energy() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (name, chain) in all() {
        let n = chain.len();
        let gravity = any_mounting(&mut rng).gravity();
        let delta: Vec<f64> = (0..n).flat_map(|_| physical_link(&mut rng)).collect();
        let (amplitude, phase) = (draw(&mut rng, n, 1.0), draw(&mut rng, n, 3.0));
        let at = |t: f64| {
            let all = |f: &dyn Fn(f64, f64) -> f64| {
                (0..n).map(|j| amplitude[j] * f(1.0 + j as f64 * 0.3, phase[j])).collect()
            };
            let q: Vec<f64> = all(&|w, p| (w * t + p).sin());
            let dq: Vec<f64> = all(&|w, p| w * (w * t + p).cos());
            let ddq: Vec<f64> = all(&|w, p| -w * w * (w * t + p).sin());
            (q, dq, ddq)
        };
        let energy = |t: f64| {
            let (q, dq, _) = at(t);
            // M(q) dq is the torque of the acceleration dq at rest without gravity.
            let momentum = torque(&chain, &delta, &Vector3::zeros(), &q, &vec![0.0; n], &dq);
            let kinetic = 0.5 * momentum.dot(&DVector::from_vec(dq));
            let mut placement = Placement::identity();
            let mut potential = 0.0;
            for i in 0..n {
                placement = placement.then(&chain.joints()[i].placement(q[i]));
                let first = Vector3::from_row_slice(&delta[10 * i + 6..10 * i + 9]);
                potential -= gravity.dot(&(placement.rotation * first + placement.origin * delta[10 * i + 9]));
            }
            kinetic + potential
        };
        for t in [0.3, 1.7, 4.1] {
            let (q, dq, ddq) = at(t);
            let power = torque(&chain, &delta, &gravity, &q, &dq, &ddq).dot(&DVector::from_vec(dq));
            let h = 1e-4;
            let rate =
                (8.0 * (energy(t + h) - energy(t - h)) - (energy(t + 2.0 * h) - energy(t - 2.0 * h))) / (12.0 * h);
            assert!((power - rate).abs() < 1e-6 * power.abs().max(1.0), "{name} at {t}: {power} {rate}");
        }
    }
}

#[test]
fn standard_rows_give_the_standard_product() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..100 {
        let n = rng.random_range(1..=8);
        let rows: Vec<StandardDh> = (0..n)
            .map(|_| {
                let kind = if rng.random_bool(0.3) { JointKind::Prismatic } else { JointKind::Revolute };
                let [a, alpha, d, theta] = [(); 4].map(|()| rng.random_range(-2.0..2.0));
                StandardDh { kind, a, alpha, d, theta }
            })
            .collect();
        let q = draw(&mut rng, n, 3.0);
        let mut product = Matrix4::identity();
        for (row, q) in rows.iter().zip(&q) {
            let (theta, d) = match row.kind {
                JointKind::Revolute => (row.theta + q, row.d),
                JointKind::Prismatic => (row.theta, row.d + q),
            };
            let ((st, ct), (sa, ca)) = (theta.sin_cos(), row.alpha.sin_cos());
            // The table's textbook matrix, Rz Tz Tx Rx multiplied out.
            product *= Matrix4::from_rows(&[
                RowVector4::new(ct, -st * ca, st * sa, row.a * ct),
                RowVector4::new(st, ct * ca, -ct * sa, row.a * st),
                RowVector4::new(0.0, sa, ca, d),
                RowVector4::new(0.0, 0.0, 0.0, 1.0),
            ]);
        }
        let end = Chain::standard(&rows, Placement::identity()).end_effector_placement(&q);
        assert!((product.fixed_view::<3, 3>(0, 0) - end.rotation).amax() < 1e-12);
        assert!((product.fixed_view::<3, 1>(0, 3) - end.origin).amax() < 1e-12);
    }
}

/// The Panda's rows in both conventions are one arm: same kinematics, and same torques for the same link parameters.
#[test]
fn both_conventions_describe_one_arm() {
    let modified = chain("panda");
    let joints = modified.joints();
    let rows: Vec<StandardDh> = (0..7)
        .map(|i| {
            let (a, alpha) = joints.get(i + 1).map_or((0.0, 0.0), |next| (next.a, next.alpha));
            StandardDh { kind: joints[i].kind, a, alpha, d: joints[i].d, theta: joints[i].theta }
        })
        .collect();
    assert_eq!(Chain::standard(&rows, *modified.flange()), modified);
}

/// Mass, center and a consistent inertia, about the frame's origin.
fn physical_link(rng: &mut ChaCha8Rng) -> [f64; 10] {
    let mut link = [0.0; 10];
    for _ in 0..5 {
        let m = rng.random_range(0.2..2.0);
        let [x, y, z] = [(); 3].map(|()| rng.random_range(-0.3..0.3));
        let point = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y, x, y, z, 1.0];
        for (sum, value) in link.iter_mut().zip(point) {
            *sum += m * value;
        }
    }
    link
}

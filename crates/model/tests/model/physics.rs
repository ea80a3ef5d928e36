//! Columns of effects against their laws, and against the rigid body under the same disturbance.

use crate::models::{columns, effect, model_within, operating_point, rigid_model, smooth_motion};
use nalgebra::{DMatrix, DVector, Rotation3, Unit, Vector3};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{OperatingPoint, Site, Spec};
use plumbline_model::term::mounting::{ABOUT_A_TILT, axes};
use plumbline_model::{Mounting, Placement, TorqueModel};
use plumbline_testkit::arms::{chain, draw, torque};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Columns of gain and cross-talk are the rigid-body torque of a joint; those of all that a sensor shows have friction and rotor beside it.
#[test]
fn gains_are_shares_of_the_rigid_bodys_torque() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for robot in ["panda", "paper-2dof", "scara"] {
        let model = rigid_model(robot, &mut rng);
        let motion = smooth_motion(&mut rng, model.structure().chain().len(), false, 1000);
        let load = load(&model, &motion);
        for (family, site, row) in
            [("torque-gain", Site::Joint(1), 1), ("torque-crosstalk", Site::Pair { row: 0, cause: 1 }, 0)]
        {
            let found = column_of(&operating_point(&model), &effect(family, "", site, &[]), &motion, 0);
            let mut expected = DMatrix::zeros(load.nrows(), load.ncols());
            expected.set_column(row, &load.column(1));
            assert!((found - expected).amax() < 1e-11 * load.amax(), "{family} of {robot}");
        }
        let operating_point = with_rotors(&model);
        let spec = effect("torque-crosstalk", "whole", Site::Pair { row: 0, cause: 1 }, &[]);
        let mut left = column_of(&operating_point, &spec, &motion, 0);
        let expected = with_drive(&load, &operating_point, &motion, 1);
        assert!((left.column(0) - &expected).amax() < 1e-11 * expected.amax(), "{robot}");
        left.fill_column(0, 0.0);
        assert_eq!(left.amax(), 0.0, "{robot}");
    }
}

/// A model whose torques contain rotors that are parameters of their own.
fn with_rotors(model: &TorqueModel) -> OperatingPoint {
    let joints = model.structure().chain().len();
    OperatingPoint { rotor_inertias: (0..joints).map(|j| 0.3 + 0.1 * j as f64).collect(), ..operating_point(model) }
}

/// Rigid-body torque, N x n, friction and rotor of one joint together \[Nm\].
fn with_drive(torque: &DMatrix<f64>, operating_point: &OperatingPoint, motion: &Motion, joint: usize) -> DVector<f64> {
    with_friction(torque, operating_point, motion, joint)
        + operating_point.rotor_inertias[joint] * motion.ddq.column(joint)
}

/// Laws by hand, at one sample each.
#[test]
fn laws_are_what_their_equations_say() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let model = rigid_model("panda", &mut rng);
    let operating_point = operating_point(&model);
    let motion = smooth_motion(&mut rng, 7, false, 1000);
    let (j, k) = (3, 2);
    let at = |matrix: &DMatrix<f64>, joint: usize, sample: usize| matrix[(sample, joint)];
    let sign = |dq: f64| (100.0 * dq).tanh();
    type Law<'a> = &'a dyn Fn(f64, f64, usize) -> Vec<f64>;
    let pair = Site::Pair { row: j, cause: k };
    let one = Site::Joint(j);
    let other = |sample: usize| at(&motion.dq, k, sample);
    let minutes = |sample: usize| (12.0 + 4e-3 * sample as f64) / 60.0;
    let cases: [(&str, &str, Site, &[f64], Law); 16] = [
        ("asymmetric-coulomb", "", one, &[], &|_, dq, _| vec![sign(dq).abs()]),
        ("asymmetric-viscous", "", one, &[], &|_, dq, _| vec![dq.abs()]),
        ("stribeck", "gaussian", one, &[0.1], &|_, dq, _| vec![(-dq * dq / 0.01).exp() * sign(dq)]),
        ("coulomb-slope", "tanh", one, &[0.03], &|_, dq, _| vec![(dq / 0.03).tanh() - sign(dq)]),
        ("coulomb-slope", "steep", one, &[0.004], &|_, dq, _| vec![(dq / 0.004).tanh() - sign(dq)]),
        ("coulomb-slope", "arctan", one, &[0.02], &|_, dq, _| {
            vec![(dq / 0.02).atan() / std::f64::consts::FRAC_PI_2 - sign(dq)]
        }),
        ("nonlinear-viscous", "sigmoid", one, &[0.2], &|_, dq, _| vec![(dq / 0.2).tanh()]),
        ("nonlinear-viscous", "cubic", one, &[], &|_, dq, _| vec![dq * dq * dq]),
        ("nonlinear-viscous", "quadratic", one, &[], &|_, dq, _| vec![dq * dq.abs()]),
        ("nonlinear-viscous", "power", one, &[0.4], &|_, dq, _| vec![dq.signum() * dq.abs().powf(0.4)]),
        ("position-ripple", "", one, &[7.5], &|q, _, _| vec![(7.5 * q).sin(), (7.5 * q).cos()]),
        ("spring", "cubic", one, &[], &|q, _, _| vec![q, 1.0, q * q * q]),
        ("spring", "above", one, &[0.2], &|q, _, _| vec![if q > 0.2 { q - 0.2 } else { 0.0 }]),
        ("spring", "below", one, &[0.2], &|q, _, _| vec![if q < 0.2 { 0.2 - q } else { 0.0 }]),
        ("transmission-coupling", "friction", pair, &[], &|_, _, s| vec![sign(other(s)), other(s)]),
        ("friction-drift", "linear", one, &[], &|_, dq, s| vec![minutes(s) * sign(dq), minutes(s) * dq]),
    ];
    for (family, form, site, settings, law) in cases {
        let spec = effect(family, form, site, settings);
        let own = columns(&operating_point, &spec, &motion);
        for sample in (0..motion.samples()).step_by(37) {
            let expected = law(at(&motion.q, j, sample), at(&motion.dq, j, sample), sample);
            assert_eq!(own.ncols(), expected.len(), "{spec:?}");
            for (c, expected) in expected.iter().enumerate() {
                let found = own[(j * motion.samples() + sample, c)];
                assert!((found - expected).abs() < 1e-12, "{spec:?} column {c}: {found} {expected}");
            }
        }
    }
}

/// Friction of a shaft that turns with `w = dq_j + r dq_k` brakes both joints: `tau_j dq_j + tau_k dq_k = f w >= 0`, and no other joint.
#[test]
fn friction_of_a_shaft_takes_its_power_from_both_joints() {
    let mut rng = ChaCha8Rng::seed_from_u64(72);
    let model = rigid_model("panda", &mut rng);
    let motion = smooth_motion(&mut rng, 7, false, 200);
    let (j, k, r) = (5, 3, -0.6_f64);
    let spec = effect("transmission-coupling", "sum", Site::Pair { row: j, cause: k }, &[r]);
    let torque = column_of(&operating_point(&model), &spec, &motion, 0);
    for sample in 0..motion.samples() {
        let w = motion.dq[(sample, j)] + r * motion.dq[(sample, k)];
        let f = (100.0_f64 * w).tanh();
        for joint in 0..7 {
            let expected = if joint == j {
                f
            } else if joint == k {
                r * f
            } else {
                0.0
            };
            assert!((torque[(sample, joint)] - expected).abs() < 1e-12, "joint {joint} {sample}");
        }
        let power: f64 = (0..7).map(|joint| torque[(sample, joint)] * motion.dq[(sample, joint)]).sum();
        assert!((power - f * w).abs() < 1e-9 && power >= 0.0, "{power} {f} {w}");
    }
}

/// The zero of joint 1 turns the arm about its first axis, as a tilt of the base does: in every mounting it is the same torque.
#[test]
fn the_zero_of_joint_1_is_a_tilt_about_axis_1() {
    let mut rng = ChaCha8Rng::seed_from_u64(73);
    for name in ["panda", "tx40"] {
        let model = rigid_model(name, &mut rng);
        let motion = smooth_motion(&mut rng, model.structure().chain().len(), false, 200);
        let operating_point = operating_point(&model);
        let zero = columns(&operating_point, &effect("encoder-offset", "", Site::Joint(0), &[]), &motion);
        let tilts = columns(&operating_point, &effect("mounting", "", Site::Arm, &[]), &motion);
        let turn = tilts.clone().svd(true, true).solve(&zero, 1e-12).unwrap();
        let rest = (&zero - &tilts * turn).norm() / zero.norm();
        assert!(rest < 1e-9 && zero.norm() > 1.0, "{name}: {rest} of {}", zero.norm());
    }
}

/// `tau_rb` along a motion by the regressor, N x n.
fn load(model: &TorqueModel, motion: &Motion) -> DMatrix<f64> {
    let rigid = model.structure().reduction().len();
    let beta = DVector::from_vec(model.beta()[..rigid].to_vec());
    let stacked = model.structure().regressor(motion).columns(0, rigid) * beta;
    DMatrix::from_column_slice(motion.samples(), motion.joints(), stacked.as_slice())
}

/// A column of an effect as N x n.
fn column_of(operating_point: &OperatingPoint, spec: &Spec, motion: &Motion, column: usize) -> DMatrix<f64> {
    let all = columns(operating_point, spec, motion);
    DMatrix::from_column_slice(motion.samples(), motion.joints(), all.column(column).clone_owned().as_slice())
}

/// First and second derivative of a periodic signal by central differences.
fn differences(signal: &[f64], dt: f64) -> (Vec<f64>, Vec<f64>) {
    let n = signal.len();
    let around = |k: usize| (signal[(k + n - 1) % n], signal[k], signal[(k + 1) % n]);
    let first = (0..n).map(|k| (around(k).2 - around(k).0) / (2.0 * dt));
    let second = (0..n).map(|k| (around(k).2 - 2.0 * around(k).1 + around(k).0) / (dt * dt));
    (first.collect(), second.collect())
}

/// `fv dq + fc tanh(100 dq)` of one joint \[Nm\].
fn friction(operating_point: &OperatingPoint, motion: &Motion, joint: usize) -> Vec<f64> {
    let [fv, fc] = operating_point.friction[joint];
    motion.dq.column(joint).iter().map(|dq| fv * dq + fc * (100.0 * dq).tanh()).collect()
}

/// Rigid-body torque, N x n, and friction of one joint together \[Nm\].
fn with_friction(
    torque: &DMatrix<f64>,
    operating_point: &OperatingPoint,
    motion: &Motion,
    joint: usize,
) -> DVector<f64> {
    torque.column(joint) + DVector::from_vec(friction(operating_point, motion, joint))
}

/// Effects of a position error are what the rigid body does on the motion that is really shifted.
#[test]
fn a_position_error_shifts_the_motion() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for robot in ["panda", "paper-2dof"] {
        // Small torques, so that a gap of a few Nm is wide against the steps of the motion.
        let model = model_within(robot, &mut rng, 0.02);
        let (operating_point, n) = (operating_point(&model), model.structure().chain().len());
        // Friction turns within milliseconds.
        let motion = smooth_motion(&mut rng, n, true, 40_000);
        let torque = load(&model, &motion);
        let i = rng.random_range(0..n);
        let q: Vec<f64> = motion.q.column(i).iter().copied().collect();
        let own: Vec<f64> = torque.column(i).iter().copied().collect();
        let through: Vec<f64> =
            own.iter().zip(&friction(&operating_point, &motion, i)).map(|(own, tau)| own + tau).collect();
        let width = (0.5 * torque.column(i).amax()).min(1.0);
        let twist = |load: &[f64]| load.iter().map(|tau| -tau).collect();
        let gap = |load: &[f64]| load.iter().map(|tau| -(tau / width).tanh()).collect();
        let cases = [
            ("encoder-offset", "", vec![], 0, vec![1.0; q.len()]),
            ("encoder-eccentricity", "", vec![], 0, q.iter().map(|q| q.sin()).collect()),
            ("encoder-eccentricity", "", vec![], 1, q.iter().map(|q| q.cos()).collect()),
            ("joint-elasticity", "", vec![], 0, twist(&own)),
            ("joint-elasticity", "link-friction", vec![], 0, twist(&through)),
            ("backlash", "", vec![width], 0, gap(&own)),
        ];
        for (id, form, settings, c, error) in cases {
            let spec = effect(id, form, Site::Joint(i), &settings);
            let found = column_of(&operating_point, &spec, &motion, c);
            let a = 1e-5;
            let (first, second) = differences(&error, motion.dt);
            let shifted = |a: f64| {
                let mut motion = motion.clone();
                for k in 0..motion.samples() {
                    motion.q[(k, i)] += a * error[k];
                    motion.dq[(k, i)] += a * first[k];
                    motion.ddq[(k, i)] += a * second[k];
                }
                load(&model, &motion)
            };
            let expected = (shifted(a) - shifted(-a)) / (2.0 * a);
            let (difference, scale) = ((&found - &expected).amax(), expected.amax());
            // Differences across the moments in which a joint turns, some ten samples, are coarse.
            let precision = if form.is_empty() { 2e-3 } else { 0.1 };
            assert!(
                scale > 1e-3 && difference < precision * scale,
                "{id} {form} of {robot}: {difference:e} of {scale:e}"
            );
        }
    }
}

/// What a swinging link adds to its joint's torque is what the rigid body and the friction on its side add where the link truly is, and that is where the
/// gear gives way to this torque.
#[test]
fn a_link_oscillates_on_its_gear() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let mut inertia = 0.0;
    // The last joint's inertia is a parameter of its own, and the only one that has to be positive here.
    while inertia < 0.01 {
        let model = model_within("panda", &mut rng, 0.1);
        let (operating_point, i) = (operating_point(&model), 6);
        let motion = smooth_motion(&mut rng, 7, true, 40_000);
        let torque = load(&model, &motion);
        let mut faster = motion.clone();
        faster.ddq.column_mut(i).add_scalar_mut(1.0);
        inertia = load(&model, &faster)[(0, i)] - torque[(0, i)];
        if inertia < 0.01 {
            continue;
        }
        // Flanks that are wide against the load: between sharp ones the link jumps.
        let width = (0.5 * torque.column(i).amax()).min(1.0);
        let (compliance, gap) = (5e-4, 5e-4 * width);
        let quality = 4.0;
        // Teeth give way, too.
        let teeth = 0.1 * compliance;
        let elastic = |resonance: &[f64]| ("joint-elasticity", [&[compliance], resonance].concat(), 0.0, compliance);
        let with_play = |resonance: &[f64]| ("backlash", [&[gap, width, teeth], resonance].concat(), gap, teeth);
        let (plain, with_rotor) = ([quality], [quality, 0.4]);
        let cases = [
            ("swinging", 0.0, elastic(&plain)),
            ("swinging", 0.0, with_play(&plain)),
            ("swinging-rotor", 0.4 * inertia, elastic(&with_rotor)),
            ("swinging-rotor", 0.4 * inertia, with_play(&with_rotor)),
        ];
        for (form, rotor, (id, settings, gap, compliance)) in cases {
            // The rotor is on the motor's side of the gear, which follows the encoder.
            let inertia = inertia - rotor;
            let of_rotor = |motion: &Motion, k: usize| rotor * motion.ddq[(k, i)];
            let size = settings[0];
            let twist = |tau: f64| gap * (tau / width).tanh() + compliance * tau;
            let slack = |tau: f64| gap / width * (1.0 - (tau / width).tanh().powi(2)) + compliance;
            let spec = effect(id, form, Site::Joint(i), &settings);
            let added = size * column_of(&operating_point, &spec, &motion, 0).column(i);
            let still = friction(&operating_point, &motion, i);
            let tau: Vec<f64> =
                (0..motion.samples()).map(|k| torque[(k, i)] + still[k] + added[k] - of_rotor(&motion, k)).collect();
            // theta = twist(tau - d dtheta), by the implicit Euler method and bisection: another way than the law's.
            // On a flank it is damped as the teeth are, between the flanks hardly.
            let mut theta = vec![0.0; motion.samples()];
            let mut elastic = 0.0;
            for k in 0..2 * motion.samples() {
                let (now, before) = (k % motion.samples(), theta[(k + motion.samples() - 1) % motion.samples()]);
                let damping = (inertia / slack(elastic)).sqrt() / quality;
                let (mut low, mut high) = (-0.1, 0.1);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    elastic = tau[now] - damping * (middle - before) / motion.dt;
                    if middle > twist(elastic) { high = middle } else { low = middle }
                }
                theta[now] = 0.5 * (low + high);
            }
            let (first, second) = differences(&theta, motion.dt);
            let mut there = motion.clone();
            for k in 0..motion.samples() {
                there.q[(k, i)] -= theta[k];
                there.dq[(k, i)] -= first[k];
                there.ddq[(k, i)] -= second[k];
            }
            let carried = with_friction(&load(&model, &there), &operating_point, &there, i);
            // The second half: how it swings at the beginning is no longer seen there.
            let half = motion.samples() / 2..motion.samples();
            let wrong = |k: usize| carried[k] - of_rotor(&there, k) - tau[k];
            let wrong = half.clone().map(|k| wrong(k).powi(2)).sum::<f64>().sqrt();
            let whole = half.map(|k| added[k].powi(2)).sum::<f64>().sqrt();
            assert!(wrong < 0.05 * whole, "{id} {form}: {wrong} of {whole}");
        }
    }
}

#[test]
fn a_delay_is_the_slope_of_the_torque() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let model = rigid_model("panda", &mut rng);
    let operating_point = with_rotors(&model);
    let motion = smooth_motion(&mut rng, 7, true, 40_000);
    let torque = load(&model, &motion);
    let spec = effect("delay", "", Site::Arm, &[]);
    let found = column_of(&operating_point, &spec, &motion, 0);
    for j in 0..7 {
        let whole = with_drive(&torque, &operating_point, &motion, j);
        let (slope, _) = differences(whole.as_slice(), motion.dt);
        let expected = -DVector::from_vec(slope);
        let (difference, scale) = ((found.column(j) - &expected).amax(), expected.amax());
        assert!(difference < 0.03 * scale, "joint {}: {difference:e} of {scale:e}", j + 1);
    }
}

/// In a motion of several shifts, whole and between samples: its torques are those of the same motion that began earlier.
#[test]
fn a_shifted_torque_is_that_of_an_earlier_time() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let model = rigid_model("panda", &mut rng);
    let operating_point = with_rotors(&model);
    let motion = smooth_motion(&mut rng, 7, true, 4000);
    let torque = load(&model, &motion);
    for shift in [0.003, 0.0165, 0.05] {
        let found = column_of(&operating_point, &effect("delay", "shifted", Site::Arm, &[shift]), &motion, 0);
        let late = |k: usize| (4000.0 + k as f64 - shift / motion.dt) % 4000.0;
        for j in 0..7 {
            let both = with_drive(&torque, &operating_point, &motion, j);
            let whole = |k: usize| both[k % 4000];
            let between = |at: f64| whole(at as usize) + at.fract() * (whole(at as usize + 1) - whole(at as usize));
            let expected = DVector::from_fn(4000, |k, _| between(late(k)) - whole(k)) / shift;
            let (difference, scale) = ((found.column(j) - &expected).amax(), expected.amax());
            assert!(difference < 1e-9 * scale, "{shift} s, joint {}: {difference:e} of {scale:e}", j + 1);
        }
    }
}

/// A tilt turns gravity about its axis; upright the axes are the base's x and y.
#[test]
fn a_tilt_turns_gravity() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let up = axes(&Mounting::UPRIGHT.gravity());
    assert!((up[0] - Vector3::x()).norm() < 1e-12 && (up[1] - Vector3::y()).norm() < 1e-12);
    let model = rigid_model("panda", &mut rng);
    for _ in 0..4 {
        let motion = smooth_motion(&mut rng, 7, false, 50);
        for (c, axis) in axes(&motion.gravity).into_iter().enumerate() {
            assert!(axis.dot(&motion.gravity).abs() < 1e-12 && (axis.norm() - 1.0).abs() < 1e-12);
            let spec = effect("mounting", "", Site::Arm, &[]);
            let found = column_of(&operating_point(&model), &spec, &motion, c);
            let tilted = |angle: f64| {
                let turn = Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle);
                load(&model, &Motion { gravity: turn * motion.gravity, ..motion.clone() })
            };
            let a = 1e-5;
            let expected = (tilted(a) - tilted(-a)) / (2.0 * a);
            assert!((found - &expected).amax() < 1e-7 * expected.amax());
        }
    }
}

/// About a tilt the two columns give exactly what that tilt does, however large it is.
#[test]
fn a_tilt_about_itself_is_exact() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let model = rigid_model("panda", &mut rng);
    for about in [[0.0, 0.0], [0.05, -0.02], [-0.9, 0.4], [2.0, 1.0]] {
        let motion = smooth_motion(&mut rng, 7, false, 50);
        let [a, b] = axes(&motion.gravity);
        let turn = Rotation3::new(about[0] * a + about[1] * b);
        let tilted = load(&model, &Motion { gravity: turn * motion.gravity, ..motion.clone() });
        let spec = effect("mounting", ABOUT_A_TILT, Site::Arm, &about);
        let found = columns(&operating_point(&model), &spec, &motion) * DVector::from_row_slice(&about);
        let expected = tilted - load(&model, &motion);
        let difference = (0..7).map(|j| (found.rows(50 * j, 50) - expected.column(j)).amax()).fold(0.0, f64::max);
        assert!(difference < 1e-9, "{about:?}: {difference:e}");
    }
}

#[test]
fn base_motion_is_a_gravity_that_changes() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let model = rigid_model("panda", &mut rng);
    let motion = smooth_motion(&mut rng, 7, false, 50);
    let spec = effect("base-motion", "", Site::Arm, &[3.7]);
    let a = [0.3, -0.2, 0.5, 0.1, -0.4, 0.2];
    let found = columns(&operating_point(&model), &spec, &motion) * DVector::from_row_slice(&a);
    let still = load(&model, &motion);
    for k in 0..motion.samples() {
        let (sin, cos) = (std::f64::consts::TAU * 3.7 * (motion.start + k as f64 * motion.dt)).sin_cos();
        let shake = Vector3::new(a[0] * cos + a[1] * sin, a[2] * cos + a[3] * sin, a[4] * cos + a[5] * sin);
        let shaken = load(&model, &Motion { gravity: motion.gravity + shake, ..motion.clone() });
        for j in 0..7 {
            let expected = shaken[(k, j)] - still[(k, j)];
            assert!((found[j * motion.samples() + k] - expected).abs() < 1e-10);
        }
    }
}

/// A body on the last link is a last link with more in it; held still it is a force at that link, which contact has, too.
#[test]
fn a_payload_is_a_heavier_last_link_and_at_rest_a_contact() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    for robot in ["panda", "scara"] {
        let model = rigid_model(robot, &mut rng);
        let (chain, operating_point) = (chain(robot), operating_point(&model));
        let n = chain.len();
        let mut motion = smooth_motion(&mut rng, n, false, 30);
        let spec = effect("payload", "", Site::Arm, &[]);
        let (body, delta) = (draw(&mut rng, 10, 1.0), draw(&mut rng, 10 * n, 1.0));
        let found = columns(&operating_point, &spec, &motion) * DVector::from_row_slice(&body);
        let mut heavier = delta.clone();
        heavier[10 * (n - 1)..].iter_mut().zip(&body).for_each(|(own, more)| *own += more);
        for k in 0..motion.samples() {
            let row = |matrix: &DMatrix<f64>| matrix.row(k).iter().copied().collect::<Vec<f64>>();
            let (q, dq, ddq) = (row(&motion.q), row(&motion.dq), row(&motion.ddq));
            let difference = torque(&chain, &heavier, &motion.gravity, &q, &dq, &ddq)
                - torque(&chain, &delta, &motion.gravity, &q, &dq, &ddq);
            for j in 0..n {
                assert!((found[j * motion.samples() + k] - difference[j]).abs() < 1e-10);
            }
        }

        motion.dq.fill(0.0);
        motion.ddq.fill(0.0);
        let window = [motion.start, motion.start + 3.0];
        let touch = columns(&operating_point, &effect("contact", "", Site::Joint(n - 1), &window), &motion);
        // The arm holds a mass of 1 kg at the frame's origin, and a first moment of 1 kg m beside it.
        let weight = -motion.gravity;
        let held = touch.columns(0, 3) * DVector::from_row_slice(weight.as_slice());
        let payload = columns(&operating_point, &spec, &motion);
        for k in 0..motion.samples() {
            let inside = k as f64 * motion.dt < 3.0 - 1e-9;
            let frame = chain
                .joints()
                .iter()
                .enumerate()
                .fold(Placement::identity(), |frame, (j, joint)| frame.then(&joint.placement(motion.q[(k, j)])));
            let moment = (frame.rotation * Vector3::x()).cross(&weight);
            for j in 0..n {
                let row = j * motion.samples() + k;
                let turned: f64 = (0..3).map(|axis| touch[(row, 3 + axis)] * moment[axis]).sum();
                let (mass, lever) = if inside { (payload[(row, 9)], payload[(row, 6)]) } else { (0.0, 0.0) };
                assert!((held[row] - mass).abs() < 1e-10 && (turned - lever).abs() < 1e-10, "{robot} {j} {k}");
            }
        }
    }
}

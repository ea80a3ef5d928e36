//! The direction of gravity by the torques of an arm at rest.

use nalgebra::Vector3;
use plumbline::store::ModelFile;
use plumbline_core::JointVec;
use plumbline_identify::{Direction, DirectionError, Pose, direction, wrong_sign};
use plumbline_model::term::Sample;
use plumbline_model::{Mounting, Robot, TorqueModel};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/config/models/panda-paper-table3.toml");
const SIGMA: [f64; 7] = [0.3; 7];
const READY: JointVec = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];

fn panda() -> TorqueModel {
    let text = std::fs::read_to_string(PATH).unwrap();
    let chain = |_: &str| Ok(Robot::load("panda", None).unwrap().chain);
    ModelFile::parse(PATH, &text, chain).unwrap().model
}

fn at_rest(model: &TorqueModel, mounting: &Mounting, q: JointVec) -> Pose {
    let sample = Sample { q, ..Sample::default() };
    Pose { q, tau: model.evaluator(&mounting.gravity()).torque(&sample).0 }
}

#[test]
fn exact_torques_give_the_exact_direction_in_any_mounting() {
    let model = panda();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for mounting in [
        Mounting::UPRIGHT,
        Mounting::WALL,
        Mounting::CEILING,
        Mounting { rho: 2.2, phi: -1.1 },
        Mounting { rho: rng.random_range(0.0..3.0), phi: rng.random_range(-3.0..3.0) },
    ] {
        let found = direction(&model, &[at_rest(&model, &mounting, READY)], &SIGMA).unwrap();
        assert!(found.angle_to(&mounting) < 1e-6, "{mounting}: {found:?}");
        assert!((found.strength() - 1.0).abs() < 1e-9);
        assert!(found.mounting().angle_to(&mounting) < 1e-6);
        assert!(found.residual[0].iter().all(|rest| rest.abs() < 1e-9));
    }
}

#[test]
fn the_standard_deviation_matches_the_sample_scatter() {
    let model = panda();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let truth = at_rest(&model, &Mounting::WALL, READY);
    let mut errors: Vec<Vector3<f64>> = Vec::new();
    let mut one: Option<Direction> = None;
    for _ in 0..400 {
        let mut pose = truth;
        for (tau, sigma) in pose.tau.iter_mut().zip(SIGMA) {
            let gaussian: f64 = rng.sample(rand_distr::StandardNormal);
            *tau += sigma * gaussian;
        }
        let found = direction(&model, &[pose], &SIGMA).unwrap();
        errors.push(found.gravity - Mounting::WALL.gravity());
        one = Some(found);
    }
    let covariance = one.unwrap().covariance;
    for axis in 0..3 {
        let mean_square = errors.iter().map(|error| error[axis] * error[axis]).sum::<f64>() / errors.len() as f64;
        let ratio = mean_square / covariance[(axis, axis)];
        assert!((0.8..1.25).contains(&ratio), "axis {axis}: {ratio}");
    }
}

#[test]
fn a_torque_sensor_with_the_wrong_sign_is_named() {
    let model = panda();
    for mounting in [Mounting::WALL, Mounting::UPRIGHT] {
        let right = at_rest(&model, &mounting, READY);
        assert_eq!(wrong_sign(&model, &[right], &SIGMA), Ok(None));
        for j in [1, 3, 5] {
            let mut pose = right;
            pose.tau[j] = -pose.tau[j];
            let found = direction(&model, &[pose], &SIGMA).unwrap();
            if found.misfit(&SIGMA) > 7.0 {
                assert_eq!(wrong_sign(&model, &[pose], &SIGMA), Ok(Some(j)), "{mounting}, joint {}", j + 1);
            }
        }
        // The joints that carry most are told in either mounting.
        let mut pose = right;
        pose.tau[3] = -pose.tau[3];
        assert_eq!(wrong_sign(&model, &[pose], &SIGMA), Ok(Some(3)), "{mounting}");
    }
}

#[test]
fn uninformative_poses_are_refused() {
    let model = panda();
    assert_eq!(direction(&model, &[], &SIGMA), Err(DirectionError::NoPose));
    // Stretched straight up, the torques say next to nothing of gravity along the arm.
    let straight = at_rest(&model, &Mounting::UPRIGHT, [0.0, 0.0, 0.0, -0.07, 0.0, 0.0, 0.0, 0.0]);
    assert!(matches!(direction(&model, &[straight], &[20.0; 7]), Err(DirectionError::NotIdentifiable { .. })));
}

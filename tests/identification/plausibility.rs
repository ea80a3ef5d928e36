//! A new model beside the served one and the torques measured last.

use nalgebra::Vector3;
use plumbline::store::ModelFile;
use plumbline_core::{JointVec, Limits, Record};
use plumbline_identify::{Implausible, plausible};
use plumbline_model::term::Sample;
use plumbline_model::{Mounting, Robot, TorqueModel};
use std::path::Path;

const READY: JointVec = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];

fn model() -> (TorqueModel, Limits) {
    let robot = Robot::load("panda", None).unwrap();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/config/models/panda-paper-table3.toml");
    let file = ModelFile::load(Path::new(path), |_| Ok(robot.chain.clone())).unwrap();
    (file.model, robot.limits)
}

fn with(model: &TorqueModel, change: impl Fn(usize, f64) -> f64) -> TorqueModel {
    let values: Vec<(f64, Option<f64>)> =
        model.beta().iter().enumerate().map(|(k, value)| (change(k, *value), None)).collect();
    TorqueModel::new("panda", model.structure().clone(), model.mountings().to_vec(), &values).unwrap()
}

/// An arm at rest, and in motion, that measures `model`'s torque and `more` in joint 2.
fn measured(model: &TorqueModel, gravity: &Vector3<f64>, more: f64) -> Vec<Record> {
    let mut evaluator = model.evaluator(gravity);
    let record = |k: i32| {
        let mut record = Record::default();
        record.state.q = READY.map(|q| q + 0.01 * f64::from(k));
        record.state.dq = [0.02 * f64::from(k); 8];
        record.command.desired.ddq = [0.5; 8];
        let sample = Sample { q: record.state.q, dq: record.state.dq, ddq: record.command.desired.ddq };
        record.state.tau = evaluator.torque(&sample).0;
        record.state.tau[1] += more;
        record
    };
    (0..32).map(record).collect()
}

#[test]
fn a_model_without_inertia_is_refused_with_or_without_a_moving_arm() {
    let (model, limits) = model();
    let gravity = Mounting::WALL.gravity();
    let recent = measured(&model, &gravity, 0.0);
    assert_eq!(plausible(&model, None, &gravity, &[], &limits), Ok(()));
    for value in [0.0, 1e-310, -1e-310, 1e-12] {
        let nothing = with(&model, |_, _| value);
        for recent in [&[][..], &recent] {
            let why = plausible(&nothing, Some(&model), &gravity, recent, &limits).unwrap_err();
            assert!(matches!(why, Implausible::NoInertia { .. }), "{why}");
        }
    }
    // Every number with the wrong sign.
    let why = plausible(&with(&model, |_, value| -value), None, &gravity, &[], &limits).unwrap_err();
    assert!(matches!(why, Implausible::NoInertia { .. }), "{why}");
}

#[test]
fn a_model_that_the_measured_torque_contradicts_is_refused_beside_one_that_agrees() {
    let (model, limits) = model();
    let gravity = Mounting::WALL.gravity();
    let recent = measured(&model, &gravity, 0.5);
    assert_eq!(plausible(&model, Some(&model), &gravity, &recent, &limits), Ok(()));
    // A few percent are a better fit or another payload.
    let near = with(&model, |_, value| 1.05 * value);
    assert_eq!(plausible(&near, Some(&model), &gravity, &recent, &limits), Ok(()));
    let twice = with(&model, |_, value| 2.0 * value);
    for served in [None, Some(&model)] {
        let why = plausible(&twice, served, &gravity, &recent, &limits).unwrap_err();
        let Implausible::Measured { error, served: beside, allowed, .. } = why else { panic!("{why}") };
        assert!(error > allowed && beside.is_some() == served.is_some(), "{why}");
    }
    let wild = with(&model, |_, value| 1e3 * value);
    let why = plausible(&wild, Some(&model), &gravity, &recent, &limits).unwrap_err();
    assert!(matches!(why, Implausible::Limit { .. }), "{why}");
}

#[test]
fn where_the_served_model_is_wrong_too_a_better_one_is_taken() {
    // Something heavy was picked up: 12 Nm more in joint 2 than any of the models explains.
    let (model, limits) = model();
    let gravity = Mounting::UPRIGHT.gravity();
    let recent = measured(&model, &gravity, 12.0);
    assert_eq!(plausible(&model, Some(&model), &gravity, &recent, &limits), Ok(()));
    assert!(plausible(&model, None, &gravity, &recent, &limits).is_err());
}

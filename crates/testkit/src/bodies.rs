//! Models to export, and random states with the torques that they give.

use crate::arms::random_base;
use plumbline_core::{MAX_JOINTS, Torque};
use plumbline_identify::consistency::{Nearest, Prior, Uncertainty, nearest};
use plumbline_model::term::Sample;
use plumbline_model::term::effect::Spec;
use plumbline_model::{Mounting, Reduction, Robot, Structure, TorqueModel};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::PI;
use std::path::Path;

/// Robots that the formats are tested with: revolute and prismatic, right angles and none.
pub const ROBOTS: [&str; 6] = ["panda", "ur10", "kuka-lwr4p", "gantry", "stanford", "skew"];

pub fn robot(name: &str) -> Robot {
    let root = Path::new(crate::ROOT);
    let golden = root.join(format!("crates/model/tests/golden/robots/{name}.toml"));
    let at = if golden.is_file() { golden.display().to_string() } else { name.to_string() };
    Robot::load(&at, Some(root)).unwrap_or_else(|error| panic!("{error}"))
}

/// A physically consistent random model: bodies, friction and the other terms.
pub fn model(robot: &Robot, terms: &[&str], seed: u64) -> TorqueModel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let structure = Structure::of(robot.chain.clone(), Reduction::any_mounting(&robot.chain), terms).unwrap();
    let rigid = random_base(structure.reduction(), robot.chain.len(), &mut rng);
    let others = structure.columns().len() - rigid.len();
    let mut values: Vec<(f64, Option<f64>)> = rigid.iter().map(|value| (*value, Some(0.01))).collect();
    values.extend((0..others).map(|_| (rng.random_range(0.05..0.6), Some(0.01))));
    TorqueModel::new(&robot.name, structure, vec![Mounting::WALL], &values).unwrap()
}

/// The model with effects, whose parameters are drawn by `draw` from the number of the effect and of its column.
pub fn with_effects(model: &TorqueModel, specs: &[Spec], draw: impl Fn(usize, usize) -> f64) -> TorqueModel {
    let operating_point = model.structure().operating_point(&model.beta());
    let mut values: Vec<(f64, Option<f64>)> = model.parameters().iter().map(|own| (own.value, own.std)).collect();
    let mut structure = model.structure().clone();
    for (index, spec) in specs.iter().enumerate() {
        let term = spec.build(&operating_point).unwrap();
        values.extend((0..term.columns().len()).map(|c| (draw(index, c), Some(0.01))));
        structure = structure.with(vec![term]).unwrap();
    }
    TorqueModel::new(model.robot(), structure, model.mountings().to_vec(), &values).unwrap()
}

/// Bodies for a model, by the geometry's prior.
pub fn bodies(model: &TorqueModel) -> Nearest {
    let (structure, beta) = (model.structure(), model.beta());
    let prior = Prior::of_geometry(structure, &beta);
    let deviations: Vec<Option<f64>> = model.parameters().iter().map(|parameter| parameter.std).collect();
    nearest(structure, &beta, Uncertainty::Deviations(&deviations), &prior).unwrap()
}

#[derive(Serialize)]
pub struct Case {
    pub gravity: [f64; 3],
    pub q: Vec<f64>,
    pub dq: Vec<f64>,
    pub ddq: Vec<f64>,
    pub tau: Vec<f64>,
}

/// Random states in random mountings, and the model's torque by its evaluator.
pub fn cases(model: &TorqueModel, count: usize) -> Vec<Case> {
    let n = model.structure().chain().len();
    let mut rng = ChaCha8Rng::seed_from_u64(99);
    (0..count)
        .map(|_| {
            let mut draw = |span: f64| -> Vec<f64> { (0..n).map(|_| rng.random_range(-span..span)).collect() };
            let (q, dq, ddq) = (draw(3.0), draw(2.0), draw(5.0));
            let mounting = Mounting { rho: rng.random_range(0.0..PI), phi: rng.random_range(-PI..PI) };
            let gravity = mounting.gravity();
            let mut sample = Sample::default();
            let padded = |values: &[f64]| {
                let mut all = [0.0; MAX_JOINTS];
                all[..n].copy_from_slice(values);
                all
            };
            (sample.q, sample.dq, sample.ddq) = (padded(&q), padded(&dq), padded(&ddq));
            let Torque(tau) = model.evaluator(&gravity).torque(&sample);
            Case { gravity: gravity.into(), q, dq, ddq, tau: tau[..n].to_vec() }
        })
        .collect()
}

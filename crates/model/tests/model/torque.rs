//! Structures and torque models: terms together, names, evaluation in the loop.

use crate::models::{assert_no_allocation, effect, named, with};
use nalgebra::{DMatrix, DVector};
use plumbline_core::Torque;
use plumbline_model::term::effect::Site;
use plumbline_model::term::{Motion, Sample};
use plumbline_model::{BaseKind, ModelError, Mounting, NamedTerm, Reduction, Structure, TorqueModel, term};
use plumbline_testkit::arms::{any_mounting, chain, draw};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const TERMS: [&str; 3] = ["friction", "torque-offset", "rotor-inertia"];

pub fn random_motion(rng: &mut ChaCha8Rng, n: usize, samples: usize) -> Motion {
    let mut matrix = |span| DMatrix::from_vec(samples, n, draw(rng, samples * n, span));
    let (q, dq, ddq) = (matrix(3.0), matrix(0.5), matrix(5.0));
    Motion { dt: 1e-3, q, dq, ddq, gravity: any_mounting(rng).gravity(), periodic: false, start: 0.0 }
}

fn random_model(robot: &str, kind: BaseKind, rng: &mut ChaCha8Rng) -> TorqueModel {
    let chain = chain(robot);
    let reduction = Reduction::of_kind(&chain, kind);
    let structure = Structure::of(chain, reduction, &TERMS).unwrap();
    let values: Vec<_> =
        draw(rng, structure.columns().len(), 1.0).into_iter().map(|value| (value, Some(0.1))).collect();
    let mounting = if kind == BaseKind::Gbs { Mounting::WALL } else { Mounting::UPRIGHT };
    TorqueModel::new(robot, structure, vec![mounting], &values).unwrap()
}

#[test]
fn evaluator_is_regressor_times_beta() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for robot in ["panda", "ur10", "paper-2dof", "scara", "gantry"] {
        for kind in [BaseKind::Gbs, BaseKind::Vbs] {
            if Reduction::of_kind(&chain(robot), kind).kind() != kind {
                continue;
            }
            let model = random_model(robot, kind, &mut rng);
            let n = model.structure().chain().len();
            let motion = random_motion(&mut rng, n, 50);
            let stacked = model.structure().regressor(&motion) * DVector::from_vec(model.beta());
            // Joint by joint, sample by sample: one column per joint.
            let expected = DMatrix::from_column_slice(50, n, stacked.as_slice());
            let difference = (model.predict(&motion) - &expected).amax();
            assert!(difference < 1e-11 * expected.amax(), "{robot} {kind}: {difference:e}");
        }
    }
}

#[test]
fn torque_neither_allocates_nor_moves_unused_joints() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut evaluator = random_model("panda", BaseKind::Gbs, &mut rng).evaluator(&Mounting::WALL.gravity());
    let sample = Sample { q: [0.3; 8], dq: [0.2; 8], ddq: [-1.0; 8] };
    let mut sum = 0.0;
    assert_no_allocation(|| {
        for _ in 0..1000 {
            let Torque(tau) = evaluator.torque(&sample);
            sum += tau[0];
        }
    });
    assert!(sum.is_finite() && sum != 0.0);
    assert_eq!(evaluator.torque(&Sample { q: [0.3; 8], ..Sample::default() }).0[7], 0.0);
}

#[test]
fn rotor_inertias_that_the_rigid_body_absorbs_are_removed() {
    let panda = chain("panda");
    for kind in [BaseKind::Gbs, BaseKind::Vbs] {
        let structure = Structure::of(panda.clone(), Reduction::of_kind(&panda, kind), &TERMS).unwrap();
        let absorbed: Vec<_> =
            structure.absorbed().iter().map(|a| (a.column.name.as_str(), a.into.as_slice())).collect();
        let (lzz1, lzz2) = ([("Lzz1".to_string(), 1.0)], [("Lzz2".to_string(), 1.0)]);
        assert_eq!(absorbed, [("ia1", &lzz1[..]), ("ia2", &lzz2[..])]);
        let names: Vec<&str> = structure.columns().iter().map(|column| column.name.as_str()).collect();
        assert!(names.ends_with(&["offset7", "ia3", "ia4", "ia5", "ia6", "ia7"]), "{names:?}");
        assert_eq!(structure.columns()[0].expression, "Lzz1 + Lyy2 + ia1");
        assert_eq!(structure.ranges().last().unwrap().end, structure.columns().len());
    }
}

/// The regressor of an identifiable structure has full column rank on motions that the structure did not choose. They are in
/// two mountings: in one alone, a slide's weight, rotor and offset (`m ddq - m g_z + ia ddq + offset`) can't be told apart.
#[test]
fn identifiable_columns_are_independent() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for robot in ["panda", "ur10e", "tx40", "kuka-lwr4p", "paper-2dof", "scara", "stanford", "gantry"] {
        let chain = chain(robot);
        let motions = [(); 2].map(|()| random_motion(&mut rng, chain.len(), 100));
        let relative_least = |structure: &Structure| {
            let [above, below] = motions.each_ref().map(|motion| structure.regressor(motion));
            let mut w = above.clone().resize_vertically(above.nrows() + below.nrows(), 0.0);
            w.rows_mut(above.nrows(), below.nrows()).copy_from(&below);
            w.column_iter_mut().for_each(|mut column| column /= column.norm());
            let values = w.singular_values();
            values.min() / values.max()
        };
        let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &TERMS).unwrap();
        let least = relative_least(&structure);
        assert!(least > 1e-4, "{robot}: {least:e}");
        // With what was taken out it has not.
        assert!(!structure.absorbed().is_empty(), "{robot}");
        let reduction = Reduction::any_mounting(&chain);
        let terms = TERMS.iter().map(|id| term::by_id(id, &chain, &reduction).unwrap()).collect();
        let least = relative_least(&Structure::new(chain, reduction, terms).unwrap());
        assert!(least < 1e-12, "{robot}: {least:e}");
    }
}

#[test]
fn a_vertical_model_is_refused_on_a_wall_by_name() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let vertical = random_model("panda", BaseKind::Vbs, &mut rng);
    assert_eq!(vertical.valid_in(&Mounting::UPRIGHT), Ok(()));
    assert_eq!(vertical.valid_in(&Mounting::CEILING), Ok(()));
    assert_eq!(vertical.valid_in(&Mounting { rho: 179.5_f64.to_radians(), phi: 1.0 }), Ok(()));
    assert!(vertical.valid_in(&Mounting { rho: 178.5_f64.to_radians(), phi: 1.0 }).is_err());
    let refused = vertical.valid_in(&Mounting::WALL).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "the VBS model of panda is valid only with gravity along axis 1 (upright or hanging), not in the mounting wall: \
         it was identified upright and lacks lxR1 and lyR1"
    );
    let generalized = random_model("panda", BaseKind::Gbs, &mut rng);
    for mounting in [Mounting::UPRIGHT, Mounting::WALL, Mounting::CEILING, any_mounting(&mut rng)] {
        assert_eq!(generalized.valid_in(&mounting), Ok(()));
    }
}

/// On a wall the two missing parameters spoil joint 1 and no other.
#[test]
fn a_vertical_model_fails_on_a_wall_in_joint_1_only() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let panda = chain("panda");
    let delta = DVector::from_vec(draw(&mut rng, 70, 1.0));
    let model = |kind| {
        let reduction = Reduction::of_kind(&panda, kind);
        let values: Vec<_> = reduction.base_of(&delta).iter().map(|value| (*value, None)).collect();
        TorqueModel::new("panda", Structure::of(panda.clone(), reduction, &[]).unwrap(), vec![], &values).unwrap()
    };
    let mut motion = random_motion(&mut rng, 7, 40);
    motion.gravity = Mounting::WALL.gravity();
    let difference = model(BaseKind::Gbs).predict(&motion) - model(BaseKind::Vbs).predict(&motion);
    assert!(difference.column(0).amax() > 0.1);
    assert!(difference.columns(1, 6).amax() < 1e-9);
    motion.gravity = Mounting::UPRIGHT.gravity();
    let difference = model(BaseKind::Gbs).predict(&motion) - model(BaseKind::Vbs).predict(&motion);
    assert!(difference.amax() < 1e-9);
}

#[test]
fn a_model_is_rebuilt_from_its_names() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let rebuild =
        |kind, named: &[NamedTerm]| TorqueModel::from_named("panda", chain("panda"), kind, vec![Mounting::WALL], named);
    for kind in [BaseKind::Gbs, BaseKind::Vbs] {
        let model = random_model("panda", kind, &mut rng);
        let again = rebuild(kind, &named(&model)).unwrap();
        assert_eq!(model.parameters(), again.parameters());
        let motion = random_motion(&mut rng, 7, 5);
        assert_eq!(model.predict(&motion), again.predict(&motion));
    }

    let full = named(&random_model("panda", BaseKind::Gbs, &mut rng));
    // A term may be short of columns; the rigid body may not.
    let mut short = full.clone();
    short[2].parameters.retain(|(name, _, _)| name == "offset3");
    let names: Vec<String> =
        rebuild(BaseKind::Gbs, &short).unwrap().terms()[2].1.iter().map(|p| p.column.name.clone()).collect();
    assert_eq!(names, ["offset3"]);
    let mut broken = full.clone();
    broken[0].parameters.retain(|(name, _, _)| name != "lx4");
    assert_eq!(rebuild(BaseKind::Gbs, &broken).unwrap_err(), ModelError::MissingColumn { name: "lx4".into() });
    let mut broken = full.clone();
    broken[3].parameters.push(("ia1".into(), 0.1, None));
    let error = ModelError::UnknownColumn { term: "rotor-inertia".into(), name: "ia1".into() };
    assert_eq!(rebuild(BaseKind::Gbs, &broken).unwrap_err(), error);
    let mut broken = full.clone();
    broken[1].parameters.push(("fv1".into(), 0.1, None));
    assert_eq!(rebuild(BaseKind::Gbs, &broken).unwrap_err(), ModelError::DuplicateColumn { name: "fv1".into() });
    let mut broken = full.clone();
    broken[1].parameters[0].1 = f64::NAN;
    assert!(matches!(rebuild(BaseKind::Gbs, &broken).unwrap_err(), ModelError::NotFinite { .. }));
    let mut broken = full.clone();
    broken[1].id = "ghosts".into();
    assert_eq!(rebuild(BaseKind::Gbs, &broken).unwrap_err(), ModelError::UnknownTerm { id: "ghosts".into() });
    assert!(rebuild(BaseKind::Vbs, &full).is_err());
}

#[test]
fn an_effect_that_does_not_fit_is_refused_by_name() {
    let mut rng = ChaCha8Rng::seed_from_u64(16);
    let specs = [(3, 0.002), (5, 0.004)].map(|(joint, delta)| effect("presliding", "", Site::Joint(joint), &[delta]));
    let full = named(&with(&random_model("panda", BaseKind::Gbs, &mut rng), &specs));
    let rebuild = |named: &[NamedTerm]| {
        TorqueModel::from_named("panda", chain("panda"), BaseKind::Gbs, vec![Mounting::WALL], named)
    };
    assert!(rebuild(&full).is_ok());
    let wrong = |change: &dyn Fn(&mut NamedTerm)| {
        let mut broken = full.clone();
        change(broken.last_mut().unwrap());
        rebuild(&broken).unwrap_err().to_string()
    };
    assert!(wrong(&|term| term.effect.settings.clear()).contains("`delta`"));
    assert!(wrong(&|term| term.effect.settings[0].1 = 7.0).contains("delta of effect presliding is 7"));
    assert!(wrong(&|term| term.effect.joint = Some(8)).contains("joint 8"));
    assert!(wrong(&|term| term.effect.joint = None).contains("the arm"));
    assert!(wrong(&|term| term.effect.form = "odd".into()).contains("`odd`"));
    assert!(wrong(&|term| term.effect.joint = Some(4)).contains("fp6"));
}

//! An effect in the loop, in a regressor and in a model file is the same effect, on every kind of arm.

use crate::models::{
    assert_no_allocation, columns, effect, named, operating_point, physical_model, rigid_model, smooth_motion, specs,
    with,
};
use nalgebra::{DMatrix, DVector};
use plumbline_core::Torque;
use plumbline_model::term::effect::{FAMILIES, Site};
use plumbline_model::term::mounting::WITH_FIRST_LINK;
use plumbline_model::term::{Motion, Sample};
use plumbline_model::{Mounting, NamedTerm, TorqueModel};
use plumbline_testkit::arms::chain;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A search has the load and its slopes along its motions computed once; along any other motion they are computed sample by sample.
#[test]
fn along_a_known_motion_a_column_is_the_same() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    for robot in ["panda", "paper-2dof", "scara"] {
        // Bodies that can't be may fall through a soft gear.
        let model = physical_model(robot, &mut rng);
        let n = model.structure().chain().len();
        let motions = [true, false].map(|periodic| Arc::new(smooth_motion(&mut rng, n, periodic, 500)));
        let other = Arc::new(smooth_motion(&mut rng, n, true, 500));
        let plain = operating_point(&model);
        let known = plain.clone().known_along(motions.iter());
        for spec in FAMILIES.iter().flat_map(|family| specs(family, n, &mut rng)) {
            for motion in motions.iter().chain([&other]) {
                // Twice, since slopes are computed at the first time: of the motion itself and of an equal one.
                let equal = Motion::clone(motion);
                let [first, second] = [&**motion, &equal].map(|motion| columns(&known, &spec, motion));
                let expected = columns(&plain, &spec, motion);
                let difference = (&first - &expected).amax();
                assert!(difference < 1e-5 * expected.amax().max(1e-9), "{spec:?} of {robot}: {difference:e}");
                assert!(first == second && (motion != &other || difference == 0.0), "{spec:?} of {robot}");
            }
        }
    }
}

#[test]
fn the_served_torque_is_the_regressor_times_the_parameters() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for robot in ["panda", "paper-2dof", "scara"] {
        let model = rigid_model(robot, &mut rng);
        let n = model.structure().chain().len();
        for family in FAMILIES {
            for spec in specs(family, n, &mut rng) {
                let periodic = rng.random_bool(0.5);
                let motion = smooth_motion(&mut rng, n, periodic, 1000);
                let full = with(&model, std::slice::from_ref(&spec));
                let own = columns(&operating_point(&model), &spec, &motion);
                assert!(own.iter().all(|value| value.is_finite()), "{spec:?}");
                // A one-sided spring may not be reached, and a small arm or its first two links do not feel every force, tilt or parameter.
                // Nor does anything depend on where a sliding joint is.
                let sliding = family.id.starts_with("encoder") && robot == "scara";
                let may_be = ["above", "below"].contains(&spec.form)
                    // A spline that the motion does not reach.
                    || (family.id == "empirical" && own.amax() > 0.0)
                    || ((robot != "panda" || matches!(spec.site, Site::Joint(0 | 1))) && own.ncols() > 1)
                    // The first link has columns of its own where gravity is along its axis.
                    || (spec.form == WITH_FIRST_LINK && own.columns(0, 2).column_iter().all(|column| column.amax() > 0.0))
                    || sliding;
                assert!(
                    may_be || own.column_iter().all(|column| column.amax() > 0.0),
                    "an empty column: {spec:?}, {robot}"
                );
                let whole = full.structure().regressor(&motion) * DVector::from_vec(full.beta());
                let whole = DMatrix::from_column_slice(motion.samples(), n, whole.as_slice());
                let difference = (full.structure().torques(&full.beta(), &motion) - &whole).amax();
                assert!(difference < 1e-9 * whole.amax(), "{spec:?} of {robot}: {difference:e} of {:e}", whole.amax());
                let served = full.predict(&motion) - model.predict(&motion);
                if !family.is_served() {
                    assert_eq!(served.amax(), 0.0, "{spec:?}");
                    continue;
                }
                let beta = DVector::from_vec(full.beta()[model.beta().len()..].to_vec());
                let expected = own * beta;
                let expected = DMatrix::from_column_slice(motion.samples(), n, expected.as_slice());
                let scale = expected.amax().max(model.predict(&motion).amax());
                let difference = (served - &expected).amax();
                assert!(difference < 1e-9 * scale, "{spec:?} of {robot}: {difference:e} of {scale:e}");
            }
        }
    }
}

#[test]
fn a_model_with_any_effect_is_rebuilt_from_its_names() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for robot in ["panda", "scara"] {
        let model = rigid_model(robot, &mut rng);
        for family in FAMILIES {
            for spec in specs(family, model.structure().chain().len(), &mut rng) {
                let full = with(&model, std::slice::from_ref(&spec));
                if full.terms().last().unwrap().0.spec().is_none() {
                    // A term of the whole arm (offsets, rotors), which torque.rs has.
                    continue;
                }
                let rebuild = |named: &[NamedTerm]| {
                    TorqueModel::from_named(robot, chain(robot), model.kind(), vec![Mounting::WALL], named)
                };
                let again = rebuild(&named(&full)).unwrap();
                assert_eq!(full.parameters(), again.parameters(), "{spec:?}");
                let motion = smooth_motion(&mut rng, model.structure().chain().len(), false, 1000);
                // To the last bit: a random arm, which no real body is, may fall through a soft gear.
                let bits = |model: &TorqueModel| model.predict(&motion).map(f64::to_bits);
                assert_eq!(bits(&full), bits(&again), "{spec:?}");
            }
        }
    }
}

#[test]
fn contacts_that_slide_one_after_the_other_carry_a_third_each() {
    let mut rng = ChaCha8Rng::seed_from_u64(29);
    let model = rigid_model("panda", &mut rng);
    let motion = smooth_motion(&mut rng, 7, true, 1000);
    let column = |form, settings: &[f64]| {
        columns(&operating_point(&model), &effect("presliding", form, Site::Joint(3), settings), &motion)
    };
    let [first, second, third] = [0.002, 0.01, 0.05].map(|delta| column("", &[delta]));
    let spread = column("spread", &[0.01, 5.0]);
    assert!((&spread - (first + &second + third) / 3.0).amax() < 1e-12);
    assert!((spread - second).amax() > 0.1, "one contact is something else");
}

/// Columns that the data can't tell can be left out of an effect; what is left is the same effect.
#[test]
fn an_effect_may_be_short_of_columns() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let model = rigid_model("panda", &mut rng);
    let spec = effect("payload", "", Site::Arm, &[]);
    let full = with(&model, std::slice::from_ref(&spec));
    let kept = ["payload_lx", "payload_m"];
    let mut names = named(&full);
    let term = names.last_mut().unwrap();
    term.parameters.retain(|(name, _, _)| kept.contains(&name.as_str()));
    let short = TorqueModel::from_named("panda", chain("panda"), model.kind(), vec![Mounting::WALL], &names).unwrap();
    let (last, parameters) = *short.terms().last().unwrap();
    assert_eq!(last.spec(), Some(spec));
    assert_eq!((last.original(0), last.original(1)), (6, 9));
    assert_eq!(parameters.iter().map(|own| own.column.name.as_str()).collect::<Vec<_>>(), kept);
    assert_eq!(named(&short), names, "what is left out stays out of the file");
    let motion = smooth_motion(&mut rng, 7, false, 1000);
    let own = columns(&operating_point(&model), last.spec().as_ref().unwrap(), &motion);
    let expected = own.column(6) * parameters[0].value + own.column(9) * parameters[1].value;
    let served = short.predict(&motion) - model.predict(&motion);
    assert!((DVector::from_column_slice(served.as_slice()) - &expected).amax() < 1e-9 * expected.amax());
}

#[test]
fn no_effect_allocates_in_the_loop() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let model = rigid_model("panda", &mut rng);
    for family in FAMILIES {
        for spec in specs(family, 7, &mut rng) {
            let mut evaluator = with(&model, std::slice::from_ref(&spec)).evaluator(&Mounting::WALL.gravity());
            let mut sum = 0.0;
            assert_no_allocation(|| {
                for k in 0..20 {
                    let sample = Sample { q: [0.3 + 1e-3 * f64::from(k); 8], dq: [1.0; 8], ddq: [-1.0; 8] };
                    let Torque(tau) = evaluator.torque(&sample);
                    sum += tau.iter().sum::<f64>();
                }
            });
            assert!(sum.is_finite(), "{spec:?}");
        }
    }
}

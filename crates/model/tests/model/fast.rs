//! The fast routes against the plain ones, on every arm that the tests know and on arms with random geometry.

use crate::torque::random_motion;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use plumbline_model::term::{FixedTerm, Sample};
use plumbline_model::{
    BaseKind, Chain, ClosedForm, JointKind, LinkColumns, LinkParameters, Reduction, SampleRegressor, Structure,
    TorqueModel, regressor, rnea,
};
use plumbline_testkit::arms::{self, all, any_mounting, draw, links, random_chain};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn sample(rng: &mut ChaCha8Rng, n: usize) -> Sample {
    let mut vector = |span| {
        let mut padded = JointVec::default();
        padded[..n].copy_from_slice(&draw(rng, n, span));
        padded
    };
    Sample { q: vector(3.1), dq: vector(2.5), ddq: vector(8.0) }
}

fn plain(chain: &Chain, links: &[LinkParameters], gravity: &Vector3<f64>, s: &Sample) -> JointVec {
    let mut tau = JointVec::default();
    rnea(chain, links, gravity, &s.q, &s.dq, &s.ddq, &mut tau);
    tau
}

fn assert_close(found: &JointVec, expected: &JointVec, what: &str) {
    let scale = expected.iter().fold(f64::MIN_POSITIVE, |most, tau| most.max(tau.abs()));
    for (j, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= 1e-12 * scale, "{what}, joint {}: {found} is not {expected}", j + 1);
    }
}

fn revolute(chain: &Chain) -> bool {
    chain.joints().iter().all(|joint| joint.kind == JointKind::Revolute)
}

/// Full standard parameters, regrouped ones, and ones with single slots filled.
#[test]
fn torque_of_any_links_is_that_of_the_plain_recursion() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let named: Vec<_> = all().into_iter().map(|(name, chain)| (name.to_string(), chain)).collect();
    let random: Vec<_> = (0..300).map(|k| (format!("random arm {k}"), random_chain(&mut rng))).collect();
    let mut joined = 0;
    for (name, chain) in named.into_iter().chain(random) {
        let n = chain.len();
        for kind in 0..3 {
            let mut delta = draw(&mut rng, 10 * n, 2.0);
            for (slot, value) in delta.iter_mut().enumerate() {
                let zero = match kind {
                    0 => false,
                    1 => [3, 8, 9].contains(&(slot % 10)),
                    _ => rng.random_bool(0.8),
                };
                if zero {
                    *value = 0.0;
                }
            }
            let (links, gravity) = (links(&delta), any_mounting(&mut rng).gravity());
            let mut closed = ClosedForm::default();
            // A prismatic joint is the plain recursion's.
            assert_eq!(closed.add_links(&chain, &links, &gravity), revolute(&chain), "{name}");
            if revolute(&chain) {
                joined += 1;
                for _ in 0..20 {
                    let s = sample(&mut rng, n);
                    assert_close(&closed.torque(&s), &plain(&chain, &links, &gravity, &s), &name);
                }
            }
        }
    }
    assert!(joined > 300, "{joined} arms compared");
}

/// The evaluator against its own terms, one by one, as they are without the closed form.
#[test]
fn the_evaluator_is_the_sum_of_its_terms() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (name, chain) in all() {
        for kind in [BaseKind::Gbs, BaseKind::Vbs] {
            let reduction = Reduction::of_kind(&chain, kind);
            let structure =
                Structure::of(chain.clone(), reduction, &["friction", "torque-offset", "rotor-inertia"]).unwrap();
            let values: Vec<_> =
                draw(&mut rng, structure.columns().len(), 1.0).into_iter().map(|value| (value, None)).collect();
            let model = TorqueModel::new(name, structure, Vec::new(), &values).unwrap();
            let gravity = any_mounting(&mut rng).gravity();
            let structure = model.structure();
            let beta = model.beta();
            let mut terms: Vec<Box<dyn FixedTerm>> = structure
                .terms()
                .iter()
                .zip(structure.ranges())
                .map(|(term, range)| term.fix(&chain, &gravity, &beta[range]))
                .collect();
            let mut evaluator = model.evaluator(&gravity);
            for _ in 0..50 {
                let s = sample(&mut rng, chain.len());
                let mut expected = JointVec::default();
                terms.iter_mut().for_each(|term| term.torque(&s, &mut expected));
                assert_close(&evaluator.torque(&s).0, &expected, &format!("{name} {kind}"));
            }
        }
    }
}

#[test]
fn angles_of_many_turns_and_nan() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let panda = arms::chain("panda");
    let links = links(&draw(&mut rng, 70, 1.0));
    let gravity = any_mounting(&mut rng).gravity();
    let mut closed = ClosedForm::default();
    assert!(closed.add_links(&panda, &links, &gravity));
    for turns in [1e3, 9e3, 1e5, 1e9] {
        let mut s = sample(&mut rng, 7);
        s.q[3] = turns;
        assert_close(&closed.torque(&s), &plain(&panda, &links, &gravity, &s), &format!("{turns} rad"));
    }
    let mut s = sample(&mut rng, 7);
    s.q[6] = f64::NAN;
    assert!(closed.torque(&s)[..6].iter().all(|tau| tau.is_nan()), "what is no number must not look like one");
    // A second arm is no part of the first one.
    assert!(!closed.add_links(&panda, &links, &gravity));
}

/// Any choice of columns, on every arm, prismatic joints included.
#[test]
fn link_columns_are_those_of_the_plain_regressor() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let named: Vec<_> = all().into_iter().map(|(name, chain)| (name.to_string(), chain)).collect();
    let random: Vec<_> = (0..200).map(|k| (format!("random arm {k}"), random_chain(&mut rng))).collect();
    for (name, chain) in named.into_iter().chain(random) {
        let n = chain.len();
        let base = Reduction::any_mounting(&chain).independent().to_vec();
        let some: Vec<usize> = (0..10 * n).filter(|_| rng.random_bool(0.5)).collect();
        for slots in [base, (0..10 * n).collect(), some, Vec::new()] {
            let gravity = any_mounting(&mut rng).gravity();
            let mut columns = LinkColumns::new(&chain, &slots, &gravity);
            assert_eq!((columns.len(), columns.is_empty()), (slots.len(), slots.is_empty()));
            let mut standard = DMatrix::zeros(n, 10 * n);
            // What stood there before must not show through.
            let mut found = vec![[f64::NAN; 8]; slots.len()];
            for _ in 0..10 {
                let s = sample(&mut rng, n);
                columns.fill(&s, &mut found);
                regressor(&chain, &gravity, &s.q, &s.dq, &s.ddq, &mut standard);
                let scale = standard.amax();
                for (found, &slot) in found.iter().zip(&slots) {
                    for (j, entry) in found.iter().enumerate() {
                        let expected = if j < n { standard[(j, slot)] } else { 0.0 };
                        let close = (entry - expected).abs() <= 1e-13 * scale;
                        assert!(close, "{name}, slot {slot}, joint {}: {entry} is not {expected}", j + 1);
                    }
                }
            }
        }
    }
}

/// One sample after the other gives the rows of the whole motion.
#[test]
fn sample_by_sample_is_the_structures_regressor() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for (name, chain) in all() {
        let n = chain.len();
        let reduction = Reduction::any_mounting(&chain);
        let structure = Structure::of(chain, reduction, &["friction", "torque-offset", "rotor-inertia"]).unwrap();
        // No multiple of the block that is written at once.
        let samples = 21;
        let motion = random_motion(&mut rng, n, samples);
        let whole = structure.regressor(&motion);
        let mut rows = SampleRegressor::new(&structure, &motion.gravity).unwrap();
        assert_eq!((rows.joints(), rows.len(), rows.is_empty()), (n, structure.columns().len(), false));
        for k in 0..samples {
            for (c, column) in rows.at(&motion.sample(k)).iter().enumerate() {
                for (j, entry) in column.iter().enumerate() {
                    let expected = if j < n { whole[(j * samples + k, c)] } else { 0.0 };
                    let close = (entry - expected).abs() <= 1e-13 * (1.0 + expected.abs());
                    assert!(close, "{name}, {}, joint {}: {entry} {expected}", structure.columns()[c].name, j + 1);
                }
            }
        }
    }
}

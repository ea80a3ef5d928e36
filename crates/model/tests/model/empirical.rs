//! The learned term: its splines, its end, its bound, its place in a model file.

use crate::models::{effect, named, operating_point, rigid_model, with};
use plumbline_core::Torque;
use plumbline_model::term::Sample;
use plumbline_model::term::effect::Site;
use plumbline_model::term::empirical::{Axis, COARSE, FINE, Follows, bound};
use plumbline_model::{ModelError, Mounting, TorqueModel};
use plumbline_testkit::arms::chain;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const AXIS: Axis = Axis { follows: Follows::Position, middle: 0.4, reach: 1.5 };

/// Cox and de Boor's recursion for whole knots.
fn recursive(degree: usize, x: f64) -> f64 {
    let d = degree as f64;
    if degree == 0 {
        return if (0.0..1.0).contains(&x) { 1.0 } else { 0.0 };
    }
    (x * recursive(degree - 1, x) + (d + 1.0 - x) * recursive(degree - 1, x - 1.0)) / d
}

#[test]
fn the_functions_are_b_splines_that_sum_to_one_over_the_domain() {
    for step in 1..200 {
        let share = f64::from(step) / 200.0;
        let x = AXIS.middle + AXIS.reach * (2.0 * share - 1.0);
        let check = |functions: &[f64], degree: usize| {
            let place = share * (functions.len() - degree) as f64;
            assert!((functions.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{functions:?}");
            for (s, value) in functions.iter().enumerate() {
                let expected = recursive(degree, place - s as f64 + degree as f64);
                assert!((value - expected).abs() < 1e-12, "degree {degree}, {s} at {x}: {value}, {expected}");
            }
        };
        check(&AXIS.fine(x), 3);
        check(&AXIS.coarse(x), 2);
    }
    // Of a velocity, the last function is the sign.
    let velocity = Axis { follows: Follows::Velocity, ..AXIS };
    assert_eq!(velocity.fine(-0.2)[FINE - 1], (100.0 * -0.2f64).tanh());
    assert!((velocity.coarse(0.3)[..COARSE - 1].iter().sum::<f64>() - 1.0).abs() < 1e-12);
}

#[test]
fn outside_the_domain_the_torque_fades_without_a_step_and_never_passes_its_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let model = rigid_model("panda", &mut rng);
    for (form, of, settings) in [
        ("q", [3, 3], vec![0.2, 0.8]),
        ("dq", [2, 2], vec![0.0, 1.1]),
        ("q-q", [1, 4], vec![0.2, 0.8, -0.3, 1.0]),
        ("q-dq", [5, 5], vec![0.2, 0.8, 0.0, 1.0]),
        ("dq-dq", [0, 6], vec![0.1, 0.8, 0.0, 1.0]),
    ] {
        let spec = effect("empirical", form, Site::Function { row: 2, of }, &settings);
        let plain = with(&model, std::slice::from_ref(&spec));
        let rigid = model.beta().len();
        let values: Vec<(f64, Option<f64>)> = plain
            .beta()
            .iter()
            .enumerate()
            .map(|(c, value)| (if c < rigid { *value } else { rng.random_range(-0.5..0.5) }, None))
            .collect();
        let coefficients: Vec<f64> = values[rigid..].iter().map(|value| value.0).collect();
        let full = TorqueModel::new("panda", plain.structure().clone(), vec![], &values).unwrap();
        let gravity = Mounting::WALL.gravity();
        let (mut with, mut without) = (full.evaluator(&gravity), model.evaluator(&gravity));
        let mut own = |sample: &Sample| {
            let (Torque(with), Torque(without)) = (with.torque(sample), without.torque(sample));
            assert!((0..7).all(|j| j == 2 || with[j] == without[j]), "{form}: only its row");
            with[2] - without[2]
        };
        let most = bound(form, &coefficients);
        let (mut largest, mut last) = (0.0f64, None);
        for step in 0..=40_000 {
            // Across both domains and out of them, slowly enough for a step to show.
            let x = -4.0 + 2e-4 * f64::from(step);
            let torque = own(&Sample { q: [x; 8], dq: [0.7 * x + 0.3; 8], ddq: [0.0; 8] });
            assert!(torque.abs() <= most * (1.0 + 1e-9), "{form} at {x}: {torque} of {most}");
            let jump = last.map_or(0.0, |last: f64| (torque - last).abs());
            assert!(jump < 0.05, "{form} at {x}: a step of {jump}");
            (largest, last) = (largest.max(torque.abs()), Some(torque));
        }
        assert!(largest > 0.1, "{form}: {largest}");
        for far in [[4.0; 8], [-4.0; 8], [f64::INFINITY; 8]] {
            // Of the rigid body nothing is left where a position is no number.
            let at = if far[0].is_finite() { own(&Sample { q: far, dq: far, ddq: [0.0; 8] }) } else { 0.0 };
            assert!(at.abs() < 1e-9, "{form} at {far:?}: {at}");
        }
    }
}

#[test]
fn a_form_is_refused_at_a_site_that_it_does_not_fit() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let model = rigid_model("panda", &mut rng);
    let refused = |form: &'static str, of: [usize; 2], settings: &[f64]| {
        effect("empirical", form, Site::Function { row: 0, of }, settings).build(&operating_point(&model)).is_err()
    };
    assert!(refused("q", [1, 2], &[0.0, 1.0]) && !refused("q", [1, 1], &[0.0, 1.0]));
    let two = [0.0, 1.0, 0.0, 1.0];
    assert!(refused("q-q", [2, 2], &two) && refused("q-q", [2, 1], &two) && !refused("q-q", [1, 2], &two));
    assert!(!refused("q-dq", [2, 2], &two) && !refused("q-dq", [2, 1], &two));
    assert!(refused("q", [7, 7], &[0.0, 1.0]), "the arm has seven joints");
    assert!(refused("q", [1, 1], &[0.0, 0.0]), "a domain without width");

    let full = with(&model, &[effect("empirical", "q-dq", Site::Function { row: 0, of: [3, 1] }, &two)]);
    let mut terms = named(&full);
    let own = terms.last().unwrap().effect.clone();
    assert_eq!((own.joint, own.cause, own.other), (Some(1), Some(4), Some(2)));
    // No other effect has a second cause.
    terms.last_mut().unwrap().id = "transmission-coupling".into();
    let again = TorqueModel::from_named("panda", chain("panda"), model.kind(), vec![], &terms);
    assert!(matches!(again, Err(ModelError::Effect { .. })), "{again:?}");
}
